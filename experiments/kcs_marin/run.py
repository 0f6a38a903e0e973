"""KCS, roll withheld and given: is something missed, and is it named when heel is recorded?"""

import dataclasses
from pathlib import Path


HERE = Path(__file__).resolve().parent

from experiments.harness.diagnosis_tables import names_table, predictions_table, told
from experiments.harness.real_runs import (
    Case,
    audited,
    document_of,
    load,
    named,
    plot_candidates,
    show_audit,
    study,
    write_results,
)
from experiments.harness.reporting import experiment_in_parts

from diffsea import Trajectory


# Fitted: the large zig-zag, which heels most, and a small one to the other side.
HELD_OUT = ("SIMMAN2020_container_KCS_MARIN_zigzag_port_10_FS.txt",)
ROLL = ("phi", "p")


def main() -> None:
    """Diagnose with roll withheld, then with roll given."""
    run, _ = experiment_in_parts(__file__, __doc__, ["all"])
    runs = load(HERE, "kcs_marin/*.txt")
    findings = audited(runs)
    show_audit("as published", findings)
    document = document_of(str(HERE.parent / "real_fits" / "kcs.toml"))
    withheld = {name: without_roll(run) for name, run in runs.items()}
    cases = {"roll withheld": ("without_roll", withheld), "roll given": ("with_roll", runs)}
    records = {
        title: study(Case(f"kcs_marin/{name}", document, some, HELD_OUT, findings=findings))
        for title, (name, some) in cases.items()
    }
    plot_candidates("kcs_marin", records)
    roll = {title: _roll(record) for title, record in records.items()}
    for title, found in roll.items():
        print(f"{title}: {', '.join(named(records[title])) or 'nothing named'}")
        for row in found:
            print(f"  {row['name']}: {row['status']}, {row['reason']}")
    write_results("kcs_marin", {"audit": findings, "roll_coupling": roll} | records)
    horizons = {title: one["held_out"]["horizons"] for title, one in records.items()}
    tables = {"NAMES": names_table(records), "PREDICTIONS": predictions_table(horizons)}
    run.write_part("all", {title: told(one) for title, one in records.items()}, tables)


def without_roll(run: Trajectory) -> Trajectory:
    """A run as if heel and roll rate had not been measured."""
    rest = {name: values for name, values in run.extra.items() if name not in ROLL}
    return dataclasses.replace(run, extra=rest)


def _roll(record: dict) -> list[dict]:
    """What became of roll coupling as a candidate."""
    return [row for row in record["candidates"] if row["name"] == "roll-coupling"]


if __name__ == "__main__":
    main()
