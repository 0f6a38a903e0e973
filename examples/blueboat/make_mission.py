"""Write the mission that runs the trials, for a place of yours: QGC WPL 110.

    python -m examples.blueboat.make_mission LATITUDE LONGITUDE > trials.waypoints

Degrees. Each trial begins at rest at this place; what it does is in trials.lua.
"""

import sys

from examples.blueboat.make_runs import TRIALS


WAYPOINT, SCRIPT_TIME = 16, 42702  # MAVLink's numbers of mission items
RELATIVE = 3  # frame: altitude above home
REST = 20  # s of loitering before a trial
SPARE = 10  # s after which the mission goes on without a script that does not answer
EXAMPLE = (63.4450, 10.3700)  # open water off Trondheim


def mission(latitude: float, longitude: float) -> str:
    """The text of the file."""
    there = (f"{latitude:.7f}", f"{longitude:.7f}", "0")
    items = [(WAYPOINT, 0, 0, 0, 0, *there)]  # home, which the autopilot sets itself
    for number, trial in enumerate(TRIALS.values(), 1):
        seconds = sum(step[0] for step in trial.orders)
        items += [
            (WAYPOINT, REST, 0, 0, 0, *there),
            (SCRIPT_TIME, number, seconds + SPARE, 0, 0, 0, 0, 0),
        ]
    items.append((WAYPOINT, 0, 0, 0, 0, *there))
    lines = [
        "\t".join(map(str, (n, int(n == 0), RELATIVE, *item, 1))) for n, item in enumerate(items)
    ]
    return "\n".join(["QGC WPL 110", *lines]) + "\n"


if __name__ == "__main__":
    if len(sys.argv) != 3:
        sys.exit("usage: python -m examples.blueboat.make_mission LATITUDE LONGITUDE")
    print(mission(float(sys.argv[1]), float(sys.argv[2])), end="")
