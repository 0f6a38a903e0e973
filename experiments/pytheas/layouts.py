# pyright: reportArgumentType=false
"""The three layouts of figure 12 under the same logic: only the allocation differs.

The paper draws them without numbers. Taken here: motors of 10 N as in its appendix A, two where the
boat of Table I has one of 20 N; hulls 0.45 m apart; the published lever of 0.4 m ahead and abaft.
"""

import abc
import dataclasses

from experiments.harness.reporting import compared, table
from experiments.pytheas import disturbances
from experiments.pytheas.boat import FULL_ANGLE, THRUST, floats
from experiments.pytheas.disturbances import NAMES, ended
from experiments.pytheas.sailing import SECONDS, Track, around, run
from experiments.pytheas.still_water import BEARINGS, REACHED

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffsea import Vessel, read_vessel
from diffsea.simulation.control.autopilot import Pursuit
from diffsea.simulation.control.waypoints import WaypointLogic
from diffsea.types import Scalar
from diffsea.vessel.files import build


MOTOR, APART, LEVER = 10.0, 0.45, 0.4  # N, m, m
RUDDER_AREA, RUDDER_ANGLE = 0.004, 0.6  # m^2 each, rad: not published


class Allocated(eqx.Module):
    """An allocation with its logic: thrust of both motors, and the published angle."""

    @abc.abstractmethod
    def orders(self, throttle: Scalar, angle: Scalar) -> dict[str, Scalar]:
        """Order of each channel."""

    def logic(self, waypoints: Float[Array, "waypoint 2"], tolerance: Scalar) -> WaypointLogic:
        """The published logic with this allocation."""
        return WaypointLogic(Pursuit(waypoints, tolerance), self, THRUST, FULL_ANGLE)


class SteerablePair(Allocated):
    """(a) Two steerable motors at the stern; in wide turns a couple, one ahead and one astern."""

    def orders(self, throttle: Scalar, angle: Scalar) -> dict[str, Scalar]:
        wide = jnp.abs(angle) >= FULL_ANGLE
        couple = jnp.sign(angle) * 0.5 * throttle
        turned = jnp.where(wide, 0.0, -angle)
        return {
            "port.force": jnp.where(wide, couple, 0.5 * throttle),
            "port.angle": turned,
            "starboard.force": jnp.where(wide, -couple, 0.5 * throttle),
            "starboard.angle": turned,
        }


class BowAndRudders(Allocated):
    """(b) A steerable bow motor, and a stern motor with twin rudders: the boat as it was built.

    In small turns both motors push ahead and the rudders steer; in wide ones the stern motor is
    off, the rudders straight, and the bow motor at full power and angle.
    """

    def orders(self, throttle: Scalar, angle: Scalar) -> dict[str, Scalar]:
        wide, going = jnp.abs(angle) >= FULL_ANGLE, throttle > 0
        rudder = jnp.where(wide, 0.0, RUDDER_ANGLE * angle / FULL_ANGLE)
        return {
            "bow.force": jnp.where(going, MOTOR, 0.0),
            "bow.angle": jnp.where(wide, angle, 0.0),
            "stern": jnp.where(wide, 0.0, jnp.minimum(0.5 * throttle, MOTOR)),
            "port_rudder": rudder,
            "starboard_rudder": rudder,
        }


class FixedPair(Allocated):
    """(c) Two fixed motors at the stern; the angle shifts thrust from one side to the other."""

    def orders(self, throttle: Scalar, angle: Scalar) -> dict[str, Scalar]:
        shift = angle / FULL_ANGLE
        return {
            "port": 0.5 * throttle * (1 + shift),
            "starboard": 0.5 * throttle * (1 - shift),
        }


def vessel(actuators: dict[str, list[dict]]) -> Vessel:
    """The published hull with other actuators (tables of a vessel file)."""
    document = dict(read_vessel("pytheas").document)
    del document["azimuth_thruster"]
    return floats(build(document | actuators))


def _stern(name: str, side: int, least: float = 0.0) -> dict:
    return {"name": name, "x": -LEVER, "y": side * APART / 2, "max_force": MOTOR,
            "min_force": least}  # fmt: skip


def _rudder(name: str, side: int) -> dict:
    return {"name": name, "area": RUDDER_AREA, "x": -0.5, "y": side * APART / 2,
            "max_angle": RUDDER_ANGLE}  # fmt: skip


def layouts() -> dict[str, tuple[Vessel, Allocated | None]]:
    """Vessel and allocation of each layout; none for the boat of Table I."""
    limits = {"max_angle": float(FULL_ANGLE), "min_angle": -float(FULL_ANGLE)}
    steered = [_stern("port", -1, -MOTOR) | limits, _stern("starboard", 1, -MOTOR) | limits]
    bow = {"name": "bow", "x": LEVER, "max_force": MOTOR, "min_force": 0.0} | limits
    stern = {"name": "stern", "x": -LEVER, "max_force": MOTOR, "min_force": 0.0}
    rudders = [_rudder("port_rudder", -1), _rudder("starboard_rudder", 1)]
    return {
        "one vectored thruster (Table I)": (floats(read_vessel("pytheas").vessel), None),
        "(a) steerable pair": (vessel({"azimuth_thruster": steered}), SteerablePair()),
        "(b) bow motor, stern motor, rudders": (
            vessel({"azimuth_thruster": [bow], "thruster": [stern], "rudder": rudders}),
            BowAndRudders(),
        ),
        "(c) two fixed motors": (
            vessel({"thruster": [_stern("port", -1), _stern("starboard", 1)]}), FixedPair(),
        ),
    }  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Flown:
    """What one layout did."""

    to_speed: np.ndarray  # s, to the top speed of Table III at its five bearings
    reached: int  # of the five waypoints
    shift: float  # m, how far the boat moved until it had turned by 90 degrees towards one astern
    overshoot: float  # rad, by which it then turned past that waypoint's bearing
    swinging: float  # rad, rms of the heading about its mean in the second half of D5
    battery: dict[str, tuple[bool, float, float]]
    tracks: list[Track]


def flown(made: Vessel, allocation: Allocated | None) -> Flown:
    """Five waypoints in still water and the battery, in one batch."""
    both = (around(20.0, BEARINGS), disturbances.trials())
    all_trials = jax.tree.map(lambda *parts: jnp.concatenate(parts), *both)
    count = len(all_trials.north)
    batch = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (count, *leaf.shape)), made)
    tracks = run(batch, all_trials, allocation)
    tracks, nine = tracks[: len(BEARINGS)], tracks[len(BEARINGS) :]
    battery = {
        name: ended(track.t, track.x, track.y) for name, track in zip(NAMES, nine, strict=True)
    }
    astern = tracks[-1]
    quarter = int(np.argmax(np.abs(astern.psi) >= np.pi / 2))
    return Flown(
        np.array([track.at_speed(REACHED)[0] for track in tracks]),
        sum(track.t[-1] < SECONDS - 0.1 for track in tracks),
        float(np.hypot(astern.x[quarter], astern.y[quarter])),
        float(np.max(_past(astern))),
        float(np.std(nine[4].psi[len(nine[4].psi) // 2 :])),
        battery,
        tracks,
    )


def _past(track: Track) -> np.ndarray:
    """Heading beyond the bearing of the waypoint astern (rad), in the sense of the turn."""
    bearing = np.unwrap(np.arctan2(-track.y, -20.0 - track.x))
    error = track.psi - bearing
    return np.sign(track.psi[-1]) * (error - 2 * np.pi * np.round(error[-1] / (2 * np.pi)))


def layouts_table(found: dict[str, Flown]) -> str:
    """One row per layout."""
    head = ("layout", *(f"{b:.0f} deg, s" for b in np.rad2deg(BEARINGS)), "waypoints reached",
            "moved in a turn of 90 deg, m", "turned past the waypoint, deg",
            "heading swings in D5, deg rms", "reached of D1 to D9")  # fmt: skip
    rows = []
    for name, one in found.items():
        times = [f"{t:.1f}" if np.isfinite(t) else "never" for t in one.to_speed]
        count = sum(one.battery[trial][0] for trial in NAMES)
        past, swings = np.rad2deg([max(one.overshoot, 0.0), one.swinging])
        rows.append((name, *times, f"{one.reached} of 5", f"{one.shift:.2f}", f"{past:.1f}",
                     f"{swings:.1f}", f"{count} of 9"))  # fmt: skip
    return table(head, rows)


def record(found: dict[str, Flown]) -> dict:
    """The numbers of each layout."""
    return {
        name: {
            "seconds_to_top_speed": one.to_speed,
            "reached": one.reached,
            "moved_in_a_turn_of_90_deg": one.shift,
            "overshoot": one.overshoot,
            "swinging": one.swinging,
            "battery": {trial: end[0] for trial, end in one.battery.items()},
        }
        for name, one in found.items()
    }


PUBLISHED = {
    "(a)": "turns on the spot",
    "(b)": "does not turn on the spot",
    "(c)": "may oscillate in a turn, with waves",
}


def comparison_rows(found: dict[str, Flown]) -> list[dict]:
    """What the paper says of the layouts in words, beside numbers."""
    rows = []
    for name, one in found.items():
        if name[:3] not in PUBLISHED:
            continue
        moved = f"moves {one.shift:.2f} m in a turn of 90 deg"
        past, swings = np.rad2deg([one.overshoot, one.swinging])
        beyond = (
            f"turns {past:.1f} deg past the waypoint"
            if past > 0
            else "never turns past the waypoint"
        )
        turned = f"{beyond}; swings by {swings:.1f} deg rms in D5"
        obtained = turned if name.startswith("(c)") else moved
        rows.append(compared(name, "", PUBLISHED[name[:3]], obtained))
    return rows
