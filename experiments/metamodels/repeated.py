# pyright: reportArgumentType=false
"""Real repeats: what the other trial predicts of one kept back, and what a metamodel does.

A trial's mirror image counts as its repeat: sides are turned alike before anything is compared.
"""

import dataclasses
import itertools

from experiments.metamodels.averaging import as_run
from experiments.metamodels.metamodel import identified
from experiments.metamodels.recorded import Real, like, table_of

import numpy as np

from diffsea.metamodels.ideal_zigzag import IdealRun


# The paper's rudder angles are 1 to 2 deg off the ordered ones; as much is allowed of the headings
# of reversals.
TOLERANCE = np.radians(2.0)
METHODS = (
    AVERAGE := "average",
    # Of the trials that are averaged, as in `averaging`, and of all that are not kept back.
    "corrected average, metamodel of the repeat",
    "corrected average, metamodel of all others",
    "metamodel of the repeat",
    "metamodel of all others",
)
# No predictions: what the model's structure leaves, and by how much the sensors disagree.
ITSELF, INTEGRATED = "metamodel of the trial itself", "its measured yaw rates, integrated"
NOTHING = np.full(2, np.nan)


@dataclasses.dataclass(frozen=True)
class Answer:
    """What a method says of a zig-zag, turned so that the first execute is to starboard."""

    overshoots: np.ndarray  # (2,) rad
    times: np.ndarray  # (2,) s, from the first execute to the second, from that to the third
    psi: np.ndarray  # rad, every `dt` s from the first execute on


def apart(one: Real, other: Real) -> float:
    """By how much (rad) two trials differ in what was ordered: angle of the rudder, reversals."""
    marks = np.max(np.abs(np.abs(one.marks) - np.abs(other.marks)))
    return max(abs(one.angle - other.angle), float(marks))


def pairs(trials: list[Real]) -> list[tuple[int, int]]:
    """Which trials repeat each other, to whichever side."""
    every = itertools.combinations(range(len(trials)), 2)
    return [(i, k) for i, k in every if apart(trials[i], trials[k]) <= TOLERANCE]


def measured(trial: Real) -> Answer:
    """What a trial showed."""
    t = trial.dt * np.arange(len(trial.psi))
    clock = np.arange(trial.executes[0], t[-1], trial.dt)
    psi = trial.side * np.interp(clock, t, trial.psi)
    return Answer(trial.overshoots, np.diff(trial.executes[:3]), psi)


def asked(run: IdealRun, trial: Real) -> Answer:
    """What an ideal zig-zag showed, on the clock of a trial."""
    switches = np.append(0.0, np.asarray(run.switch_times)[:2])
    clock = np.arange(0.0, float(run.t[-1]), trial.dt)
    psi = trial.side * np.interp(clock, run.t, run.psi)
    return Answer(np.asarray(run.overshoots)[:2], np.diff(switches), psi)


def answers(trials: list[Real], kept: int, repeat: int, rate_limit: float) -> dict[str, Answer]:
    """Every method's answer for the trial `kept` back, one of its repeats being known."""
    table, numbers = table_of(trials), np.arange(len(trials))
    one, other = trials[kept], trials[repeat]

    def metamodel(used: np.ndarray):
        return identified(dataclasses.replace(table, known=table.known & used[:, None]))

    average, corrected, asked_for = measured(other), {}, {}
    for name, used in (("the repeat", numbers == repeat), ("all others", numbers != kept)):
        fit = metamodel(used)
        answer = asked(like(fit.model, one, rate_limit), one)
        shown = _overshoots(other, fit.predicted[repeat][: len(other.r)])
        moved = average.overshoots + answer.overshoots - shown
        # Under its own rudder the repeat is reversed when it was: times cannot be corrected.
        corrected[f"corrected average, metamodel of {name}"] = Answer(moved, NOTHING, np.array([]))
        asked_for[f"metamodel of {name}"] = answer
    checks = {
        ITSELF: asked(like(metamodel(numbers == kept).model, one, rate_limit), one),
        INTEGRATED: Answer(_overshoots(one, one.r), NOTHING, np.array([])),
    }
    return {AVERAGE: average} | corrected | asked_for | checks


def _overshoots(trial: Real, r) -> np.ndarray:
    """Overshoots (rad) by yaw rates (rad/s), measured or simulated, between a trial's reversals."""
    return np.asarray(as_run(r, trial.executes[1:3], trial.side, trial.dt))


def errors(truth: Answer, found: Answer, span: int) -> dict:
    """Root-mean-square errors: overshoots (deg), times (per cent), heading (deg) over a span."""
    off = np.degrees(found.overshoots - truth.overshoots)
    late = 100 * (found.times / truth.times - 1)
    heading = np.degrees(found.psi[:span] - truth.psi[:span]) if len(found.psi) else np.nan
    return {
        "overshoots_deg": float(np.sqrt(np.mean(off**2))),
        "times_percent": float(np.sqrt(np.mean(late**2))),
        "heading_deg": float(np.sqrt(np.mean(heading**2))),
    }


def compared_with_averaging(trials: list[Real], rate_limit: float) -> dict:
    """Every repeat kept back in turn: measured, predicted and errors by method."""
    rows, series = [], []
    for pair in pairs(trials):
        for kept, repeat in (pair, pair[::-1]):
            truth, other = measured(trials[kept]), measured(trials[repeat])
            span = min(len(truth.psi), len(other.psi))
            found = answers(trials, kept, repeat, rate_limit)
            rows.append({
                "name": trials[kept].name,
                "repeat": trials[repeat].name,
                "measured": _told(truth),
                "methods": {
                    method: _told(answer) | {"errors": errors(truth, answer, span)}
                    for method, answer in found.items()
                },
            })  # fmt: skip
            series.append((trials[kept], truth.psi[:span], {
                method: answer.psi[:span] for method, answer in found.items() if len(answer.psi)
            }))  # fmt: skip
    return {"apart_deg": _apart(trials), "trials": rows, "errors": _over(rows), "series": series}


def _told(answer: Answer) -> dict:
    return {"overshoots_deg": np.degrees(answer.overshoots).tolist(), "times": answer.times}


def _apart(trials: list[Real]) -> dict:
    """How far the orders of repeats are apart at most, and those of other trials at least."""
    chosen = pairs(trials)
    every = {p: np.degrees(apart(trials[p[0]], trials[p[1]]))
             for p in itertools.combinations(range(len(trials)), 2)}  # fmt: skip
    return {
        "repeats, at most": max((a for p, a in every.items() if p in chosen), default=np.nan),
        "others, at least": min((a for p, a in every.items() if p not in chosen), default=np.nan),
    }


def _over(rows: list[dict]) -> dict:
    """Errors by method over all trials kept back, root mean square."""
    return {
        method: {
            key: float(np.sqrt(np.mean([r["methods"][method]["errors"][key] ** 2 for r in rows])))
            for key in ("overshoots_deg", "times_percent", "heading_deg")
        }
        for method in (rows[0]["methods"] if rows else ())
    }


def study(sets: dict[str, tuple[list[Real], float]]) -> dict:
    """Repeats of every set."""
    return {name: compared_with_averaging(*one) for name, one in sets.items()}
