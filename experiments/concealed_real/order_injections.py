"""Faults of actuators put into a recording: an order is replaced by its preimage.

The realised actuation, and with it the motion, stays what it was: the vessel with the fault would
have moved as recorded under the new orders. Settings are numbers in the orders' unit and SI:
`size`, `side`, `columns`, `sides` (of each column: -1 port, 1 starboard), `rows`, `time`.
"""

from experiments.concealed_real.material import Run, Series, Settings, replaced, step_of
from experiments.concealed_real.sensor_injections import signed

import numpy as np
from scipy.signal import lfilter


# Late answers


def late_orders(run: Run, settings: Settings) -> Run:
    """Orders written `rows` rows earlier; the last one holds to the end."""
    rows = int(settings["rows"])
    return replaced(run, {c: _earlier(run[c].to_numpy(), rows) for c in settings["columns"]})


def prompt_orders(run: Run, settings: Settings) -> Run:
    """The inverse of `late_orders`, but for the first `rows` rows, which are gone."""
    rows = int(settings["rows"])
    later = lambda values: np.concatenate([np.full(rows, values[0]), values[: len(values) - rows]])
    return replaced(run, {c: later(run[c].to_numpy()) for c in settings["columns"]})


def _earlier(values: Series, rows: int) -> Series:
    return np.concatenate([values[rows:], np.full(min(rows, len(values)), values[-1])])


def lagging_orders(run: Run, settings: Settings) -> Run:
    """Orders that a lag with the time constant `size` s turns into those recorded.

    For a measured actuation, hidden, which moves continuously. Orders hold between rows.
    """
    reached = 1 - np.exp(-step_of(run) / settings["size"])

    def ahead(values: Series) -> Series:
        return values + np.append(np.diff(values), 0.0) / reached

    return replaced(run, {c: ahead(run[c].to_numpy()) for c in settings["columns"]})


def followed_orders(run: Run, settings: Settings) -> Run:
    """What a lag with the time constant `size` s makes of orders: inverse of `lagging_orders`."""
    kept = np.exp(-step_of(run) / settings["size"])

    def lagged(values: Series) -> Series:
        after = lfilter([1 - kept], [1.0, -kept], values[:-1], zi=[kept * values[0]])[0]
        return np.concatenate([values[:1], after])

    return replaced(run, {c: lagged(run[c].to_numpy()) for c in settings["columns"]})


# Thrust against order


def dead_band(run: Run, settings: Settings) -> Run:
    """Orders that a dead band of half width `size` shortens to those recorded."""
    widen = lambda values: values + settings["size"] * np.sign(values)
    return replaced(run, {c: widen(run[c].to_numpy()) for c in settings["columns"]})


def shortened(run: Run, settings: Settings) -> Run:
    """What a dead band makes of orders: inverse of `dead_band`."""
    shorten = lambda v: np.sign(v) * np.maximum(np.abs(v) - settings["size"], 0.0)
    return replaced(run, {c: shorten(run[c].to_numpy()) for c in settings["columns"]})


def play(run: Run, settings: Settings) -> Run:
    """Orders that a play of half width `size` turns into those recorded.

    They lead by the half width in the direction in which the actuation last moved.
    """

    def led(values: Series) -> Series:
        direction = np.sign(np.diff(values, prepend=values[0]))
        moved = np.where(direction != 0, np.arange(len(values)), 0)
        last = direction[np.maximum.accumulate(moved)]
        return values + settings["size"] * last

    return replaced(run, {c: led(run[c].to_numpy()) for c in settings["columns"]})


def played(run: Run, settings: Settings) -> Run:
    """What a play of half width `size` makes of orders: inverse of `play`."""

    def followed(values: Series) -> Series:
        out, at, half = np.empty_like(values), values[0], settings["size"]
        for k, order in enumerate(values):
            at = min(max(at, order - half), order + half)
            out[k] = at
        return out

    return replaced(run, {c: followed(run[c].to_numpy()) for c in settings["columns"]})


def order_bias(run: Run, settings: Settings, sign: float = 1.0) -> Run:
    """Orders `size` below what is realised: the neutral point is off by `size`."""
    by = sign * signed(settings)
    return replaced(run, {c: run[c].to_numpy() - by for c in settings["columns"]})


def without_order_bias(run: Run, settings: Settings) -> Run:
    """The inverse of `order_bias`."""
    return order_bias(run, settings, -1.0)


def asymmetry(run: Run, settings: Settings) -> Run:
    """Thrusts are 1 - `size` to port and 1 + `size` to starboard of their orders."""
    gains = {c: 1 + side * signed(settings) for c, side in settings["sides"].items()}
    return replaced(run, {c: run[c].to_numpy() / gain for c, gain in gains.items()})


def without_asymmetry(run: Run, settings: Settings) -> Run:
    """The inverse of `asymmetry`."""
    gains = {c: 1 + side * signed(settings) for c, side in settings["sides"].items()}
    return replaced(run, {c: run[c].to_numpy() * gain for c, gain in gains.items()})


def exchanged(run: Run, settings: Settings) -> Run:
    """The two columns have each other's label. Its own inverse."""
    one, other = settings["columns"]
    return replaced(run, {one: run[other].to_numpy(), other: run[one].to_numpy()})


def power_law(run: Run, settings: Settings) -> Run:
    """Thrust grows with the power 1 + `size` of the order; at `full` both are equal."""
    return _raised(run, settings, 1 / (1 + settings["size"]))


def without_power_law(run: Run, settings: Settings) -> Run:
    """The inverse of `power_law`."""
    return _raised(run, settings, 1 + settings["size"])


def _raised(run: Run, settings: Settings, exponent: float) -> Run:
    full = settings["full"]
    raise_ = lambda v: full * np.sign(v) * (np.abs(v) / full) ** exponent
    return replaced(run, {c: raise_(run[c].to_numpy()) for c in settings["columns"]})


# Thrust that depends on the motion, or on time


def gain_of_speed(run: Run, settings: Settings) -> Series:
    """1 - `size` u: thrust that falls with speed, u in m/s."""
    return 1 - settings["size"] * run["u"].interpolate(limit_direction="both").to_numpy()


def gain_of_turning(run: Run, settings: Settings) -> Series:
    """1 - `size` |r|: thrust that falls with yaw rate, r in rad/s."""
    return 1 - settings["size"] * run["r"].interpolate(limit_direction="both").abs().to_numpy()


def gain_of_change(run: Run, settings: Settings) -> Series:
    """1 + `size` from `time` on."""
    return 1 + signed(settings) * (run["t"].to_numpy() >= settings["time"])


def scaled_by(gain, sign: float = -1.0):
    """An injection whose thrust is the order times a gain; with sign 1, its inverse."""

    def apply(run: Run, settings: Settings) -> Run:
        factor = gain(run, settings) ** sign
        return replaced(run, {c: run[c].to_numpy() * factor for c in settings["columns"]})

    return apply


def restless_order(run: Run, settings: Settings, sign: float = 1.0) -> Run:
    """An actuator that swings `size` about its order, period `time` s: no entry describes it."""
    t = run["t"].to_numpy()
    swing = sign * settings["size"] * np.sin(2 * np.pi * (t - t[0]) / settings["time"])
    return replaced(run, {c: run[c].to_numpy() - swing for c in settings["columns"]})


def calm_order(run: Run, settings: Settings) -> Run:
    """The inverse of `restless_order`."""
    return restless_order(run, settings, -1.0)


# Measured actuation that is recorded wrongly


def feedback_offset(run: Run, settings: Settings, sign: float = 1.0) -> Run:
    """Actuation recorded `size` too high."""
    by = sign * signed(settings)
    return replaced(run, {c: run[c].to_numpy() + by for c in settings["columns"]})


def without_feedback_offset(run: Run, settings: Settings) -> Run:
    """The inverse of `feedback_offset`."""
    return feedback_offset(run, settings, -1.0)


def feedback_scale(run: Run, settings: Settings, sign: float = 1.0) -> Run:
    """Actuation recorded 1 + `size` times as large."""
    factor = (1 + signed(settings)) ** sign
    return replaced(run, {c: run[c].to_numpy() * factor for c in settings["columns"]})


def without_feedback_scale(run: Run, settings: Settings) -> Run:
    """The inverse of `feedback_scale`."""
    return feedback_scale(run, settings, -1.0)


def late_feedback(run: Run, settings: Settings) -> Run:
    """Actuation recorded `rows` rows late. Its inverse is `late_orders`."""
    return prompt_orders(run, settings)
