"""One run, simulated or measured: the record that every layer shares.

SI units and radians throughout. Earth axes are NED (x north, y east, psi clockwise from
north); body axes are forward, starboard, down with the origin amidships.

Needs neither JAX nor Equinox, so that recordings are read and audited at once; `diffsea.types`
makes the record known to JAX.
"""

import dataclasses
import enum
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int


Series = Float[Any, "time"]  # of NumPy or JAX
Samples = Float[np.ndarray, "time"]  # of NumPy, as recordings have them

MOTION_CHANNELS = ("x", "y", "psi", "u", "v", "r")
CHANNEL_UNITS = {  # of all native channels but orders and what was executed
    "x": "m",
    "y": "m",
    "psi": "rad",
    "u": "m/s",
    "v": "m/s",
    "r": "rad/s",
    "wind_speed": "m/s",
    "wind_direction": "rad",
    "apparent_wind_speed": "m/s",
    "apparent_wind_angle": "rad",
    "phi": "rad",
    "p": "rad/s",
}

_CHANNEL_WORDS = {  # longer groups first
    ("x", "y"): "position",
    ("u", "v"): "velocity",
    ("t",): "time",
    ("x",): "position north",
    ("y",): "position east",
    ("psi",): "heading",
    ("u",): "speed ahead",
    ("v",): "speed to starboard",
    ("r",): "yaw rate",
    ("phi",): "heel",
    ("p",): "roll rate",
    ("wind_speed",): "wind speed",
    ("wind_direction",): "wind direction",
    ("apparent_wind_speed",): "apparent wind speed",
    ("apparent_wind_angle",): "apparent wind angle",
}
_ACTUATION_WORDS = {"cmd_": "order", "exec_": "executed"}  # by prefix


class Outcome(enum.IntEnum):
    """How a run ended. `sentence` says it in words."""

    COMPLETED = 0
    TIME_LIMIT = 1
    DIVERGED = 2
    APPROACH_UNSTEADY = 3

    @property
    def sentence(self) -> str:
        """The outcome as a sentence for a message or a report."""
        return _SENTENCES[self]


_SENTENCES = {
    Outcome.COMPLETED: "the manoeuvre was completed",
    Outcome.TIME_LIMIT: "the time limit was reached before the manoeuvre was completed",
    Outcome.DIVERGED: "the run diverged: speed, yaw rate or position left every plausible range",
    Outcome.APPROACH_UNSTEADY: "the approach never became steady, so nothing was executed",
}


def in_words(channels: Sequence[str]) -> list[str]:
    """What people call native channels: `position` for x and y, `order port` for cmd_port."""
    left, words = list(channels), []
    while left:
        group = next((g for g in _CHANNEL_WORDS if set(g) <= set(left) and left[0] in g), None)
        words.append(_CHANNEL_WORDS[group] if group else _actuation_in_words(left[0]))
        left = [name for name in left if name not in (group or left[:1])]
    return words


def _actuation_in_words(channel: str) -> str:
    for prefix, word in _ACTUATION_WORDS.items():
        if channel.startswith(prefix):
            return f"{word} {channel.removeprefix(prefix).replace('_', ' ')}"
    return channel.replace("_", " ")


@dataclasses.dataclass(frozen=True)
class RowsLeftOut:
    """Rows of a file that reading left out."""

    count: int
    note: str  # the sentence of the provenance on them


@dataclasses.dataclass(frozen=True)
class ReadReport:
    """What reading found and changed in a file, for programs; `provenance` tells people."""

    empty_rows: RowsLeftOut | None = None  # without any value, not even a time stamp
    # Merged into one of the same time stamp; of logs, in each topic that has such.
    repeated_times: tuple[RowsLeftOut, ...] = ()
    # The mapping that was chosen by what a log contains, what it lacks, and how to choose another.
    recognised: tuple[str, ...] = ()
    # Samples per second by channel, of logs whose topics have clocks of their own.
    rates: dict[str, float] = dataclasses.field(default_factory=dict)
    unused_columns: tuple[str, ...] = ()  # of a table, by name
    cut_off: str = ""  # that the file ends within a row or message, in words
    # What the file's clock shows where `t` is zero (s), if it counts from a calendar's epoch.
    epoch: float | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class Trajectory:
    """One run, simulated or measured: motion, commands and executed actuation.

    A channel that was not measured is filled with NaN; so is a missing sample. Commanded
    and executed actuation hold from their time stamp until the next and are never mixed.
    `valid` marks the rows that count: a jitted simulation has spare ones.
    """

    t: Series  # s
    x: Series  # m, north
    y: Series  # m, east
    psi: Series  # rad, unwrapped
    u: Series  # m/s over ground
    v: Series  # m/s over ground
    r: Series  # rad/s
    commanded: dict[str, Series]  # by actuator channel, in that actuator's unit
    executed: dict[str, Series]
    extra: dict[str, Series]  # of CHANNEL_UNITS, what is no motion; winds are where from
    valid: Bool[Any, "time"]
    outcome: Int[Any, ""] | int = int(Outcome.COMPLETED)
    name: str = "run"
    provenance: tuple[str, ...] = ()  # what was done to it, in words for people
    read: ReadReport = ReadReport()

    def has(self, channel: str) -> bool:
        """Whether a motion channel (`x`, `y`, `psi`, `u`, `v`, `r`) has any sample."""
        return bool(np.any(np.isfinite(np.asarray(getattr(self, channel)))))

    @property
    def motion(self) -> dict[str, Series]:
        """The motion channels by their names, `x`, `y`, `psi`, `u`, `v`, `r`."""
        return {name: getattr(self, name) for name in MOTION_CHANNELS}

    def counted(self) -> "Trajectory":
        """The rows that count, as plain NumPy arrays of floats: the run made ready to use."""
        return self.rows(np.asarray(self.valid, dtype=bool))

    def rows(self, chosen: Bool[np.ndarray, "time"] | Int[np.ndarray, "row"]) -> "Trajectory":
        """The run in the chosen rows (a mask, or their numbers), as plain NumPy arrays."""

        def in_rows(group: dict[str, Series]) -> dict[str, Float[np.ndarray, "row"]]:
            return {name: np.asarray(series, float)[chosen] for name, series in group.items()}

        return dataclasses.replace(
            self,
            t=np.asarray(self.t, float)[chosen],
            **in_rows(self.motion),
            commanded=in_rows(self.commanded),
            executed=in_rows(self.executed),
            extra=in_rows(self.extra),
            valid=np.asarray(self.valid, bool)[chosen],
        )
