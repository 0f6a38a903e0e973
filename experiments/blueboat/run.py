"""BlueBoat field runs: audit as published, repair, diagnose on some runs, predict the others."""

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
from experiments.harness.reporting import experiment_in_parts


# Manoeuvring runs of one to two and a half minutes; the others stay unused.
TRAIN = ("fixed_00000218.csv", "fixed_00000223.csv", "fixed_00000226.csv", "fixed_00000230.csv")
HELD_OUT = ("fixed_00000228.csv", "fixed_00000232.csv")


def main() -> None:
    """Print what the audit finds before and after the repair, then the diagnosis."""
    run, _ = experiment_in_parts(__file__, __doc__, ["all"])
    published = load(HERE, "blueboat/*.csv")
    repaired = load(HERE, "blueboat/*.csv", "mapping_repaired.toml")
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


if __name__ == "__main__":
    main()
