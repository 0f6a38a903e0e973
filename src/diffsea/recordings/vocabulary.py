"""The words of recordings: channels, and the units in which files have them."""

import math


# unit -> (dimension, factor to SI). Revolutions stay revolutions: propellers are ordered
# in rev/s, and nobody's yaw rate is.
UNITS: dict[str, tuple[str, float]] = {
    "s": ("time", 1.0),
    "ms": ("time", 1e-3),
    "us": ("time", 1e-6),
    "ns": ("time", 1e-9),
    "min": ("time", 60.0),
    "h": ("time", 3600.0),
    "m": ("length", 1.0),
    "mm": ("length", 1e-3),
    "cm": ("length", 1e-2),
    "km": ("length", 1e3),
    "ft": ("length", 0.3048),
    "nmi": ("length", 1852.0),
    "rad": ("angle", 1.0),
    "deg": ("angle", math.pi / 180.0),
    "rad/s": ("angular rate", 1.0),
    "deg/s": ("angular rate", math.pi / 180.0),
    "deg/min": ("angular rate", math.pi / 10800.0),
    "m/s": ("speed", 1.0),
    "km/h": ("speed", 1.0 / 3.6),
    "kn": ("speed", 1852.0 / 3600.0),
    "ft/s": ("speed", 0.3048),
    "N": ("force", 1.0),
    "kN": ("force", 1e3),
    "kgf": ("force", 9.80665),
    "lbf": ("force", 4.4482216152605),
    "rev/s": ("revolutions", 1.0),
    "Hz": ("revolutions", 1.0),
    "rps": ("revolutions", 1.0),
    "rpm": ("revolutions", 1.0 / 60.0),
    "%": ("ratio", 0.01),
    "1": ("ratio", 1.0),
}

# The dimension of every channel; actuator channels may have any.
CHANNEL_DIMENSIONS = {
    "t": "time",
    "x": "length",
    "y": "length",
    "psi": "angle",
    "u": "speed",
    "v": "speed",
    "r": "angular rate",
    "wind_speed": "speed",
    "wind_direction": "angle",
    "phi": "angle",
    "p": "angular rate",
}
EXTRA_CHANNELS = ("wind_speed", "wind_direction", "phi", "p")  # beside motion and actuation
ACTUATOR_PREFIXES = ("cmd_", "exec_")

# The first words of the notes of the provenance on rows that reading left out.
REPEATED_TIMES = "merged rows whose time stamp repeats the row before"
EMPTY_ROWS = "dropped empty rows"


def is_channel(name: str) -> bool:
    """Whether `name` is a column of the native recording format."""
    return name in CHANNEL_DIMENSIONS or any(
        name.startswith(prefix) and len(name) > len(prefix) for prefix in ACTUATOR_PREFIXES
    )
