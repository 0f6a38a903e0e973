"""Power and false alarms of the audit: known faults in real recordings and in simulated ones.

python -m experiments.audit_power.run [--quick]

Results of sets of recordings that are there already are kept: what was stopped goes on.
"""

import argparse
import dataclasses
import json
import sys
import time
import zlib
from pathlib import Path

import numpy as np
from scipy import optimize, special, stats


HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]

from experiments.audit_power.faults import CHANNELS, GRADED, LABELS, Fault, rows_of
from experiments.concealed_real import sets

from tests.oracle import make_recordings
from tests.oracle.sensors import record, suite, write_csv
from tests.oracle.simulator import load

from diffsea import read_recording
from diffsea.recordings import audit


OUT = ROOT / "out" / "audit_power"
RESULTS = HERE / "results.json"
MANOEUVRES = ("random-fast", "zigzag-fast", "circle-fast")
# Real sets as they are believed after repair, and how many of their runs are taken, evenly.
REAL = {
    "blueboat": (sets.blueboat, 4),
    "esso": (sets.esso, 4),
    "hsva": (sets.hsva, 4),
    "kcs": (sets.kcs, 3),
    "kingfisher": (sets.kingfisher, 4),
    "milliampere": (sets.milliampere, 3),
    "vtec": (sets.vtec, 4),
}
LONGEST = 300.0  # s of a real run that are used
POWER = 0.95
# Kinds of a size that is the same in all parts of a run.
CONSTANT = ("sensor-latency", "clock-drift", "gyro-bias", "heading-offset", "hard-iron",
            "lever-arm", "through-water", "scale")  # fmt: skip


def simulated(seeds, draws: int) -> list[list]:
    """For each vessel, manoeuvre and seed, recordings that differ in their noise alone.

    They are kept under out/ and made only where they are absent.
    """
    folder = OUT / "simulated"
    folder.mkdir(parents=True, exist_ok=True)
    runs = []
    for vessel in ("usv", "boat"):
        for seed in seeds:
            document = load(ROOT / "tests" / "oracle" / f"{vessel}.toml")
            stream = make_recordings.stream(seed, "hull")
            true = make_recordings.perturbed(document, stream)
            for name in MANOEUVRES:
                paths = [folder / f"{vessel}_{name}_{seed}_{k}.csv" for k in range(draws)]
                if not all(path.exists() for path in paths):
                    sim = make_recordings.perform(true, name, seed, seconds=150.0, rate=5.0)
                    for draw, path in enumerate(paths):
                        rng = np.random.default_rng([draw, zlib.crc32(path.name.encode())])
                        write_csv(path, record(sim, np.arange(751) / 5.0, suite(), rng))
                runs.append([read_recording(path) for path in paths])
    return runs


def real(name: str, few: bool = False) -> list:
    """Some runs of a real set, their first part."""
    read, count = REAL[name]
    tables = list(read().items())
    chosen = np.unique(np.linspace(0, len(tables) - 1, 1 if few else count).round().astype(int))
    runs = []
    for k in chosen:
        key, table = tables[k]
        run = dataclasses.replace(read_recording(table), name=key)
        t = np.asarray(run.t)
        runs.append(rows_of(run, t <= t[0] + LONGEST))
    return runs


def halves(run) -> tuple:
    """A run's first and second half."""
    t = np.asarray(run.t)
    first = t < 0.5 * (t[0] + t[-1])
    return rows_of(run, first), rows_of(run, ~first)


@dataclasses.dataclass
class Trial:
    """One recording with one fault of one size: what came of it."""

    recording: str
    size: float
    named: bool  # the right kind and channels
    alone: bool  # and nothing else that was not there before
    error: float  # (value - truth) / standard error, where named
    near: bool  # within three standard errors


def attempt(run, fault: Fault, size: float, level: float, before: set) -> Trial:
    """Put the fault in and audit."""
    rng = np.random.default_rng(zlib.crc32(f"{run.name} {fault.name}".encode()))
    faulty, truth = fault.make(run, size, rng)
    found = audit(faulty, level)
    hits = [f for f in found if f.kind == fault.kind and set(f.channels) == set(fault.channels)]
    others = [f for f in found if f not in hits and (f.kind, f.channels) not in before]
    others = [f for f in others if f.kind != "gap"]  # a late channel is unknown at first
    if not hits:
        return Trial(run.name, size, False, False, float("nan"), False)
    # The clock of one falls behind, or that of the others gets ahead.
    out = abs(hits[0].value) - abs(truth) if fault.kind == "clock-drift" else hits[0].value - truth
    room = max(3 * hits[0].std, fault.exact * abs(truth)) * (1 + 1e-9)
    error = out / hits[0].std if hits[0].std > 0 else 0.0
    return Trial(run.name, size, True, not others, float(error), bool(abs(out) <= room))


def apart(run, fault: Fault, size: float, level: float) -> float | None:
    """How far what is found in the two halves of a faulty run differs, in its standard error.

    A fault that the run has of its own is in both. None where a half does not show it.
    """
    rng = np.random.default_rng(zlib.crc32(f"{run.name} {fault.name}".encode()))
    faulty, _ = fault.make(run, size, rng)
    found = []
    for half in halves(faulty):
        hits = [f for f in audit(half, level)
                if f.kind == fault.kind and set(f.channels) == set(fault.channels)]  # fmt: skip
        found += hits[:1]
    if len(found) < 2 or min(one.std for one in found) <= 0:
        return None
    return (found[0].value - found[1].value) / np.hypot(found[0].std, found[1].std)


def has_all(run, channels) -> bool:
    """Whether the run has values of all motion channels among these."""
    return all(np.sum(np.isfinite(getattr(run, n))) > 30 for n in set(channels) & set(CHANNELS))


def thresholds(runs, fault: Fault, level: float, clean: dict) -> dict:
    """Per recording by bisection: the largest size missed and the smallest found."""
    trials, spans, between = [], [], []
    for run in runs:
        kinds = {kind for kind, _ in clean[run.name]}
        if fault.kind in kinds or not has_all(run, fault.channels):
            continue
        low, high = -1, len(fault.sizes)
        while high - low > 1:
            middle = (low + high) // 2
            trial = attempt(run, fault, fault.sizes[middle], level, clean[run.name])
            trials.append(trial)
            low, high = (low, middle) if trial.named else (middle, high)
        spans.append((low, high))
        # What a whole run shows just so, its halves would not.
        if fault.kind in CONSTANT and high < len(fault.sizes):
            larger = fault.sizes[min(high + 2, len(fault.sizes) - 1)]
            difference = apart(run, fault, larger, level)
            between += [] if difference is None else [float(difference)]
    return {"trials": trials, "halves": [round(one, 3) for one in between]} | fitted(
        fault.sizes, spans
    )


def fitted(sizes, spans) -> dict:
    """Size found with 95 % power: logistic in log size, the thresholds known within a factor.

    The likelihood of a threshold between two sizes is the difference of power there.
    """
    missed = sum(high == len(sizes) for _, high in spans)
    summary = {"recordings": len(spans), "never": missed, "size": None}
    if not spans or missed > (1 - POWER) * len(spans):
        return summary
    step = np.log(sizes[1] / sizes[0])
    edges = np.array([[-np.inf if low < 0 else np.log(sizes[low]), np.log(sizes[high])
                       if high < len(sizes) else np.inf] for low, high in spans])  # fmt: skip

    def cost(theta):
        share = special.expit((edges - theta[0]) / np.exp(theta[1]))
        return -np.sum(np.log(share[:, 1] - share[:, 0] + 1e-12))

    # Thresholds all within one step say no more than that: the curve is no steeper than that.
    bounds = [(None, None), (np.log(0.15 * step), None)]
    middle = float(np.median(edges[np.isfinite(edges)]))
    best = optimize.minimize(cost, (middle, np.log(0.5)), bounds=bounds, method="L-BFGS-B").x
    return summary | {"size": float(np.exp(best[0] + special.logit(POWER) * np.exp(best[1])))}


def wilson(count: int, total: int) -> tuple[float, float]:
    """95 % interval of a proportion."""
    interval = stats.binomtest(count, total).proportion_ci(method="wilson")
    return float(interval.low), float(interval.high)


def false_alarms(runs, level: float) -> dict:
    """Findings on untouched recordings: the share that has any, and how many of each kind."""
    found = [audit(run, level) for run in runs]
    kinds = sorted({finding.kind for findings in found for finding in findings})
    any_at_all = sum(bool(findings) for findings in found)
    return {
        "recordings": len(runs),
        "alarmed": any_at_all,
        "interval": wilson(any_at_all, len(runs)),
        "kinds": {k: sum(any(f.kind == k for f in findings) for findings in found) for k in kinds},
    }


def label_rates(runs, level: float, clean: dict) -> dict:
    """Share of recordings in which each wrong label is named, and named alone."""
    rates = {}
    for name, kind, channels, make in LABELS:
        outcomes = []
        for run in runs:
            faulty = make(run) if has_all(run, channels) else None
            if faulty is None or kind in {kind for kind, _ in clean[run.name]}:
                continue
            found = audit(faulty, level)
            hits = [f for f in found if f.kind == kind and set(f.channels) <= channels]
            outcomes.append((bool(hits), bool(hits) and len(found) == len(hits)))
        if outcomes:
            named, alone = np.sum(outcomes, axis=0)
            rates[name] = {"named": int(named), "alone": int(alone), "of": len(outcomes)}
    return rates


def calibration(trials) -> dict:
    """Errors over standard errors where the fault was found, and how often nothing else was."""
    found = [t for t in trials if t.named]
    if not found:
        return {"errors": [], "within 3": None, "alone": None}
    return {
        "errors": [round(t.error, 3) for t in found],
        "within 3": float(np.mean([t.near for t in found])),
        "alone": float(np.mean([t.alone for t in found])),
    }


def study(name: str, runs, level: float, faults) -> dict:
    """Everything on one set of recordings."""
    clean = {run.name: {(f.kind, f.channels) for f in audit(run, level)} for run in runs}
    alarms = false_alarms(runs, level)
    print(f"{name}, untouched: {alarms['alarmed']} of {alarms['recordings']} {alarms['kinds']}",
          flush=True)  # fmt: skip
    result = {"false alarms": alarms, "labels": label_rates(runs, level, clean)}
    for fault in faults:
        found = thresholds(runs, fault, level, clean)
        result[fault.name] = found | calibration(found.pop("trials"))
        print(f"  {fault.name}: {shown(result[fault.name]['size'])} {fault.unit}, "
              f"{time.process_time():.0f} s of processor time", flush=True)  # fmt: skip
    return result


def shown(number) -> str:
    return "-" if number is None else f"{number:.2g}"


def smallest(found: dict, fault: Fault) -> str:
    """The size that is found with 95 % power, or in how many recordings none is."""
    if not found["recordings"]:
        return "-"
    beyond = f"> {fault.sizes[-1]:.2g} in {found['never']} of {found['recordings']}"
    return beyond if found["size"] is None else shown(found["size"])


def spread(errors) -> str:
    """Root mean square of errors over stated ones with its 90 % interval; it should be one."""
    errors = np.minimum(np.abs(np.asarray(errors, float)), 10.0)
    if errors.size < 3:
        return "-"
    total = float(np.sum(errors**2))
    low, high = (np.sqrt(total / stats.chi2.ppf(q, errors.size)) for q in (0.95, 0.05))
    return f"{np.sqrt(total / errors.size):.2g} ({low:.2g} to {high:.2g}, {errors.size})"


def report(results: dict, faults) -> str:
    """The tables, in Markdown."""
    names = [name for name in ("simulated", *REAL) if name in results]
    rule = "|" + " --- |" * (2 + len(names))
    lines = ["| fault | unit | " + " | ".join(names) + " |", rule]
    for fault in faults:
        cells = [smallest(results[name][fault.name], fault) for name in names]
        lines.append(f"| {fault.name} | {fault.unit} | " + " | ".join(cells) + " |")
    lines += ["", "| fault | simulated, of the truth | real, between halves |", "|" + " --- |" * 3]
    simulated = [results[name] for name in names if name == "simulated"]
    others = [results[name] for name in names if name != "simulated"]
    for fault in faults:
        own = [error for one in simulated for error in one[fault.name]["errors"]]
        between = [error for one in others for error in one[fault.name]["halves"]]
        lines.append(f"| {fault.name} | {spread(own)} | {spread(between)} |")
    lines += ["", "| label | " + " | ".join(names) + " |", "|" + " --- |" * (1 + len(names))]
    for label, *_ in LABELS:
        rates = [results[name]["labels"].get(label) for name in names]
        cells = [f"{r['named']} of {r['of']}, alone {r['alone']}" if r else "-" for r in rates]
        lines.append(f"| {label} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="few recordings, three minutes")
    parser.add_argument("--level", type=float, help="significance instead of the audit's own")
    parser.add_argument("--sets", nargs="+", choices=["simulated", *REAL], help="only these")
    arguments = parser.parse_args()
    from diffsea.recordings.auditing.kinematics.selection import SIGNIFICANCE

    level = arguments.level or SIGNIFICANCE
    few = arguments.quick
    OUT.mkdir(parents=True, exist_ok=True)
    path = OUT / "quick.json" if few else RESULTS
    done = json.loads(path.read_text()) if path.exists() and not few else {}
    names = arguments.sets or ["simulated", *(["blueboat", "hsva"] if few else REAL)]
    if not sets.available():
        print("the real data are absent: simulated recordings alone", file=sys.stderr)
        names = [name for name in names if name == "simulated"]
    for name in names:
        if name in done:
            continue
        began = time.process_time()
        if name == "simulated":
            drawn = simulated((1,) if few else (1, 2), 2 if few else 12)
            done[name] = study(name, [draws[0] for draws in drawn], level, GRADED)
            untouched = [run for draws in drawn for run in draws]
            done[name]["false alarms"] = {
                f"{tried:g}": false_alarms(untouched, tried) for tried in (level, 1e-2)
            }
        else:
            done[name] = study(name, real(name, few), level, GRADED)
        done[name]["processor seconds"] = round(time.process_time() - began)
        path.write_text(json.dumps(done, indent=1, allow_nan=False) + "\n")
    print(report(done, GRADED))


if __name__ == "__main__":
    main()
