"""Power and false alarms of the audit: known faults in real recordings and in simulated ones.

python -m experiments.audit_power.run [--quick]
"""

import argparse
import dataclasses
import json
import time
import zlib
from pathlib import Path

import numpy as np
from scipy import optimize, special, stats


HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]

from experiments.audit_power.faults import GRADED, LABELS, Fault

from tests.oracle import make_recordings
from tests.oracle.sensors import record, suite, write_csv
from tests.oracle.simulator import load

from diffsea import read_recording
from diffsea.recordings import audit


DATA = ROOT.parent / "shared" / "data"
OUT = ROOT / "out" / "audit_power"
MANOEUVRES = ("random-fast", "zigzag-fast", "circle-fast")
REAL = (
    "blueboat/fixed_00000218.csv",
    "blueboat/fixed_00000221.csv",
    "blueboat/fixed_00000223.csv",
    "blueboat/fixed_00000230.csv",
    "esso_osaka/recordings/random_06-Aug-2020_16_24_25_4.csv",
    "esso_osaka/recordings/turn_14-Oct-2020_14_56_07.csv",
    "esso_osaka/recordings/zigzag_31-Jul-2020_13_04_24.csv",
    "esso_osaka/recordings/zigzag_31-Jul-2020_13_22_52.csv",
    "kvlcc2_hsva/HSVA_CPMC_KVLCC2_Z_10_10_P.dat",
)
POWER = 0.95


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


def real(names) -> list:
    """The recordings through their repaired mappings, with the kinds that are left in them."""
    runs = []
    for name in names:
        folder = ROOT / "experiments" / name.split("/")[0]
        runs.append(read_recording(DATA / name, folder / "mapping_repaired.toml"))
    return runs


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


def thresholds(runs, fault: Fault, level: float, clean: dict) -> dict:
    """Per recording by bisection: the largest size missed and the smallest found."""
    trials, spans = [], []
    for run in runs:
        kinds = {kind for kind, _ in clean[run.name]}
        usable = all(np.sum(np.isfinite(getattr(run, n))) > 30 for n in fault.channels if n != "t")
        if fault.kind in kinds or not usable:
            continue
        low, high = -1, len(fault.sizes)
        while high - low > 1:
            middle = (low + high) // 2
            trial = attempt(run, fault, fault.sizes[middle], level, clean[run.name])
            trials.append(trial)
            low, high = (low, middle) if trial.named else (middle, high)
        spans.append((low, high))
    return {"trials": trials} | fitted(fault.sizes, spans)


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
            faulty = make(run)
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
    """Spread of (value - truth) / standard error, which should be one."""
    errors = np.array([t.error for t in trials if t.named])
    if errors.size < 5:
        return {"found": int(errors.size)}
    return {
        "found": int(errors.size),
        "spread": float(np.sqrt(np.mean(np.minimum(np.abs(errors), 10) ** 2))),
        "within 3": float(np.mean([t.near for t in trials if t.named])),
        "alone": float(np.mean([t.alone for t in trials if t.named])),
    }


def study(runs, level: float, faults) -> dict:
    """Everything on one set of recordings."""
    clean = {run.name: {(f.kind, f.channels) for f in audit(run, level)} for run in runs}
    result = {"labels": label_rates(runs, level, clean)}
    for fault in faults:
        found = thresholds(runs, fault, level, clean)
        result[fault.name] = found | calibration(found.pop("trials"))
        print(f"  {fault.name}: {shown(result[fault.name]['size'])} {fault.unit}, "
              f"{time.process_time():.0f} s of processor time", flush=True)  # fmt: skip
    return result


def shown(number) -> str:
    return "-" if number is None else f"{number:.2g}"


def report(sets: dict, faults) -> str:
    """The tables, in Markdown."""
    names = list(sets)
    lines = [
        "| fault | unit | " + " | ".join(f"{n}: size, spread, within 3 se" for n in names) + " |"
    ]
    lines.append("|" + " --- |" * (2 + len(names)))
    for fault in faults:
        cells = []
        for name in names:
            found = sets[name][fault.name]
            beyond = f"> {fault.sizes[-1]:.2g} in {found['never']} of {found['recordings']}"
            size = beyond if found["size"] is None else shown(found["size"])
            cells.append(f"{size}, {shown(found.get('spread'))}, {shown(found.get('within 3'))}")
        lines.append(f"| {fault.name} | {fault.unit} | " + " | ".join(cells) + " |")
    lines += ["", "| label | " + " | ".join(names) + " |", "|" + " --- |" * (1 + len(names))]
    for label, *_ in LABELS:
        rates = [sets[name]["labels"].get(label) for name in names]
        cells = [f"{r['named']} of {r['of']}, alone {r['alone']}" if r else "-" for r in rates]
        lines.append(f"| {label} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="few recordings, three minutes")
    parser.add_argument("--level", type=float, help="significance instead of the audit's own")
    arguments = parser.parse_args()
    from diffsea.recordings.auditing.causes import SIGNIFICANCE

    level = arguments.level or SIGNIFICANCE
    started = time.process_time()
    drawn = simulated((1,) if arguments.quick else (1, 2), 2 if arguments.quick else 12)
    untouched = [run for draws in drawn for run in draws]
    alarms = {f"{tried:g}": false_alarms(untouched, tried)
              for tried in (level, 1e-2)}  # fmt: skip
    for tried, found in alarms.items():
        low, high = found["interval"]
        print(f"simulated, untouched, level {tried}: {found['alarmed']} of {found['recordings']} "
              f"({100 * low:.2g} to {100 * high:.2g} %) {found['kinds']}", flush=True)  # fmt: skip
    results = {"level": level, "false alarms": alarms}
    sets = {"simulated": study([draws[0] for draws in drawn], level, GRADED)}
    if DATA.exists():
        runs = real(REAL[::4] if arguments.quick else REAL)
        alarms["real"] = false_alarms(runs, level)
        print("real, repaired:", alarms["real"], flush=True)
        sets["real"] = study(runs, level, GRADED)
    else:
        print(f"{DATA} is absent: the published recordings stay outside; simulated ones only")
    print(report(sets, GRADED))
    results |= sets | {"processor seconds": time.process_time() - started}
    print(f"{results['processor seconds']:.0f} s of processor time")
    (OUT / "results.json").write_text(json.dumps(results, indent=1))


if __name__ == "__main__":
    main()
