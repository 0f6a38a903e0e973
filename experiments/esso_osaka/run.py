"""Esso Osaka, wind concealed: diagnose some runs, predict the others, score the wind."""

import sys
from pathlib import Path


HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent))

import numpy as np
import pandas as pd
from prediction import DATA, Case, audited, load, study, write_results


# One turn and the zig-zags, which keep the experiment short; the other runs stay unused.
TRAIN = (
    "zigzag_31-Jul-2020_13_04_24.csv", "zigzag_31-Jul-2020_13_22_52.csv",
    "zigzag_31-Jul-2020_14_03_39.csv", "turn_14-Sep-2020_13_51_45.csv",
)  # fmt: skip
HELD_OUT = ("zigzag_31-Jul-2020_13_42_53.csv", "turn_14-Oct-2020_14_56_07.csv")


def main() -> None:
    """Print the audit, the diagnosis and the inferred wind beside the measured one."""
    pattern = "esso_osaka/recordings/*.csv"
    published, runs = load(HERE, pattern), load(HERE, pattern, "mapping_repaired.toml")
    for title, audit_of in (("as published", published), ("repaired", runs)):
        print(f"audit {title}:")
        for finding in audited(audit_of):
            print(f"  {finding['recording']}: {finding['kind']}: {finding['message']}")
    used = {name: run for name, run in runs.items() if name in (*TRAIN, *HELD_OUT)}
    record = study(Case(HERE, "esso_osaka", used, HELD_OUT, per_run=True))
    record["wind"] = _wind_table(record)
    write_results(HERE, record)


def _wind_table(record: dict) -> list[dict]:
    """Inferred against measured mean wind. The measurement is read only here, at the end."""
    rows = []
    for effect in record["effects"]:
        if effect["name"] == "wind" and "recording" in effect:
            found = {key: entry["value"] for key, entry in effect["parameters"].items()}
            rows.append({"recording": effect["recording"], **found, **_measured(effect)})
    for row in rows:
        print("  " + ", ".join(f"{k} {v:.2f}" if k != "recording" else v for k, v in row.items()))
    return rows


def _measured(effect: dict) -> dict:
    """Vector mean of the measured true wind."""
    table = pd.read_csv(DATA / "esso_osaka" / "measured_wind" / effect["recording"])
    speed, direction = table["wind_velo_true [m/s]"], table["wind_dir_true [rad]"]
    north, east = (speed * np.cos(direction)).mean(), (speed * np.sin(direction)).mean()
    return {
        "measured_speed": float(np.hypot(north, east)),
        "measured_direction": float(np.arctan2(east, north) % (2 * np.pi)),
    }


if __name__ == "__main__":
    main()
