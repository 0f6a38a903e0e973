"""The plan of a set, and each case of it from its seed.

A plan is a list of cases: hull, stratum, effects with their sizes in detection limits. The seed
of a case decides everything else: true derivatives, gusts, sensor noise, manoeuvres.
"""

import dataclasses
import hashlib
import json
import math
from pathlib import Path

import numpy as np

from . import effects, orders, outside, sensors
from .hulls import HULLS, Hull
from .simulate import CHANNELS, Gusts, Track, simulate


LIMITS = Path(__file__).with_name("limits.json")
SHARES = {
    "clean": 0.15, "benign": 0.08, "single": 0.47, "pair": 0.12, "outside": 0.10,
    "uninformative": 0.08,
}  # fmt: skip
LEAST, MOST = 1.0, 30.0  # detection limits
BESIDE = 4.0  # the least of each of several effects
# The least in strata whose runs show less than all, in limits of whole runs; and their length.
ENOUGH = {"standard": 8.0, "alike": 4.0, "short": 4.0}
LENGTH = {"short": 0.2}  # of the hull's usual run
ROOM = 1.2  # largest plausible size over the least one, for sizes to be drawn between


@dataclasses.dataclass(frozen=True)
class Set:
    """Whose hulls, in which shares the strata, how many cases, and the plan's seed."""

    hulls: str
    seed: int
    shares: dict[str, float]
    count: int


SETS = {
    "develop": Set("develop", 20_001, SHARES, 400),
    "scored": Set("scored", 90_018, SHARES, 400),
    # Beside the 400: what they hold none of, and what makes rivals.
    "triples": Set("scored", 31_013, {"triple": 1.0}, 24),
    "standard": Set("scored", 52_021, {"standard": 1.0}, 40),
    # One manoeuvre, of usual length and short, which leaves rivals: `resolve` sails on.
    "alike": Set("scored", 61_027, {"alike": 1.0}, 120),
    "short": Set("scored", 61_129, {"short": 1.0}, 160),
    # So many that no false alarm in these and the 400 bounds their rate by 2.5 per cent.
    "clean": Set("scored", 73_009, {"clean": 1.0}, 100),
}
RUNS = ("train/run1", "train/run2", "train/run3", "train/run4", "test/run5", "test/run6")
TOGETHER = {"pair": 2, "triple": 3}
# What only a turn (or anything but a constant speed) can show.
NEEDS_TURNING = (
    "crossflow-drag", "quadratic-damping:N_rr", "quadratic-damping:Y_vv",
    "sway-yaw-coupling:Y_r", "sway-yaw-coupling:N_v", "thrust-loss-in-turns", "munk-moment",
    "speed-dependent-damping:Y_ur", "speed-dependent-damping:N_ur", "thrust-lag", "thrust-delay",
    "rate-limit", "backlash", "lever-arm", "added-mass-coupling:Y_rdot", "rudder-interaction:a_H",
    "rudder-interaction:gamma_R",
)  # fmt: skip


def limits(hull: str) -> dict[str, float]:
    """Detection limits of a hull by effect key; SystemExit where they are not of this hull."""
    found = json.loads(LIMITS.read_text(encoding="utf-8")).get(hull)
    if found is None or found["of"] != digest(HULLS[hull]):
        raise SystemExit(
            f"{LIMITS.name} has no detection limits of the hull '{hull}' as it is now: "
            f"run python -m experiments.concealed.limits {hull}"
        )
    return found["limits"]


def digest(hull: Hull) -> str:
    """SHA-256 of the numbers that detection limits depend on."""
    numbers = {k: v for k, v in vars(hull).items() if not callable(v)}
    return hashlib.sha256(repr(sorted(numbers.items())).encode()).hexdigest()


def available(hull: Hull) -> list[str]:
    """Effects whose largest plausible size is well above the detection limit."""
    entries, found = effects.catalogue(hull), limits(hull.name)
    return [k for k, e in entries.items() if found.get(k, math.inf) * 2.0 * LEAST < e.most]


def plan(set_name: str, count: int, seed: int) -> list[dict]:
    """`count` cases of a set: strata in its shares, hulls in turn, effects in turn."""
    rng = np.random.default_rng(seed)
    drawn = SETS[set_name]
    hulls = [h for h in HULLS.values() if h.set == drawn.hulls]
    quota = {s: round(count * share) for s, share in drawn.shares.items()}
    quota[max(quota, key=lambda s: drawn.shares[s])] += count - sum(quota.values())
    decks = {h.name: _deck(rng, available(h)) for h in hulls}
    cases = []
    for stratum, number in quota.items():
        for i in range(number):
            hull = hulls[i % len(hulls)]
            cases.append({"hull": hull.name, "stratum": stratum, "effects": []})
            deck = decks[hull.name]
            if stratum == "single":
                cases[-1]["effects"] = [_sized(rng, hull, next(deck))]
            elif stratum in TOGETHER:
                cases[-1]["effects"] = _together(rng, hull, deck, TOGETHER[stratum])
            elif least := ENOUGH.get(stratum):
                key = next(k for k in deck if _reaches(hull, k, least))
                cases[-1]["effects"] = [_sized(rng, hull, key, least)]
            elif stratum == "uninformative":
                there = [k for k in NEEDS_TURNING if k in available(hull)]
                cases[-1]["effects"] = [_sized(rng, hull, str(rng.choice(there)))]
    for case, k in zip(cases, rng.permutation(len(cases)), strict=True):
        case["id"] = f"c{k:04d}"
        case["seed"] = int(rng.integers(2**31))
    return sorted(cases, key=lambda c: c["id"])


def subset(cases: list[dict], count: int) -> list[dict]:
    """A balanced part: hulls and strata in proportion, by order of id within each."""
    groups: dict[tuple, list[dict]] = {}
    for case in cases:
        groups.setdefault((case["stratum"], case["hull"]), []).append(case)
    wanted = {k: len(v) * count / len(cases) for k, v in groups.items()}
    taken = {k: int(w) for k, w in wanted.items()}
    for k in sorted(wanted, key=lambda k: taken[k] - wanted[k])[: count - sum(taken.values())]:
        taken[k] += 1
    return sorted((c for k, v in groups.items() for c in v[: taken[k]]), key=lambda c: c["id"])


def _deck(rng: np.random.Generator, keys: list[str]):
    """Every effect once in a random order, then again."""
    while True:
        yield from (keys[i] for i in rng.permutation(len(keys)))


def _sized(rng: np.random.Generator, hull: Hull, key: str, least: float = LEAST) -> dict:
    """An effect with its size, log-uniform in detection limits as far as is plausible."""
    entry, limit = effects.catalogue(hull)[key], limits(hull.name)[key]
    most = min(MOST, entry.most / limit)
    size = float(np.exp(rng.uniform(math.log(least), math.log(most))))
    return {"key": key, "limits": round(size, 3), "size": float(f"{size * limit:.4g}"),
            "extra": entry.draw(rng, hull)}  # fmt: skip


def _together(rng: np.random.Generator, hull: Hull, deck, count: int) -> list[dict]:
    """Effects of different names, each at least four limits."""
    chosen: list[dict] = []
    while len(chosen) < count:
        key = next(deck)
        taken = key.split(":")[0] in {e["key"].split(":")[0] for e in chosen}
        if not taken and _reaches(hull, key, BESIDE):
            chosen.append(_sized(rng, hull, key, BESIDE))
    return chosen


def _reaches(hull: Hull, key: str, least: float) -> bool:
    """Whether plausible sizes go well beyond `least` detection limits."""
    return effects.catalogue(hull)[key].most >= ROOM * least * limits(hull.name)[key]


def make_case(case: dict) -> tuple[list[dict], dict]:
    """Recordings (columns by name) in the order of RUNS, and the truth.

    Effects so large that a run diverges, or is none of a vessel, are halved until none is.
    """
    while (made := _made(case)) is None:
        smaller = [e | {k: 0.5 * e[k] for k in ("limits", "size")} for e in case["effects"]]
        if not smaller or smaller[0]["limits"] < 0.1:
            raise ValueError(f"{case['id']}: the runs diverge whatever the effect's size")
        case = case | {"effects": smaller}
    return made


def _made(case: dict) -> tuple[list[dict], dict] | None:
    """Recordings and truth of a case as it is; None where a run diverges."""
    hull = HULLS[case["hull"]]
    hull = dataclasses.replace(hull, rows=round(LENGTH.get(case["stratum"], 1.0) * hull.rows))
    rng = np.random.default_rng(case["seed"])
    model, done = true_vessel(case, rng)
    policies = orders.RUN_SETS.get(case["stratum"], orders.full)(rng, hull, model.sensing)
    recordings = []
    for policy in policies:
        try:
            track = run(model, hull, policy, rng)
        except ArithmeticError:
            return None
        if not _sails(track, hull):
            return None
        recordings.append(columns(track, model, hull, rng))
    return recordings, {**case, **done, "hull_values": _numbers(model.hull)}


def _sails(track: Track, hull: Hull) -> bool:
    """Whether a run is one of a vessel: at no more than five times its speed, upright to 60 deg."""
    u, v, phi = track.states[:, [CHANNELS.index(c) for c in ("u", "v", "phi")]].T
    known = bool(np.isfinite(track.states).all())
    return known and bool((np.hypot(u, v) < 5 * hull.speed).all() and (np.abs(phi) < 1.05).all())


def true_vessel(case: dict, rng: np.random.Generator):
    """The true model and {"named": {name: parameters}, "unnamed": ...}; first use of the seed."""
    hull = HULLS[case["hull"]]
    model = outside.true_model(hull, rng)
    done: dict = {"named": {}}
    if case["stratum"] == "benign":
        done["unnamed"] = outside.benign(model, hull, rng)
    if case["stratum"] == "outside":
        done["unnamed"] = outside.outside(model, hull, rng)
    for e in case["effects"]:
        values = effects.apply(model, hull, e["key"], e["size"], e["extra"])
        done["named"][e["key"].split(":")[0]] = values
    return model, done


def run(model, hull: Hull, policy, rng: np.random.Generator) -> Track:
    """One run from a random place and heading, with gusts."""
    lead = round(hull.lead / hull.step)
    x, y = rng.uniform(-3.0, 3.0, 2) * hull.document["hull"]["length"]
    start = (float(x), float(y), float(rng.uniform(-math.pi, math.pi)), 0.5 * hull.speed)
    end = hull.rows * hull.step
    end += model.sensing.ahead(end)
    step, values = outside.gust_grid(hull, rng, -hull.lead, end)
    gusts = Gusts(-lead * hull.step, step, values)
    return simulate(model, policy, hull.rows, hull.step, lead, start, gusts)


def columns(track: Track, model, hull: Hull, rng: np.random.Generator) -> dict:
    """The recording: measured channels, then orders."""
    found = sensors.record(track, model.sensing, hull.instruments, hull.rows, hull.step, rng)
    for i, label in enumerate(track.labels):
        found[f"cmd_{label}"] = track.orders[:, i]
    return found


def _numbers(hull: dict) -> dict:
    return {k: v for k, v in hull.items() if isinstance(v, float)}
