# pyright: reportArgumentType=false
"""A motor out: which layout of figure 12 still gets home on what is left, as section IV.B claims.

The whole layouts' allocation goes on as if nothing had happened, or, where that leaves the boat
without thrust in a wide turn, one made for what is left.
"""

import dataclasses
from collections.abc import Sequence

from experiments.harness.reporting import compared, table
from experiments.pytheas.disturbances import DIRECTIONS
from experiments.pytheas.layouts import (
    FULL_ANGLE,
    MOTOR,
    RUDDER_ANGLE,
    Allocated,
    BowAndRudders,
    FixedPair,
    SteerablePair,
    layouts,
)
from experiments.pytheas.sailing import SECONDS, Track, Trial, run, spread

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from diffsea.types import Scalar


RANGE, SWELL = 20.0, 5.0  # m to the waypoints, N of the gentle swell
BEARINGS = np.deg2rad(np.arange(-135.0, 181.0, 45.0))


class Dead(Allocated):
    """An allocation some of whose channels no longer answer."""

    whole: Allocated
    channels: tuple[str, ...] = eqx.field(static=True)

    def orders(self, throttle: Scalar, angle: Scalar) -> dict[str, Scalar]:
        ordered = self.whole.orders(throttle, angle)
        return ordered | {channel: jnp.zeros(()) for channel in self.channels}


class OnePod(Allocated):
    """(a) on its starboard motor, never astern, turned so far that at no error it does not turn."""

    def orders(self, throttle: Scalar, angle: Scalar) -> dict[str, Scalar]:
        straight = jnp.arctan2(0.225, 0.4)
        turned = jnp.clip(-angle - straight, -FULL_ANGLE, FULL_ANGLE)
        return {
            "port.force": jnp.zeros(()), "port.angle": jnp.zeros(()),
            "starboard.force": jnp.minimum(throttle, MOTOR), "starboard.angle": turned,
        }  # fmt: skip


class SternAndRudders(Allocated):
    """(b) without its bow motor: the stern motor pushes in wide turns, too."""

    def orders(self, throttle: Scalar, angle: Scalar) -> dict[str, Scalar]:
        rudder = RUDDER_ANGLE * angle / FULL_ANGLE
        return {
            "bow.force": jnp.zeros(()), "bow.angle": jnp.zeros(()),
            "stern": jnp.minimum(throttle, MOTOR),
            "port_rudder": rudder, "starboard_rudder": rudder,
        }  # fmt: skip


class BowAlone(Allocated):
    """(b) without its stern motor: the bow motor steers small turns, too."""

    def orders(self, throttle: Scalar, angle: Scalar) -> dict[str, Scalar]:
        zero = jnp.zeros(())
        return {
            "bow.force": jnp.minimum(throttle, MOTOR), "bow.angle": angle, "stern": zero,
            "port_rudder": zero, "starboard_rudder": zero,
        }  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Limping:
    """What is left of a layout, and how it got on."""

    layout: str
    out: str
    logic: str
    reached: int  # of eight waypoints in still water
    longest: float  # s, of those
    in_swell: int  # of three directions of the swell
    tracks: list[Track]


# Layout by its letter, what is out, how it is steered.
LEFT: tuple[tuple[str, str, str, Allocated], ...] = (
    ("(a)", "port motor", "as before", Dead(SteerablePair(), ("port.force",))),
    ("(a)", "port motor", "its own", OnePod()),
    ("(b)", "bow motor", "as before", Dead(BowAndRudders(), ("bow.force",))),
    ("(b)", "bow motor", "its own", SternAndRudders()),
    ("(b)", "stern motor", "as before", Dead(BowAndRudders(), ("stern",))),
    ("(b)", "stern motor", "its own", BowAlone()),
    ("(c)", "port motor", "as before", Dead(FixedPair(), ("port",))),
)  # fmt: skip


def limping(left: Sequence[tuple[str, str, str, Allocated]] = LEFT) -> list[Limping]:
    """Every layout with a motor out: eight waypoints in still water, three directions of swell."""
    makes = {name[:3]: vessel for name, (vessel, _) in layouts().items()}
    calm = spread(Trial(RANGE * jnp.cos(BEARINGS), RANGE * jnp.sin(BEARINGS)), len(BEARINGS))
    swell = spread(
        Trial(RANGE, 0.0, bias=SWELL, swing=SWELL / 4, direction=jnp.array(DIRECTIONS)), 3
    )
    both = jax.tree.map(lambda *parts: jnp.concatenate(parts), calm, swell)
    found = []
    for letter, out, steered, allocation in left:
        batch = jax.tree.map(
            lambda leaf: jnp.broadcast_to(leaf, (len(both.north), *leaf.shape)), makes[letter]
        )
        tracks = run(batch, both, allocation)
        there = np.array([track.t[-1] < SECONDS - 0.1 for track in tracks])
        times = [track.t[-1] for track, ok in zip(tracks[:8], there, strict=False) if ok]
        found.append(Limping(letter, out, steered, int(there[:8].sum()), max(times, default=np.nan),
                             int(there[8:].sum()), tracks))  # fmt: skip
    return found


def circle(found: list[Limping]) -> float:
    """Radius (m) of the circle that (c) is left with: speed over yaw rate at the end of a run."""
    (fixed,) = (one for one in found if one.layout == "(c)")
    track = fixed.tracks[0]
    return float(np.hypot(track.u[-1], track.v[-1]) / abs(track.r[-1]))


def limping_table(found: list[Limping]) -> str:
    """One row per motor and logic."""
    head = ("layout", "out", "logic", "waypoints reached in still water", "longest, s",
            f"reached in a swell of {SWELL:.0f} N")  # fmt: skip
    return table(head, [
        (one.layout, one.out, one.logic, f"{one.reached} of 8",
         "-" if np.isnan(one.longest) else f"{one.longest:.0f}", f"{one.in_swell} of 3")
        for one in found
    ])  # fmt: skip


def record(found: list[Limping]) -> list[dict]:
    """The numbers without the tracks."""
    fields = ("layout", "out", "logic", "reached", "longest", "in_swell")
    return [{name: getattr(one, name) for name in fields} for one in found]


def comparison_row(found: list[Limping]) -> dict:
    """The paper's claim on (c) beside what happens."""
    (fixed,) = (one for one in found if one.layout == "(c)")
    obtained = f"{fixed.reached} of 8 waypoints; circles of {circle(found):.1f} m radius"
    return compared("(c) with one motor down", "", "can still make its way home", obtained)
