"""BlueBoat field runs: audit as published, repair, diagnose on some runs, predict the others."""

import sys
from pathlib import Path


HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

from prediction import Case, audited, load, study


# Manoeuvring runs of one to two and a half minutes; the others stay unused.
TRAIN = ("fixed_00000218.csv", "fixed_00000223.csv", "fixed_00000226.csv", "fixed_00000230.csv")
HELD_OUT = ("fixed_00000228.csv", "fixed_00000232.csv")


def main() -> None:
    """Print what the audit finds before and after the repair, then the diagnosis."""
    published = load(HERE, "blueboat/*.csv")
    for title, runs in (("as published", published), ("repaired", _repaired())):
        print(f"audit {title}:")
        for finding in audited(runs):
            print(f"  {finding['recording']}: {finding['kind']}: {finding['message']}")
    used = {name: run for name, run in _repaired().items() if name in (*TRAIN, *HELD_OUT)}
    study(Case(HERE, "blueboat", used, HELD_OUT, per_run=True))


def _repaired() -> dict:
    return load(HERE, "blueboat/*.csv", "mapping_repaired.toml")


if __name__ == "__main__":
    main()
