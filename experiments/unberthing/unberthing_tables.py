"""What the stages say, as rows beside published figures and as tables."""

from collections.abc import Sequence

from experiments.harness.reporting import compared, table
from experiments.unberthing.gradient_model import RATES
from experiments.unberthing.unberthing_loop import Log
from experiments.unberthing.unberthing_scores import Score, bootstrap, pooled, score, wilson

import numpy as np


GROWN = 200  # periods, 100 s
TABLE_3 = {"Exp. 2": (1.4, -4.1, -3.5), "Exp. 3": (3.1, -4.0, -3.9)}  # m, published


def exp_1_rows(found: Sequence[Log], cured: Sequence[Score]) -> list[dict]:
    """The unberthing phase beside what section 5.1 says of it."""
    judged = [score(log) for log in found]
    wrong = [one for one in judged if one.wrong_way > 0]
    counts = f"{len(wrong)} of {len(judged)} draws of gusts and noise"
    first = np.median([one.first_wrong for one in wrong]) if wrong else None
    inside = [log.model[log.step <= 2] for log in found]
    bow, stern = (np.array([rows[:, 0, k].min() < 0 for rows in inside]) for k in (3, 4))
    ends = np.array([rows[-1, 0, 3] < 0 for rows in inside])
    fades = np.array([rows[-1, 1, 3] < rows[len(rows) // 3, 1, 3] for rows in inside])
    rows = []
    for step, published in ((1, 1.6), (2, 7.1)):
        size = np.abs([one.worst[step] for one in judged])
        name = f"Exp. 1, Step {step}: largest cross-track error"
        spread = f"median; {size.min():.2g} to {size.max():.2g} over {len(judged)} draws"
        rows.append(compared(name, "m", published, np.median(size), spread))
    better = np.median(np.abs([one.worst[2] for one in cured]))
    lost = [_at_loss(log) for log in found]
    turned = np.array([speed > 0 for _, speed in lost if np.isfinite(speed)])
    when = np.median([t for t, _ in lost if np.isfinite(t)]) if len(turned) else None
    return rows + [
        compared("same, least squares with trust bearing the push", "m", None, better, "median"),
        compared("thrusters turned the wrong way", "", "once in one run", counts),
        compared("when that began", "s", 520.0, first,
                 f"median of those draws; the learning rate, {RATES[0]:g}, was set so that it is "
                 "about the published time"),
        compared("gamma_vB below zero in Exp. 1", "", "yes", _share(bow)),
        compared("gamma_vB below zero at its end", "", "yes", _share(ends)),
        compared("gamma_vS below zero in Exp. 1", "", "yes", _share(stern),
                 "here the bow thruster, which fades first, is the one to go"),
        compared("sway to starboard when a coefficient is lost", "", "yes", _share(turned),
                 "of the draws in which one is"),
        compared("when the first coefficient is lost", "s", 500.0, when, "median of those draws"),
        compared("gamma_rB falls as speed grows", "", "yes", _share(fades)),
    ]  # fmt: skip


def _at_loss(log: Log) -> tuple[float, float]:
    """When (s) a thruster's sway coefficient first turns negative while unberthing, and the sway
    speed (m/s to starboard) then; NaN where none does."""
    lost = (log.model[:, 0, 3:5] < 0).any(1) & (log.step <= 2)
    if not lost.any():
        return np.nan, np.nan
    row = int(lost.argmax())
    return float(log.t[row]), float(np.asarray(log.state.v)[row])


def period_rows(seconds: dict[str, float]) -> list[dict]:
    """What a control period takes beside the half second that it has."""
    return [
        compared(f"one control period, {name}", "ms", "below 500", 1e3 * taken,
                 "median, compiled, of this machine")
        for name, taken in seconds.items()
    ]  # fmt: skip


def leaving_rows(
    found: dict[str, Sequence[Log]], variants: dict[str, dict[str, Sequence[Score]]]
) -> list[dict]:
    """The leaving phase beside Table 3; medians with their signs."""
    rows, chosen = [], f"median; weather and learning rate, {RATES[1]:g}, chosen"
    for name, runs in found.items():
        judged = [score(log) for log in runs]
        for k, published in zip((3, 4, 5), TABLE_3[name], strict=True):
            worst = np.median([one.worst[k] for one in judged])
            words = f"{name}, Step {k}: largest deviation"
            rows.append(compared(words, "m", published, worst, chosen))
        bias = np.mean([np.median(log.model[log.step == 5][:, 0, 5]) for log in runs])
        rows.append(compared(f"{name}: c_v in Step 5", "m/s", "negative", bias))
        grown, ended = np.median([_growth(log) for log in runs], axis=0)
        note = f"median of its last 100 s, in which it falls to {ended:.2f}; median of the draws"
        rows.append(compared(f"{name}: gamma_r_delta, Step 5 over start", "1", "above 1", grown,
                             note))  # fmt: skip
        turned = np.array([log.model[log.step <= 5][-1, 0, 2] > 0 for log in runs])
        rows.append(compared(f"{name}: gamma_v_delta has another sign at the end", "", "increased",
                             _share(turned)))  # fmt: skip
    for way, by_name in variants.items():
        for name, judged in by_name.items():
            worst = np.median([max(abs(v) for v in one.worst.values()) for one in judged])
            rows.append(compared(f"{name}, largest deviation, {way}", "m", None, worst))
    return rows


def summary(judged: Sequence[Score]) -> dict:
    """The figures by which a control system is judged over seeds."""
    runs = len(judged)
    wrong = sum(one.wrong_way > 0 for one in judged)
    sign = sum(one.wrong_sign > 0 for one in judged)
    low, high = wilson(wrong, runs)
    errors = [np.abs(one.error) for one in judged]
    worst_2 = np.abs([one.worst.get(2, np.nan) for one in judged])
    farthest = [one.farthest_wrong for one in judged if one.wrong_way > 0]
    return {
        "runs": runs, "farthest_wrong": float(np.median(farthest)) if farthest else None,
        "wrong_way": wrong / runs, "wrong_way_interval": [low, high],
        "wrong_sign": sign / runs, "wrong_sign_interval": list(wilson(sign, runs)),
        "p95_error": float(np.percentile(np.concatenate(errors), 95)),
        "p95_error_interval": list(pooled(errors)),
        "p95_worst_step_2": float(np.nanpercentile(worst_2, 95)),
        "p95_worst_step_2_interval": list(bootstrap(worst_2[np.isfinite(worst_2)])),
        "median_worst_step_2": float(np.nanmedian(worst_2)),
        "finished": sum(one.finished for one in judged) / runs,
    }  # fmt: skip


def scored_table(found: dict[str, dict]) -> str:
    """One row per control system."""
    head = ("control system", "runs with thrusters the wrong way", "off the line by then",
            "runs with a wrong sign",
            "95th percentile of error", "of the largest in Step 2", "median of that")  # fmt: skip
    rows = [
        (name, _percent(one["wrong_way"], one["wrong_way_interval"]),
         "-" if one["farthest_wrong"] is None else f"{one['farthest_wrong']:.1f} m",
         _percent(one["wrong_sign"], one["wrong_sign_interval"]),
         _metres(one["p95_error"], one["p95_error_interval"]),
         _metres(one["p95_worst_step_2"], one["p95_worst_step_2_interval"]),
         f"{one['median_worst_step_2']:.1f} m")
        for name, one in found.items()
    ]  # fmt: skip
    return table(head, rows)


def _growth(log: Log) -> tuple[float, float]:
    """gamma_r_delta over its first value: the median of the last `GROWN` periods, and the last."""
    leaving = log.model[(log.step >= 3) & (log.step <= 5)][:, 1, 2]
    return float(np.median(leaving[-GROWN:]) / leaving[0]), float(leaving[-1] / leaving[0])


def _share(flags: np.ndarray) -> str:
    return f"in {int(flags.sum())} of {len(flags)} draws"


def _percent(share: float, interval: Sequence[float]) -> str:
    return f"{100 * share:.0f} % ({100 * interval[0]:.0f} to {100 * interval[1]:.0f})"


def _metres(value: float, interval: Sequence[float]) -> str:
    return f"{value:.1f} m ({interval[0]:.1f} to {interval[1]:.1f})"
