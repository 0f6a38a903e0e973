# pyright: reportArgumentType=false
"""Six recordings of a craft unlike its file, and the cost that all contestants are judged by.

The recordings come from the independent simulator of the tests. A contestant reads them from a
file, so that making them is nobody's time.
"""

import copy
import dataclasses
import json
import math
from pathlib import Path

import numpy as np


ROOT = Path(__file__).resolve().parents[2]
VESSEL = ROOT / "tests" / "oracle" / "usv.toml"
OUT = ROOT / "out" / "fit_benchmark"

NAMES = ("X_udot", "Y_vdot", "N_rdot", "X_u", "X_uu", "Y_v", "N_r", "N_rr")
CHANNELS = ("x", "y", "psi", "u", "v", "r")
RUNS = ("speed-steps", "spin", "circle-fast", "zigzag-fast", "random-fast", "random-slow")
SECONDS, RATE = 120.0, 5.0
OFF = 0.15, 0.40  # by how much the craft's derivatives differ from its file's
# The simulator's own (tests/oracle/sensors.py, `suite`): m, m, rad, m/s, m/s, rad/s.
SIGMA = np.array([0.05, 0.05, math.radians(0.5), 0.02, 0.02, math.radians(0.2)])


@dataclasses.dataclass(frozen=True)
class Data:
    """What every contestant is given, and the truth, which none is."""

    t: np.ndarray  # row, s
    measured: np.ndarray  # run, row, channel; heading not wrapped
    thrust: np.ndarray  # run, row, (port, starboard), N
    start: np.ndarray  # the file's derivatives, in the order of NAMES
    truth: np.ndarray
    hull: dict  # the file's [hull]
    arms: tuple[float, float]  # y of the thrusters, m

    @property
    def dt(self) -> float:
        """Interval between rows, s."""
        return float(self.t[1] - self.t[0])


def make(path: Path, seed: int, gusts: float = 0.0) -> None:
    """Simulate the craft and write what was recorded; `gusts` as tests/oracle has them."""
    from tests.oracle import sensors
    from tests.oracle.make_recordings import perform, stream
    from tests.oracle.simulator import load

    document = load(VESSEL)
    rng = stream(seed, "derivatives")
    true = copy.deepcopy(document)
    for name in NAMES:
        true["hull"][name] *= 1 + rng.uniform(*OFF) * rng.choice([-1.0, 1.0])
    t = np.arange(int(SECONDS * RATE) + 1) / RATE
    measured, thrust = [], []
    for name in RUNS:
        sim = perform(true, name, seed, None, SECONDS, RATE, gusts)
        suite = sensors.suite()
        assert np.allclose([suite[c].noise for c in CHANNELS], SIGMA)
        rec = sensors.record(sim, t, suite, stream(seed, name, "noise"), wrapped=False)
        measured.append(np.stack([rec[c] for c in CHANNELS], -1))
        thrust.append(np.stack([rec["cmd_port"], rec["cmd_starboard"]], -1))
    path.parent.mkdir(parents=True, exist_ok=True)
    thrusters = {part["name"]: part["y"] for part in document["thruster"]}
    np.savez(
        path, t=t, measured=np.array(measured), thrust=np.array(thrust),
        start=[document["hull"][n] for n in NAMES], truth=[true["hull"][n] for n in NAMES],
        hull=json.dumps(document["hull"]),
        arms=[thrusters["port"], thrusters["starboard"]],
    )  # fmt: skip


def load(path: Path) -> Data:
    """Read what `make` wrote."""
    with np.load(path) as file:
        arrays = {k: file[k] for k in ("t", "measured", "thrust", "start", "truth")}
        hull, arms = json.loads(str(file["hull"])), tuple(float(y) for y in file["arms"])
    return Data(**arrays, hull=hull, arms=arms)


def relative_error(data: Data, values: np.ndarray) -> float:
    """Root mean square of the parameters' relative errors."""
    return float(np.sqrt(np.mean((np.asarray(values) / data.truth - 1) ** 2)))
