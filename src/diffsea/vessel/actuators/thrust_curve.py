"""From the number that orders a thruster to its thrust: units of orders, and the thrust curve."""

import math
from typing import Any, get_args

import equinox as eqx
import jax.numpy as jnp

from diffsea import pulses
from diffsea.errors import UserError, nearest
from diffsea.types import Scalar
from diffsea.vessel.base import OrderUnit
from diffsea.vessel.characteristics import dead_zone, power
from diffsea.vessel.tables import Table, check_keys, needed, numbers, positive


# Neutral, full ahead and full astern where a file does not say them.
SCALES: dict[OrderUnit, tuple[float, float, float]] = {
    "percent": (0.0, 100.0, -100.0),
    "normalised": (0.0, 1.0, -1.0),
    # Of electronic speed controllers.
    "us": (pulses.NEUTRAL, pulses.NEUTRAL + pulses.SPAN, pulses.NEUTRAL - pulses.SPAN),
}
UNITS: tuple[OrderUnit, ...] = get_args(OrderUnit)
PER_REVOLUTION: dict[OrderUnit, float] = {"rev/s": 1.0, "rpm": 60.0}  # of the unit, for 1 rev/s


def power_law(share: Scalar, exponent: Scalar) -> Scalar:
    """`sgn(s) |s|^p`, linear within a millionth of zero, where it has derivatives by both."""
    return share * power(share, exponent - 1)


class ThrustCurve(eqx.Module):
    """Thrust at rest against the order as a share s of full order, -1 full astern, 1 full ahead.

        T = F a sgn(s) ((|s| - b) / (1 - b))^p  where b < |s|, at most that of |s| = 1; else zero

    with F `full_thrust` (N), b `deadband` (a share of full order, without unit), p `exponent`,
    and a one ahead and `astern_ratio` astern. Full order makes full thrust whatever the dead band.
    """

    full_thrust: Scalar  # N, ahead
    deadband: Scalar = 0.0
    exponent: Scalar = 1.0
    astern_ratio: Scalar = 1.0

    def thrust(self, share: Scalar) -> Scalar:
        """Thrust (N) at rest."""
        acting = dead_zone(jnp.clip(share, -1.0, 1.0), self.deadband) / (1 - self.deadband)
        return self._full(acting) * power_law(acting, self.exponent)

    def share(self, thrust: Scalar) -> Scalar:
        """The order for a thrust (N), a share of full order; full order where none is enough."""
        full = self._full(thrust)
        part = jnp.where(full > 0, thrust / jnp.where(full > 0, full, 1.0), jnp.sign(thrust))
        acting = power_law(jnp.clip(part, -1.0, 1.0), 1 / self.exponent)
        return acting * (1 - self.deadband) + jnp.sign(thrust) * self.deadband

    def _full(self, sense: Scalar) -> Scalar:
        """Thrust (N) at full order, ahead or astern by the sign of `sense`."""
        return self.full_thrust * jnp.where(sense < 0, self.astern_ratio, 1.0)

    @classmethod
    def from_table(cls, table: Table, where: str) -> "ThrustCurve":
        """The curve of a `thrust_curve` table in a thruster's.

        What it does not say follows from the thruster's limits: `full_thrust` is `max_force`; with
        neither `full_thrust` nor `astern_ratio`, full astern makes `min_force`.

        Raises:
            UserError: an unknown key, an impossible value, or no thrust at full order.
        """
        given = table.get("thrust_curve", {})
        inside = f"{where}, thrust_curve"
        if not isinstance(given, dict):
            raise UserError(f"{inside} is a table: [thruster.thrust_curve]")
        keys = ("full_thrust", "deadband", "exponent", "astern_ratio")
        check_keys(given, keys, inside)
        values, limits = numbers(given, keys, inside), numbers(table, FORCES, where)
        if "full_thrust" not in values:
            if "max_force" not in limits:
                raise UserError(
                    f"{where}: nothing says how much thrust full order makes; give full_thrust (N) "
                    "in its thrust_curve, or max_force"
                )
            values["full_thrust"] = limits["max_force"]
            if "min_force" in limits:
                values.setdefault("astern_ratio", -limits["min_force"] / limits["max_force"])
        curve = cls(**values)
        for key, sound, must in (
            ("full_thrust", curve.full_thrust > 0, "must be positive"),
            ("exponent", curve.exponent > 0, "must be positive"),
            ("astern_ratio", curve.astern_ratio >= 0, "must not be negative"),
            ("deadband", 0 <= curve.deadband < 1, "is a share of full order, from 0 to below 1"),
        ):
            if not sound:
                raise UserError(f"{inside}: {key} = {getattr(curve, key):g} {must}")
        return curve


FORCES = ("min_force", "max_force")  # keys of limits, N
SPEEDS = ("min_speed", "max_speed")  # of limits, in the unit of orders by shaft speed
SCALE_KEYS = ("neutral", "full_ahead", "full_astern")
KEYS = ("unit", *SCALE_KEYS, "reversed", "curve", "thrust_curve", *FORCES)


class Drive(eqx.Module):
    """How a thruster's order makes thrust.

    With `n` the order above neutral, its sign turned where the thruster is `reversed`: the thrust
    is n in N; `T = c V n + d |n| n` with a `curve` of the shaft speed n (rev/s; V m/s is the speed
    of the water along the axis; Blanke 1981 after Fossen 2021, eq. 9.7); or it follows a
    `thrust_curve`, n over that of full order.
    """

    unit: OrderUnit = eqx.field(static=True, default="N")
    reversed: bool = eqx.field(static=True, default=False)
    curve: tuple[Scalar, Scalar] | None = None  # c in N s^2/m, d in N s^2
    thrust_curve: ThrustCurve | None = None
    full_ahead: Scalar | None = None  # in the unit; where there is a thrust curve
    full_astern: Scalar | None = None

    @property
    def takes_speed(self) -> bool:
        """Whether it is driven by its shaft speed: its throttle then is in rev/s, else in N."""
        return self.curve is not None

    def thrust(self, order: Scalar, neutral: Scalar | None, advance: Scalar = 0.0) -> Scalar:
        """Thrust (N) of an executed order in water that comes at `advance` m/s along the axis."""
        above = self.above_neutral(order, neutral)
        if self.thrust_curve is not None:
            return self.thrust_curve.thrust(above / self._full(above, neutral))
        if self.curve is not None:
            (c, d), n = self.curve, self._speed(above)
            return c * advance * n + d * jnp.abs(n) * n
        return above

    def throttle(self, order: Scalar, neutral: Scalar | None) -> Scalar:
        """What the order is as a throttle: thrust at rest (N), or shaft speed (rev/s)."""
        if self.takes_speed:
            return self._speed(self.above_neutral(order, neutral))
        return self.thrust(order, neutral)

    def order(self, throttle: Scalar, neutral: Scalar | None) -> Scalar:
        """The order for a throttle, N or rev/s: the inverse of `throttle`."""
        above = throttle
        if self.thrust_curve is not None:
            above = self.thrust_curve.share(throttle) * self._full(throttle, neutral)
        elif self.unit in PER_REVOLUTION:
            above = throttle * PER_REVOLUTION[self.unit]
        above = -above if self.reversed else above
        return above if neutral is None else neutral + above

    def above_neutral(self, order: Scalar, neutral: Scalar | None) -> Scalar:
        """How far the order is from neutral, in its unit, positive ahead."""
        above = order if neutral is None else order - neutral
        return -above if self.reversed else above

    def _speed(self, above: Scalar) -> Scalar:
        """Shaft speed, rev/s."""
        per_revolution = PER_REVOLUTION[self.unit]
        return above if per_revolution == 1 else above / per_revolution

    def _full(self, sense: Scalar, neutral: Scalar | None) -> Scalar:
        """Full order's distance from neutral, ahead or astern by the sign of `sense`."""
        assert self.full_ahead is not None and self.full_astern is not None
        middle = 0.0 if neutral is None else neutral
        return jnp.where(sense < 0, middle - self.full_astern, self.full_ahead - middle)


def read_drive(table: Table, where: str) -> tuple[Drive, dict[str, float]]:
    """What a thruster's table says of its orders: its drive, and `neutral`, `lower`, `upper`.

    These are in the unit of the orders; what the table does not say is left out. Limits stated as
    forces hold for the thrust at rest; a thrust curve ends at full order besides.

    Raises:
        UserError: an unknown unit, what does not belong together, or an impossible value.
    """
    unit, turned = _unit(table, where), table.get("reversed", False)
    if not isinstance(turned, bool):
        raise UserError(f"{where}: reversed = {turned!r} is neither true nor false")
    stated = dict(zip(SCALE_KEYS, SCALES.get(unit, ()), strict=False))
    stated |= numbers(table, SCALE_KEYS, where)
    if unit in SCALES or "thrust_curve" in table:
        drive, limits = _driven_by_curve(unit, turned, stated, table, where)
    elif unit in PER_REVOLUTION:
        curve = _speed_curve(table, where)
        drive, limits = Drive(unit, turned, curve), _speed_limits(curve[1], unit, table, where)
    else:
        drive, limits = Drive(unit, turned), numbers(table, FORCES, where)
        limits = {key.removesuffix("_force"): value for key, value in limits.items()}
    if drive.thrust_curve is None and ("full_ahead" in table or "full_astern" in table):
        raise UserError(
            f"{where}: full_ahead and full_astern belong to a thrust_curve; without "
            "one, limits are max_force and min_force"
        )
    neutral, sign = stated.get("neutral", 0.0), -1 if turned else 1
    ends = {sign * (1 if key == "max" else -1): sign * end for key, end in limits.items()}
    found = {key: neutral + ends[k] for key, k in (("lower", -1), ("upper", 1)) if k in ends}
    return drive, found | ({"neutral": neutral} if "neutral" in stated else {})


def _unit(table: Table, where: str) -> OrderUnit:
    """The unit of the orders; without one it is N, or rev/s with a curve of the shaft speed."""
    unit: Any = table.get("unit", "rev/s" if "curve" in table else "N")
    if unit not in UNITS:
        hint = nearest(str(unit), UNITS) or f"; known are {', '.join(UNITS)}"
        raise UserError(f"{where}: unknown unit = {unit!r} of its orders{hint}")
    if "curve" in table and unit not in PER_REVOLUTION:
        raise UserError(f"{where}: curve = {{c, d}} is for orders in rev/s or rpm, not in {unit}")
    if "curve" in table and "thrust_curve" in table:
        raise UserError(f"{where}: give either curve or thrust_curve, not both")
    return unit


def _speed_curve(table: Table, where: str) -> tuple[float, float]:
    """c and d of the thrust of a shaft speed."""
    given = table.get("curve")
    if not isinstance(given, dict) or set(given) != {"c", "d"}:
        raise UserError(
            f"{where}: curve = {{c = .., d = ..}} for T = c V n + d |n| n, n in rev/s, is needed "
            "where a shaft speed is ordered; or give a thrust_curve"
        )
    return needed(given, "c", where), positive(given, "d", where)


def _speed_limits(d: float, unit: OrderUnit, table: Table, where: str) -> dict[str, float]:
    """Limits above neutral, `min` and `max`, in the unit; forces (N) are those at rest."""
    per_revolution = PER_REVOLUTION[unit]
    forces = numbers(table, FORCES, where).items()
    at_rest = {key: math.copysign(math.sqrt(abs(F) / d), F) * per_revolution for key, F in forces}
    limits = at_rest | numbers(table, SPEEDS, where)
    return {key.split("_")[0]: value for key, value in limits.items()}


def _driven_by_curve(
    unit: OrderUnit, turned: bool, scale: dict[str, float], table: Table, where: str
) -> tuple[Drive, dict[str, float]]:
    """A drive with a thrust curve, and its limits above neutral, `min` and `max`."""
    curve, neutral = ThrustCurve.from_table(table, where), scale.get("neutral", 0.0)
    if "full_ahead" not in scale:
        raise UserError(f"{where}: a thrust_curve of orders in {unit} needs full_ahead ({unit})")
    ahead = scale["full_ahead"]
    astern = scale.get("full_astern", 2 * neutral - ahead)
    if not astern < neutral < ahead:
        raise UserError(
            f"{where}: neutral = {neutral:g} must lie between full_astern = {astern:g} and "
            f"full_ahead = {ahead:g} ({unit}); a thruster that is wired the other way round is "
            "reversed = true"
        )
    forces, spans = numbers(table, FORCES, where), {"min": neutral - astern, "max": ahead - neutral}
    limits = {"min": astern - neutral, "max": ahead - neutral}
    for key, force in forces.items():
        end = key.split("_")[0]
        limits[end] = float(curve.share(force)) * spans[end]
    return Drive(unit, turned, None, curve, ahead, astern), limits
