"""Faults of known size, put into recordings by other means than the audit knows them by."""

import dataclasses
from collections.abc import Callable

import numpy as np


CHANNELS = ("x", "y", "psi", "u", "v", "r")
DEG = np.pi / 180


@dataclasses.dataclass(frozen=True)
class Fault:
    """A fault of any size: how it is made, and what the audit should call it.

    `sizes` are those tried, in `unit`; `make(run, size, rng)` returns the faulty recording and
    the value (SI) that the finding should have. `exact` is what that may be out by whatever its
    standard error says, relative to the value.
    """

    name: str
    kind: str
    channels: tuple[str, ...]
    unit: str
    sizes: tuple[float, ...]
    make: Callable
    exact: float = 0.0


def doubling(first: float, count: int = 8) -> tuple[float, ...]:
    """Sizes that double."""
    return tuple(first * 2.0**k for k in range(count))


def changed(run, **channels):
    return dataclasses.replace(run, **channels)


def late(names: tuple[str, ...], growing: bool = False) -> Callable:
    """Channels show what was `size` s ago, or their clock falls behind by `size` ms per s."""

    def make(run, size, rng):
        t = np.asarray(run.t)
        ago = 1e-3 * size * (t - t[0]) if growing else size
        new = {n: np.interp(t - ago, t, np.asarray(getattr(run, n)), left=np.nan) for n in names}
        return changed(run, **new), 1e-3 * size if growing else size

    return make


def added(name: str, scale: float) -> Callable:
    def make(run, size, rng):
        return changed(run, **{name: np.asarray(getattr(run, name)) + scale * size}), scale * size

    return make


def scaled(names: tuple[str, ...]) -> Callable:
    """Channels read (1 + size) times what they should; odd draws read less instead."""

    def make(run, size, rng):
        ratio = 1 + size if rng.random() < 0.5 else 1 / (1 + size)
        return changed(run, **{n: ratio * np.asarray(getattr(run, n)) for n in names}), ratio

    return make


def swung(run, size, rng):
    phase = rng.uniform(-np.pi, np.pi)
    psi = np.asarray(run.psi)
    return changed(run, psi=psi + size * DEG * np.cos(psi - phase)), size * DEG


def armed(run, size, rng):
    bearing = rng.uniform(-np.pi, np.pi)
    x, y = size * np.cos(bearing), size * np.sin(bearing)
    c, s = np.cos(run.psi), np.sin(run.psi)
    return changed(run, x=run.x + c * x - s * y, y=run.y + s * x + c * y), size


def through_water(run, size, rng):
    towards = rng.uniform(-np.pi, np.pi)
    psi = np.asarray(run.psi)
    new = {"u": run.u - size * np.cos(towards - psi), "v": run.v - size * np.sin(towards - psi)}
    return changed(run, **new), size


def wild(run, size, rng):
    """Five single values of x displaced."""
    rows = 20 + rng.choice((len(run.t) - 40) // 10, 5, replace=False) * 10
    x = np.array(run.x)
    rows = rows[np.isfinite(x[rows])]
    x[rows] += size * rng.choice([-1.0, 1.0], rows.size)
    return changed(run, x=x), float(rows.size)


def frozen(run, size, rng):
    t, psi = np.asarray(run.t), np.array(run.psi)
    start = t[0] + rng.uniform(0.2, 0.7) * (t[-1] - t[0])
    rows = np.flatnonzero((t >= start) & (t <= start + size))
    psi[rows] = psi[rows[0]] if rows.size else psi[0]
    return changed(run, psi=psi), float(t[rows[-1]] - t[rows[0]]) if rows.size else 0.0


def rounded(run, size, rng):
    step = size * DEG
    return changed(run, psi=step * np.round(np.asarray(run.psi) / step)), step


def holed(run, size, rng):
    """All rows of `size` s lost."""
    t = np.asarray(run.t)
    start = t[0] + rng.uniform(0.2, 0.7) * (t[-1] - t[0])
    kept = (t < start) | (t > start + size)
    longest = float(np.max(np.diff(t[kept])))
    return rows_of(run, kept), longest


def rows_of(run, kept):
    def group(old):
        return {name: np.asarray(series)[kept] for name, series in old.items()}

    return changed(
        run,
        t=np.asarray(run.t)[kept],
        **{n: np.asarray(getattr(run, n))[kept] for n in CHANNELS},
        commanded=group(run.commanded),
        executed=group(run.executed),
        extra=group(run.extra),
        valid=np.asarray(run.valid)[kept],
    )


def jittered(run, size, rng):
    """Time stamps off by a normal error of `size` times the interval."""
    t = np.asarray(run.t)
    stamps = np.sort(t + size * np.median(np.diff(t)) * rng.standard_normal(t.size))
    return changed(run, t=stamps), float(np.std(np.diff(stamps)))


def repeated(run, size, rng):
    t = np.array(run.t)
    rows = 5 + rng.choice((t.size - 10) // 3, int(round(size)), replace=False) * 3
    t[rows] = t[rows - 1]
    return changed(run, t=t), float(rows.size)


GRADED = (
    Fault("position late", "sensor-latency", ("x", "y"), "s", doubling(0.025), late(("x", "y"))),
    Fault("velocity late", "sensor-latency", ("u", "v"), "s", doubling(0.025), late(("u", "v"))),
    Fault("yaw rate late", "sensor-latency", ("r",), "s", doubling(0.025), late(("r",))),
    Fault(
        "clock of position drifts", "clock-drift", ("x", "y"), "ms/s", doubling(0.5),
        late(("x", "y"), growing=True),
    ),
    Fault("gyro bias", "gyro-bias", ("r",), "deg/s", doubling(0.005), added("r", DEG)),
    Fault("heading offset", "heading-offset", ("psi",), "deg", doubling(0.25), added("psi", DEG)),
    Fault("hard iron", "hard-iron", ("psi",), "deg", doubling(0.25), swung),
    Fault("lever arm", "lever-arm", ("x", "y"), "m", doubling(0.05), armed),
    Fault("through the water", "through-water", ("u", "v"), "m/s", doubling(0.0025), through_water),
    Fault("scale of velocity", "scale", ("u", "v"), "1", doubling(0.005, 7), scaled(("u", "v"))),
    Fault("scale of yaw rate", "scale", ("r",), "1", doubling(0.005, 7), scaled(("r",))),
    Fault("wild positions", "outliers", ("x",), "m", doubling(0.25, 10), wild),
    Fault("frozen heading", "stuck", ("psi",), "s", doubling(0.5), frozen),
    Fault("rounded heading", "quantised", ("psi",), "deg", doubling(0.1), rounded, 0.01),
    Fault("lost rows", "gap", ("t",), "s", doubling(0.125), holed),
    Fault("jitter of stamps", "time-step", ("t",), "dt", doubling(0.02, 6), jittered),
    Fault("repeated stamps", "duplicate", ("t",), "1", doubling(1, 4), repeated),
)  # fmt: skip


def _earth(run):
    flow = (np.asarray(run.u) + 1j * np.asarray(run.v)) * np.exp(1j * np.asarray(run.psi))
    return changed(run, u=flow.real, v=flow.imag)


def _times(factor: float, *names: str) -> Callable:
    return lambda run: changed(run, **{n: factor * np.asarray(getattr(run, n)) for n in names})


def _turning(run) -> tuple[str, ...]:
    return tuple(name for name in (*run.commanded, *run.executed) if "rudder" in name)


def _reversed_rudder(run):
    if not _turning(run):
        return None
    flipped = [
        {name: -np.asarray(s) if "rudder" in name else s for name, s in group.items()}
        for group in (run.commanded, run.executed)
    ]
    return changed(run, commanded=flipped[0], executed=flipped[1])


def _exchanged(run):
    if not {"port", "starboard"} <= set(run.commanded):
        return None
    other = {"port": run.commanded["starboard"], "starboard": run.commanded["port"]}
    return changed(run, commanded=run.commanded | other)


# What is a matter of yes or no: name, kind, channels, how it is made (None: not in this run).
LABELS = (
    ("velocity in earth axes", "axes", {"u", "v"}, _earth),
    ("y to the west", "axes", {"y"}, _times(-1.0, "y")),
    ("v to port", "axes", {"v"}, _times(-1.0, "v")),
    ("yaw rate to port", "sign", {"r"}, _times(-1.0, "r")),
    ("u astern", "sign", {"u"}, _times(-1.0, "u")),
    ("yaw rate in deg/s", "unit", {"r"}, _times(180 / np.pi, "r")),
    ("heading in deg", "unit", {"psi"}, _times(180 / np.pi, "psi")),
    ("velocity in knots", "unit", {"u", "v"}, _times(3600 / 1852, "u", "v")),
    ("time in ms", "unit", {"t"}, _times(1000.0, "t")),
    ("x and y exchanged", "swapped-channels", {"x", "y"}, lambda r: changed(r, x=r.y, y=r.x)),
    ("u and v exchanged", "swapped-channels", {"u", "v"}, lambda r: changed(r, u=r.v, v=r.u)),
    ("rudder reversed", "sign", {"cmd_rudder", "exec_rudder"}, _reversed_rudder),
    ("thrusters exchanged", "swapped-actuators", {"cmd_port", "cmd_starboard"}, _exchanged),
)
