"""Vessel files for tests."""

import math


# A catamaran of 4 m whose thrusters answer at once.
BOAT = """
format = 1
name = "boat"

[hull]
length = 4.0
beam = 2.0
draught = 0.2
mass = 200.0
I_z = 300.0
x_G = 0.1
X_udot = -15.0
Y_vdot = -150.0
N_rdot = -120.0
X_u = -40.0
X_uu = -60.0
Y_v = -80.0
Y_vv = -200.0
N_r = -300.0
N_rr = -300.0

[[thruster]]
name = "port"
x = -1.9
y = -0.9
max_force = 400.0
min_force = -300.0

[[thruster]]
name = "starboard"
x = -1.9
y = 0.9
max_force = 400.0
min_force = -300.0
"""

CROSS_FLOW = """
[[effect]]
name = "crossflow-drag"
cd = 0.8
"""

SWELL = """
[[effect]]
name = "wave-force"
amplitude = 300.0
frequency = 0.1
"""


def square_boat_document(**engine):
    """The file of a boat of 2 m with four fixed thrusters set at 45 degrees, one at each corner."""
    corners = ((0.8, -0.4, 45.0), (0.8, 0.4, -45.0), (-0.8, -0.4, -45.0), (-0.8, 0.4, 45.0))
    return {
            "format": 1, "name": "square",
            "hull": {
                "length": 2.0, "beam": 1.0, "draught": 0.2, "mass": 150.0, "I_z": 60.0,
                "X_udot": -10.0, "Y_vdot": -60.0, "N_rdot": -15.0, "X_u": -30.0, "Y_v": -90.0,
                "N_r": -50.0,
            },
            "thruster": [
                {"name": f"t{k}", "x": x, "y": y, "angle": math.radians(turned),
                 "max_force": 25.0, "min_force": -25.0, **engine}
                for k, (x, y, turned) in enumerate(corners)
            ],
    }  # fmt: skip
