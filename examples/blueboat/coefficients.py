"""The coefficients that the four trials tell, which trial told each, and what none tells.

    python -m examples.blueboat.coefficients            # 8 minutes of a processor
    python -m examples.blueboat.coefficients --quick    # two fits, for the test

Makes the recordings, fits all four trials, each alone, and all but each, writes results.json and
fills in the tables of README.md. `experiments/harness` writes both.
"""

import math
from pathlib import Path

from experiments.harness.reporting import experiment, table

from examples.blueboat import make_runs

import diffsea
from diffsea.cli import main as command
from diffsea.parameters import read_priors
from diffsea.vessel.files import default_priors


HOME = Path(__file__).parent
FOLDER = Path("out") / "blueboat" / "table"
DIMENSIONS = ("--length", "1.2", "--beam", "0.93", "--mass", "16.4", "--thrusters", "0.57")
FOUR = tuple(name for name in make_runs.TRIALS if name != make_runs.HELD_OUT)
CURRENT = ("current",)
PULLED = ("--thrust", "50.5", "--top-speed", "2.7")  # at the pier, and in the steady trial
ALONE = 1.5  # factor of a standard error up to which a trial can be done without
DETERMINED = 0.5  # share from which the data, not the prior, tell a number
INERTIA = "I_z - N_rdot"  # the sum is what motion tells: I_z of the file is assumed


def main() -> None:
    run = experiment(__file__, __doc__)
    folder = FOLDER / "quick" if run.quick else FOLDER
    make_runs.main(folder / "runs")
    boat = start(folder / "boat.toml")
    runs = {name: str(folder / "runs" / f"{name}.csv") for name in make_runs.TRIALS}

    def fitted(names, effects=CURRENT, file=boat, known="known.toml", **more) -> diffsea.FitResult:
        run.say(f"fitting {', '.join(names)}")
        priors = read_priors(HOME / known, default_priors(file.vessel))
        recordings = [runs[name] for name in names]
        return diffsea.fit(file, recordings, effects=effects, priors=priors, **more)

    profiles = () if run.quick else None
    together = fitted(FOUR, test=runs[make_runs.HELD_OUT], profiles=profiles)
    still = fitted(FOUR, (), test=runs[make_runs.HELD_OUT], profiles=profiles)
    found = {
        "trials": list(FOUR),
        "coefficients": coefficients(together),
        "together": judged(together),
        "without_current": judged(still) | {"coefficients": coefficients(still)},
    }
    tables = {}
    if not run.quick:
        subsets = {f"{name} alone": (name,) for name in FOUR}
        subsets |= {f"all but {name}": tuple(n for n in FOUR if n != name) for name in FOUR}
        shares = {title: shares_of(fitted(names, profiles=())) for title, names in subsets.items()}
        shares["all four"] = shares_of(together)
        file = start(folder / "pulled.toml", *PULLED)
        pulled = fitted(FOUR, file=file, known="pulled.toml", test=runs[make_runs.HELD_OUT])
        found |= {"determined": shares}
        found["bollard_pull"] = judged(pulled) | {"coefficients": coefficients(pulled)}
        found["told_by"] = told_by(shares)
        tables = {"coefficients": coefficient_table(found), "alone": share_table(shares)}
        tables |= {"judged": judged_table(found), "open": open_questions(found)}
    run.write(found, tables)


def start(path: Path, *known: str) -> diffsea.VesselFile:
    """The vessel file of the dimensions, and what is known besides."""
    if command(["new", str(path), *DIMENSIONS, *known, "--force"]):
        raise SystemExit("`diffsea new` failed")
    return diffsea.read_vessel(path)


def coefficients(result: diffsea.FitResult) -> dict[str, dict]:
    """Estimate, interval and truth of each; the sum of yaw inertia in the place of N_rdot."""
    inertia = float(result.fitted.vessel.rigid_body.I_z)
    true = make_runs.truth()
    found = {}
    for row in rows_of_hull(result):
        name, value, (low, high) = row["name"], row["value"], row["interval"]
        actual = true[name]
        if name == "N_rdot":
            name, actual = INERTIA, true["I_z"] - actual
            value, low, high = inertia - value, inertia - high, inertia - low
        found[name] = {
            "unit": row["unit"], "value": value, "interval": [low, high], "true": actual,
            "start": row["start"], "holds": bool(low <= actual <= high),
            "determined": row["determined"],
        }  # fmt: skip
    return found


def shares_of(result: diffsea.FitResult) -> dict[str, float]:
    """Which share of each coefficient the data determine, 0 to 1."""
    return {INERTIA if row["name"] == "N_rdot" else row["name"]: row["determined"]
            for row in rows_of_hull(result)}  # fmt: skip


def rows_of_hull(result: diffsea.FitResult) -> list[dict]:
    """What was fitted but the motors' lag, of which the boat that made the runs has none."""
    return [row for row in result.study.rows if not row["name"].endswith(".time_constant")]


def judged(result: diffsea.FitResult) -> dict:
    """What a fit says of itself, on the run held out."""
    effects = {name: instances[0] for name, instances in result.study.effects.items()}
    return {
        "misfit": result.misfit, "free": result.free, "missing": bool(result.missing),
        "verdict": result.verdict.sentence, "effects": effects,
        "identifiability": result.study.identifiability.sentences,
        "next": None if result.study.next is None else result.study.next.sentence,
        "outside": [name for name, one in coefficients(result).items() if not one["holds"]],
    }  # fmt: skip


def told_by(shares: dict[str, dict[str, float]]) -> dict[str, dict]:
    """The trial without which a coefficient's standard error grows most, and by which factor."""
    found = {}
    for name, share in shares["all four"].items():
        left = {t: math.sqrt((1 - shares[f"all but {t}"][name]) / (1 - share)) for t in FOUR}
        trial = max(left, key=left.__getitem__)
        found[name] = {"trial": trial if share >= DETERMINED else None, "factor": left[trial]}
    return found


def coefficient_table(found: dict) -> str:
    """The table of coefficients."""
    head = ("coefficient", "unit", "from `new`", "estimate", "90 % interval", "true", "told by",
            "with a bollard pull")  # fmt: skip
    rows = []
    for name, one in found["coefficients"].items():
        by = found["told_by"][name]
        told = f"{by['trial']} ({by['factor']:.2g})"
        if by["trial"] is None or by["factor"] < ALONE:
            told = "none" if by["trial"] is None else f"more than one ({by['factor']:.2g})"
        started = None if name == INERTIA else one["start"]
        pulled = found["bollard_pull"]["coefficients"][name]
        true = one["true"]
        rows.append((name, one["unit"] or "-", started, one["value"], spanned(one), true, told,
                     spanned(pulled)))  # fmt: skip
    return table(head, rows)


def spanned(one: dict) -> str:
    """An interval; in italics where the truth is outside."""
    low, high = (f"{end:.4g}" for end in one["interval"])
    return f"{low} to {high}" if one["holds"] else f"*{low} to {high}*"


def share_table(shares: dict[str, dict[str, float]]) -> str:
    """What each trial by itself determines."""
    rows = [
        (name, *(f"{100 * shares[f'{trial} alone'][name]:.0f} %" for trial in FOUR),
         f"{100 * share:.0f} %")
        for name, share in shares["all four"].items()
    ]  # fmt: skip
    return table(("coefficient", *FOUR, "all four"), rows)


def judged_table(found: dict) -> str:
    """What the fits say, and what they are worth."""
    fits = found["without_current"], found["together"], found["bollard_pull"]
    number = len(found["coefficients"])

    def line(what: str, of) -> tuple:
        return what, *(of(one) for one in fits)

    rows = [
        line("normalised misfit, run held out", lambda one: one["misfit"]["test"]),
        line("position 5 s ahead, m", lambda one: one["free"]["5"]["position"]),
        line("position 20 s ahead, m", lambda one: one["free"]["20"]["position"]),
        line("heading 20 s ahead, deg", lambda one: math.degrees(one["free"]["20"]["heading"])),
        line("something is missing", lambda one: "yes" if one["missing"] else "no"),
        line(f"true values outside, of {number}", lambda one: len(one["outside"])),
    ]
    return table(("", "still water", "current", "current, and a bollard pull"), rows)


def open_questions(found: dict) -> str:
    """What the fit itself says that it does not know."""
    together, pulled = found["together"], found["bollard_pull"]
    told = [f"- {sentence}" for sentence in together["identifiability"]]
    told += [f"- with a bollard pull, {sentence}" for sentence in pulled["identifiability"]]
    return "\n".join([*told, f"- next: {together['next']}"])


if __name__ == "__main__":
    main()
