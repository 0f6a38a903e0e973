# pyright: reportArgumentType=false
"""The basin runs: what the paper drove, recorded with sensor noise, and runs kept back.

The paper switches its sensors' errors off but its figure 2 still fluctuates. Here a satellite
receiver, a compass and a gyro of good quality measure every run.
"""

import dataclasses
import math

from experiments.vrx_wamv.plant import CHANNELS, NEW, AnyPlant, driven, speed_for

import numpy as np

from diffsea import Trajectory


RATE = 5.0  # Hz
# m, m, rad, m/s, m/s, rad/s
NOISE = (0.05, 0.05, math.radians(0.5), 0.02, 0.02, math.radians(0.2))
THRUSTS = (30.0, 60.0, 100.0, 150.0, 200.0, 250.0)  # N of each engine, the paper's range
SPIN, STRAIGHT, WIDE = 30.0, 40.0, 60.0  # s; the paper's spin and turn, our straight runs


@dataclasses.dataclass(frozen=True)
class Run:
    """One recorded run."""

    name: str
    true: dict[str, np.ndarray]  # `plant.driven`
    measured: dict[str, np.ndarray]

    @property
    def t(self) -> np.ndarray:
        """Time stamps, s."""
        return self.true["t"]

    @property
    def port(self) -> np.ndarray:
        """Orders, rev/s."""
        return self.true["port"]

    @property
    def starboard(self) -> np.ndarray:
        """Orders, rev/s."""
        return self.true["starboard"]

    def trajectory(self) -> Trajectory:
        """The run as the library takes recordings, its orders in rev/s."""
        return Trajectory(
            self.t, **self.measured,
            commanded={"port": self.port, "starboard": self.starboard},
            executed={}, extra={}, valid=np.ones(len(self.t), bool), name=self.name,
        )  # fmt: skip


def recorded(
    plant: AnyPlant, name: str, orders, seconds: float, rng: np.random.Generator, noise: float = 1.0
) -> Run:
    """Drive the plant from rest and measure it; `noise` scales the sensors' errors."""
    return _measured(name, driven(plant, orders, seconds, 1 / RATE), rng, noise)


def _measured(
    name: str, true: dict[str, np.ndarray], rng: np.random.Generator, noise: float = 1.0
) -> Run:
    measured = {
        channel: true[channel] + noise * std * rng.standard_normal(len(true["t"]))
        for channel, std in zip(CHANNELS, NOISE, strict=True)
    }
    return Run(name, true, measured)


@dataclasses.dataclass(frozen=True)
class Campaign:
    """The paper's runs: straight ones from rest, a spin, a wide turn."""

    straight: list[Run]
    spin: Run
    wide: Run

    @property
    def runs(self) -> list[Run]:
        """All of them."""
        return [*self.straight, self.spin, self.wide]


def campaign(seed: int, plant: AnyPlant = NEW, noise: float = 1.0) -> Campaign:
    """The paper's runs of a plant, measured."""
    rng = np.random.default_rng(seed)
    straight = [
        recorded(plant, f"straight-{thrust:g}", _held(n, n), STRAIGHT, rng, noise)
        for thrust, n in ((thrust, speed_for(thrust)) for thrust in THRUSTS)
    ]
    spin = recorded(plant, "spin", _held(30.0, -30.0), SPIN, rng, noise)
    wide = recorded(plant, "wide-turn", _held(30.0, 0.0), WIDE, rng, noise)
    return Campaign(straight, spin, wide)


def measured_again(data: Campaign, seed: int) -> Campaign:
    """The same motion with another draw of noise: what `campaign(seed, ...)` gives of its plant."""
    rng = np.random.default_rng(seed)
    *straight, spin, wide = (_measured(run.name, run.true, rng) for run in data.runs)
    return Campaign(straight, spin, wide)


def explored(seed: int, plant: AnyPlant = NEW) -> list[Run]:
    """Runs for a diagnosis that share no manoeuvre with `held_out`: widening turns, a stop and a
    turn astern, and thrust that steps on either side."""
    rng = np.random.default_rng(seed)

    def widening(t: float) -> tuple[float, float]:
        side = 1 if (t // 12) % 2 == 0 else -1
        return 20.0 + side * min(t / 6, 9.0), 20.0 - side * min(t / 6, 9.0)

    def stopping(t: float) -> tuple[float, float]:
        table = ((26, 26), (0, 0), (-18, -18), (-10, -20), (0, 0), (15, 22))
        return table[min(int(t // 10), len(table) - 1)]

    def sides(t: float) -> tuple[float, float]:
        table = ((10, 20), (20, 20), (28, 14), (14, 14), (6, 24), (24, 24), (18, 28))
        return table[min(int(t // 9), len(table) - 1)]

    def slalom(t: float) -> tuple[float, float]:
        return (27.0, 17.0) if (t // 6) % 2 else (17.0, 27.0)

    driven_as = {"widening": widening, "stopping": stopping, "sides": sides, "slalom": slalom}
    return [recorded(plant, name, orders, 64.0, rng) for name, orders in driven_as.items()]


def held_out(seed: int, plant: AnyPlant = NEW) -> list[Run]:
    """Runs that nothing is fitted to: turns of changing side at two speeds, and steps."""
    rng = np.random.default_rng(seed)

    def weaving(base: float, difference: float, period: float):
        def orders(t: float) -> tuple[float, float]:
            side = 1 if (t // period) % 2 == 0 else -1
            return base + side * difference, base - side * difference

        return orders

    def steps(t: float) -> tuple[float, float]:
        table = ((12, 12), (28, 22), (20, 28), (25, 25), (8, 16), (-12, -12), (18, 6), (30, 30))
        return table[min(int(t // 8), len(table) - 1)]

    driven_as = {"weaving-fast": weaving(24.0, 5.0, 9.0), "weaving-slow": weaving(13.0, 5.0, 9.0),
                 "steps": steps}  # fmt: skip
    return [recorded(plant, name, orders, 64.0, rng) for name, orders in driven_as.items()]


def _held(port: float, starboard: float):
    return lambda t: (port, starboard)
