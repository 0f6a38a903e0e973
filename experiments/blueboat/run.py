"""BlueBoat field runs: audit as published, repair, diagnose on some runs, predict the others.

python -m experiments.blueboat.run all compass
"""

import math
from pathlib import Path


HERE = Path(__file__).resolve().parent

from experiments.harness.diagnosis_tables import (
    audit_table,
    candidates_table,
    names_table,
    predictions_table,
    told,
)
from experiments.harness.real_runs import (
    Case,
    audited,
    document_of,
    load,
    plot_candidates,
    show_audit,
    study,
    write_results,
)
from experiments.harness.reporting import Experiment, experiment_in_parts, table

from diffsea import Trajectory


# Manoeuvring runs of one to two and a half minutes; the others stay unused.
TRAIN = ("fixed_00000218.csv", "fixed_00000223.csv", "fixed_00000226.csv", "fixed_00000230.csv")
HELD_OUT = ("fixed_00000228.csv", "fixed_00000232.csv")


# All but the four shortest: the longest has all manoeuvres in one.
MORE = tuple(f"fixed_00000{number}.csv" for number in (218, 220, 224, 226, 230, 235))
REST = tuple(f"fixed_00000{number}.csv" for number in (221, 223, 228, 232))

Runs = dict[str, Trajectory]


def main() -> None:
    """Run the parts that are named, all by default."""
    run, parts = experiment_in_parts(__file__, __doc__, ["all", "compass"])
    repaired = load(HERE, "blueboat/*.csv", "mapping_repaired.toml")
    if "all" in parts:
        _four_runs(run, repaired)
    if "compass" in parts:
        _compass(run, repaired)


def _four_runs(run: Experiment, repaired: Runs) -> None:
    """What the audit finds before and after the repair, then the diagnosis."""
    published = load(HERE, "blueboat/*.csv")
    audits = {"as published": audited(published), "repaired": audited(repaired)}
    for title, findings in audits.items():
        show_audit(title, findings)
    used = {name: repaired[name] for name in (*TRAIN, *HELD_OUT)}
    record = study(Case("blueboat", document_of("blueboat"), used, HELD_OUT, per_run=True))
    plot_candidates("blueboat", {"BlueBoat, as repaired": record})
    write_results("blueboat", record | {"audits": audits})
    tables = {
        "AUDIT": audit_table(audits),
        "NAMES": names_table({"as repaired": record}),
        "CANDIDATES": candidates_table(record),
        "PREDICTIONS": predictions_table({"": record["held_out"]["horizons"]}),
    }
    run.write_part("all", told(record) | {"audits": audits}, tables)


def _compass(run: Experiment, repaired: Runs) -> None:
    """What motors do to the compass: by each run alone, and by a diagnosis of six runs."""
    found = [one for one in audited(repaired) if "time_constant" in one["parameters"]]
    used = {name: repaired[name] for name in (*MORE, *REST)}
    record = study(Case("blueboat-compass", document_of("blueboat"), used, REST, per_run=True))
    tables = {
        "COMPASS": table(
            ("run", "amplitude at its largest thrust, deg", "phase, deg", "followed within, s"),
            [_row(one) for one in found if "amplitude_at_largest_thrust" in one["parameters"]],
        ),
        "COMPASS_NAMES": names_table({"six runs": record}),
        "COMPASS_PREDICTIONS": predictions_table({"": record["held_out"]["horizons"]}),
    }
    run.write_part("compass", told(record) | {"audit": found}, tables)


def _row(finding: dict) -> tuple[str, str, str, str]:
    by = finding["parameters"]
    degrees = f"{math.degrees(finding['value']):.0f} +- {math.degrees(finding['std']):.0f}"
    phase = f"{math.degrees(by['phase']) % 360:.0f}"
    return finding["recording"], degrees, phase, f"{by['time_constant']:.1f}"


if __name__ == "__main__":
    main()
