"""The cases: detection limits frozen, sizes and places drawn from them by seed.

`limits.json` is what the diagnosis of the unchanged runs says of every set, frozen by `run` before
anything injected is run; `cases.json` is drawn from it then. Neither is replaced once it is there.
Imports nothing of the tool.
"""

import itertools
import json
import math
from pathlib import Path
from typing import Any

from experiments.concealed_real.features import Features
from experiments.concealed_real.injections import DROPPED, INJECTIONS, Injection
from experiments.concealed_real.material import Settings

import numpy as np


LIMITS, CASES = "limits.json", "cases.json"  # in the folder of the results
SMALLEST, LARGEST = 1.0, 30.0  # sizes in detection limits
COUNT, SEED = 240, 20261
SUBSET, LITTLE_LONGER = 20, 2.0

Case = dict[str, Any]  # id, set, injection, settings, limit, limits


# Limits


def limit_of(frozen: dict[str, Any], injection: Injection, settings: Settings) -> float | None:
    """The size of one detection limit, in the unit of the injection's size.

    None where the diagnosis of the unchanged runs states none: the effect was found in them, or
    no plausible size would have shown.
    """
    known = frozen["features"]
    for effect, parameter in injection.scales:
        if effect == "scatter":
            return known["scatter"].get(parameter) or None
        if effect == "row":
            return known["step"]
        stated = [
            one["limit"]
            for one in frozen["limits"]
            if one["name"] == effect
            and one["parameter"] == parameter
            and one["limit"]
            and _acts_on(one, settings)
        ]
        if stated:
            return min(stated) / _unit_of(injection, effect, settings, known)
    return None


def in_limits(case: Case, frozen: dict[str, Any]) -> float | None:
    """A case's size in the limits of another diagnosis of the unchanged runs; None without any."""
    key, settings = case["injection"], case["settings"]
    if key in DROPPED or "size" not in settings:
        return None
    limit = limit_of(frozen, INJECTIONS[key], settings)
    return None if limit is None else settings["size"] / limit


def _acts_on(limit: dict[str, Any], settings: Settings) -> bool:
    """Whether a limit is one of the channels and actuators of the settings."""
    if "channels" in limit and set(limit["channels"]) != set(settings.get("channels", ())):
        return False
    acting = {c.split("_", 1)[1] for c in settings.get("columns", ()) if "_" in c}
    return "actuators" not in limit or not acting or acting <= set(limit["actuators"])


def _unit_of(injection: Injection, effect: str, settings: Settings, known: Features) -> float:
    """By what a limit of another effect is divided where it stands in for the injection's own.

    A dead band or a bias of some share of the largest order for an exponent or a scale that is off
    by three times that or that share.
    """
    if injection is INJECTIONS["power-law"] and effect == "deadband":
        return settings["full"] / 3.0
    if injection is INJECTIONS["feedback-scale"] and effect == "actuator-bias":
        return max(known["largest"][c] for c in settings["columns"])
    return 1.0


# Drawing


def possible(frozen: dict[str, Any], key: str) -> list[tuple[Settings, float | None]]:
    """Places of an injection in a set, each with the size of one detection limit (None: no size).

    A place where even one limit is more than is possible is left out.
    """
    injection, known = INJECTIONS[key], frozen["features"]
    found = []
    for place in injection.places(known):
        limit = limit_of(frozen, injection, place)
        sized = bool(injection.scales)
        if sized and (limit is None or limit > injection.most(known, place)):
            continue
        found.append((place, limit if sized else None))
    return found


def draw(rng: np.random.Generator, frozen: dict[str, Any], key: str) -> dict[str, Any]:
    """Settings of one injection: a place, a size log-uniform in limits, and what else it needs."""
    injection, known = INJECTIONS[key], frozen["features"]
    places = possible(frozen, key)
    place, limit = places[int(rng.integers(len(places)))]
    settings = dict(place) | injection.extra(rng, known)
    if limit is None:
        return {"settings": settings, "limit": None, "limits": None}
    most = min(LARGEST, injection.most(known, place) / limit)
    multiple = float(np.exp(rng.uniform(math.log(SMALLEST), math.log(most))))
    settings["size"] = multiple * limit
    if injection.in_rows:
        settings["rows"] = max(1, round(settings["size"] / known["step"]))
        settings["size"] = settings["rows"] * known["step"]
    return {"settings": settings, "limit": limit, "limits": settings["size"] / limit}


def dropped_terms(frozen: dict[str, Any], key: str) -> float | None:
    """Size in limits (three standard errors) of the terms that `DROPPED[key]` takes out.

    None where the set's fit does not have them, or they are below one limit.
    """
    dropped, hull = DROPPED[key], frozen["document"]["hull"]
    if dropped.rudder:
        has = any(dict(dropped.rudder).keys() & rudder for rudder in frozen["document"].get(
            "rudder", ()))  # fmt: skip
        stated = [abs(r.get("a_H", 0.0)) for r in frozen["document"].get("rudder", ())]
        return _in_limits(max(stated), 0.1) if has else None
    fitted = {one["name"]: one for one in frozen["parameters"]}
    sizes = [
        _in_limits(abs(fitted[term]["value"]), fitted[term]["std"])
        for term in dropped.terms
        if term in hull and term in fitted and fitted[term]["std"]
    ]
    largest = max(sizes, default=0.0)
    return largest if largest >= SMALLEST else None


def _in_limits(value: float, std: float) -> float:
    return value / (3.0 * std)


def draw_cases(frozen: dict[str, dict], count: int, seed: int) -> list[Case]:
    """So many cases, balanced over sets and kinds; any first part of them is balanced, too.

    Each set's kinds come in an order of its own, all once before any twice; a dropped term, which
    has one size, comes once.
    """
    rng = np.random.default_rng(seed)
    queues = {name: _queue(rng, one, count) for name, one in sorted(frozen.items())}
    cases: list[Case] = []
    while len(cases) < count and any(queues.values()):
        for name in rng.permutation([n for n, queue in queues.items() if queue]):
            key = queues[name].pop(0)
            drawn = (
                {"settings": {}, "limit": None, "limits": dropped_terms(frozen[name], key)}
                if key in DROPPED
                else draw(rng, frozen[name], key)
            )
            cases.append({"set": str(name), "injection": key, **drawn})
    numbered = enumerate(cases[:count])
    return [{"id": f"{k:03d}-{case['set']}-{case['injection']}", **case} for k, case in numbered]


def _queue(rng: np.random.Generator, frozen: dict[str, Any], count: int) -> list[str]:
    """Kinds of injection for one set, in the order in which they are drawn."""
    kinds = [key for key in INJECTIONS if possible(frozen, key)]
    terms = [key for key in DROPPED if dropped_terms(frozen, key) is not None]
    queue = [str(key) for key in rng.permutation([*kinds, *terms])]
    while kinds and len(queue) < count:
        queue += [str(key) for key in rng.permutation(kinds)]
    return queue


def subset(cases: list[Case], seconds: dict[str, float], count: int = SUBSET) -> list[Case]:
    """So many cases that are quick: in turn of each set that takes little longer than the quickest.

    Arguments:
        seconds: of the diagnosis of each set's unchanged runs.
    """
    quick = [name for name in seconds if seconds[name] <= LITTLE_LONGER * min(seconds.values())]
    of_set = [[case for case in cases if case["set"] == name] for name in quick]
    turns = itertools.chain(*itertools.zip_longest(*of_set))
    chosen = itertools.islice((case for case in turns if case is not None), count)
    return sorted(chosen, key=lambda case: case["id"])


def truth(case: Case) -> dict[str, Any]:
    """What a case is: names that are right, its numbers, its onset, and what it acts on."""
    key, settings = case["injection"], case["settings"]
    if key in DROPPED:
        return {"names": DROPPED[key].names, "numbers": {}, "onset": None, "audit": (),
                "acts_on": [], "may_be_silent": False, "outside": False}  # fmt: skip
    injection = INJECTIONS[key]
    acts_on = settings.get("channels") or [
        c.split("_", 1)[1] for c in settings.get("columns", ()) if "_" in c
    ]
    stepped = key in ("thrust-step", "heading-step", "gyro-step")
    return {
        "names": injection.names,
        "numbers": injection.numbers(settings),
        "onset": settings["time"] if stepped else None,
        "audit": injection.audit,
        "acts_on": acts_on,
        "may_be_silent": injection.may_be_silent,
        "outside": not injection.names,
    }


# Files


def read(path: Path) -> Any:
    """A frozen file; ends with a message where it is not there yet."""
    if not path.exists():
        raise SystemExit(f"{path.name} is missing: run `python -m experiments.concealed_real.run`")
    return json.loads(path.read_text(encoding="utf-8"))


def freeze(path: Path, content: Any) -> None:
    """Write a file once; ends with a message where it is there and says something else."""
    text = json.dumps(content, indent=1) + "\n"
    if path.exists() and path.read_text(encoding="utf-8") != text:
        raise SystemExit(f"{path} is frozen; delete it to begin anew, with all results")
    path.write_text(text, encoding="utf-8")
