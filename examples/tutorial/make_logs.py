"""Rewrite the demo recordings as a logger of another make would have stored them.

    python examples/tutorial/make_logs.py OUT

Semicolons, milliseconds, degrees, knots, speed to port, thrusters in percent, and a compass
mounted 7 deg off. The recordings themselves are those of examples/demo.
"""

import csv
import math
import sys
from pathlib import Path


DEMO = Path(__file__).parents[1] / "demo"
NAMES = {
    "day1_01": "recordings/zigzag-slow.csv",
    "day1_02": "recordings/circle-fast.csv",
    "day1_03": "recordings/random-fast.csv",
    "day1_04": "recordings/speed-steps.csv",
    "day2_01": "held_out/zigzag-fast.csv",
    "day2_02": "held_out/random-slow.csv",
}
KNOT = 1852 / 3600  # m/s
COMPASS_OFFSET = 7.0  # deg, read too large
FULL_THRUST = 250.0  # N at 100 %


def logged(row: dict[str, str]) -> dict[str, str]:
    """One sample in the logger's columns and units."""
    value = {name: float(cell) for name, cell in row.items()}
    return {
        "Time [ms]": f"{1000 * value['t']:.0f}",
        "Northing": f"{value['x']:.2f}",
        "Easting": f"{value['y']:.2f}",
        "Compass": f"{(math.degrees(value['psi']) + COMPASS_OFFSET) % 360:.1f}",
        "SOG fwd": f"{value['u'] / KNOT:.2f}",
        "SOG port": f"{-value['v'] / KNOT:.2f}",
        "Gyro": f"{math.degrees(value['r']):.2f}",
        "Motor L [%]": f"{100 * value['cmd_port'] / FULL_THRUST:.0f}",
        "Motor R [%]": f"{100 * value['cmd_starboard'] / FULL_THRUST:.0f}",
        "Battery": "12.4",
    }


def main(folder: Path) -> None:
    """Write one log per demo recording into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, source in NAMES.items():
        with (DEMO / source).open(newline="", encoding="utf-8") as file:
            rows = [logged(row) for row in csv.DictReader(file)]
        with (folder / f"{name}.csv").open("w", newline="", encoding="utf-8") as file:
            writer = csv.DictWriter(file, rows[0], delimiter=";", lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)


if __name__ == "__main__":
    if len(sys.argv) != 2:
        sys.exit("usage: python examples/tutorial/make_logs.py OUT")
    main(Path(sys.argv[1]))
