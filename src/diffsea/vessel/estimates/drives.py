"""What drives an estimated vessel: thrusters of unknown thrust, or a propeller and a rudder.

Each gives the tables of the vessel file, what every number of them rests on, and the priors of
those that a fit frees. The thrust of a motor whose orders are pulse widths is not known: full
thrust is the drag at the top speed, with the width of both.
"""

import dataclasses
import math
from collections.abc import Mapping

import numpy as np

from diffsea.errors import UserError, nearest
from diffsea.vessel.actuators.thrust_curve import PER_REVOLUTION, SCALES
from diffsea.vessel.base import OrderUnit
from diffsea.vessel.estimates.outline import Outline
from diffsea.vessel.estimates.scatter import WIDEST, DerivativeEstimate


THRUST_UNITS: tuple[OrderUnit, ...] = ("us", "percent", "normalised", "rpm", "rev/s", "N")
EXPONENT, EXPONENT_WIDTH = 1.5, 0.3  # between thrust in proportion to orders and to their square
SHAFT_EXPONENT, SHAFT_EXPONENT_WIDTH = 2.0, 0.1  # of a shaft speed, whose square thrust follows
ASTERN, ASTERN_WIDTH = 0.7, 0.4  # thrust full astern over ahead (Fossen 2021: 0.58 of the Otter)
LAG, LAG_WIDTH = 0.2, 1.0  # s; thrusters of small craft: under 0.1 s to 1 s (the Otter's)
TURNING_LAG = 0.5  # s, of an azimuth thruster's angle
KNOWN_THRUST_WIDTH = 0.15  # of a stated full thrust
TOP_SPEED_WIDTHS = {True: 0.1, False: 0.3}  # by whether the top speed is known
MAX_ANGLE = math.radians(35)
K_T = (0.40, -0.33, -0.10)  # about Wageningen B4-55 at pitch ratio 0.9
K_T_WIDTH = 0.25  # of K_T at rest: pitch ratios of 0.7 to 1.2 in the same series
DIAMETER_WIDTH = 0.15  # of a diameter that is not known
# How far the slipstream has sped up at the rudder: by momentum theory half in the disc, wholly far
# behind it. The middle of both, each a standard deviation away.
KAPPA, KAPPA_WIDTH = math.sqrt(0.5), 0.5 * math.log(2)
# Of gamma_R, the flow straightening: root mean square of ln(estimate / published), both sides'
# geometric mean, of the only two hulls at hand, KVLCC2 (0.22 for 0.50) and KCS (0.50 for 0.41).
STRAIGHTENING_WIDTH = 0.62
PROPELLER_SHARE = 0.65  # of the draught
THRUST_DEDUCTION = 0.16
BOAT_RUDDER = 50  # L T over the area of a boat's rudder
KIJIMA = "Kijima et al. 1990"
ASTERN_SPEED = 0.7  # largest shaft speed astern over that ahead


@dataclasses.dataclass(frozen=True)
class MotorScale:
    """Orders of one motor: neutral and ends in their unit, and whether they are turned round."""

    neutral: float
    full_ahead: float
    full_astern: float
    reversed: bool = False
    said_by: str = "usual"


@dataclasses.dataclass(frozen=True)
class Part:
    """One actuator of the vessel file: its kind, its numbers and what they rest on."""

    kind: str
    table: dict[str, object]
    reasons: dict[str, str]  # by key, `thrust_curve.exponent` for one further in
    widths: dict[str, float]  # relative prior widths, by key


@dataclasses.dataclass(frozen=True)
class Thrusters:
    """Fixed thrusters that push ahead: one to each side, or a single one amidships.

    `spacing` (m) is the distance of their axes; None takes that of the demihulls, or half the beam
    of a single hull. `full_thrust` (N) is that of one of them. `scales` are by name; `reversed` are
    the names of those whose larger orders are astern, where there is no scale. `shaft_speed`
    (rev/s) is the largest of those that are ordered by it.
    """

    names: tuple[str, ...] = ("port", "starboard")
    spacing: float | None = None
    unit: OrderUnit = "us"
    full_thrust: float | None = None
    astern_ratio: float | None = None
    scales: Mapping[str, MotorScale] = dataclasses.field(default_factory=dict)
    reversed: tuple[str, ...] = ()
    shaft_speed: float | None = None

    def parts(
        self, outline: Outline, hull: Mapping[str, DerivativeEstimate], top_speed_known: bool
    ) -> list[Part]:
        """The thrusters' tables.

        Raises:
            UserError: shaft speeds of which the largest is not known, or thrusters outside the
                beam.
        """
        if self.unit in PER_REVOLUTION and self.shaft_speed is None:
            raise UserError(
                f"thrusters ordered in {self.unit} need the largest shaft speed: --shaft-speed, in "
                "rev/s"
            )
        spacing, why = self.spacing, "as given"
        if spacing is None:
            spacing = outline.spacing or 0.5 * outline.beam
            why = "assumed: behind the demihulls" if outline.spacing else "assumed: half the beam"
        if spacing > 1.5 * outline.beam:
            raise UserError(
                f"thrusters {spacing:g} m apart do not fit a beam of {outline.beam:g} m (m both)"
            )
        if unknown := [name for name in self.reversed if name not in self.names]:
            raise UserError(
                f"no motor {unknown[0]!r} can be reversed{nearest(unknown[0], self.names)}; "
                f"there are: {', '.join(self.names)}"
            )
        sides = {"port": -0.5, "starboard": 0.5}
        thrust, width, said = self._thrust(outline, hull, top_speed_known)
        made = []
        for name in self.names:
            y = sides.get(name, 0.0) * spacing
            table: dict[str, object] = {"name": name, "x": -0.5 * outline.length, "y": y}
            table["time_constant"] = LAG
            reasons = {"x": "assumed: at the stern; a push straight ahead does not depend on it"}
            reasons |= {"y": f"half of {spacing:.4g} m, {why}"} if y else {}
            reasons["time_constant"] = "s, assumed: a motor that follows its order"
            if self.unit == "N":
                table |= {"unit": "N"}
                table |= {} if self.full_thrust is None else {"max_force": thrust}
                made.append(Part("thruster", table, reasons, {"time_constant": LAG_WIDTH}))
                continue
            curve, told = self._curve(thrust, said)
            turns = self.unit in PER_REVOLUTION
            bend = SHAFT_EXPONENT_WIDTH if turns else EXPONENT_WIDTH
            widths = {"full_thrust": width, "exponent": bend, "astern_ratio": ASTERN_WIDTH}
            of_scale, of_ends = self._scale(name)
            made.append(
                Part(
                    "thruster",
                    table | of_scale | {"thrust_curve": curve},
                    reasons | of_ends | {f"thrust_curve.{k}": text for k, text in told.items()},
                    {"time_constant": LAG_WIDTH}
                    | {f"thrust_curve.{key}": one for key, one in widths.items()},
                )
            )
        return made

    def _thrust(
        self, outline: Outline, hull: Mapping[str, DerivativeEstimate], top_speed_known: bool
    ) -> tuple[float, float, str]:
        """Full thrust (N) of one, its relative width, and what it rests on."""
        if self.full_thrust is not None:
            return self.full_thrust, KNOWN_THRUST_WIDTH, "as given"
        drag, count = drag_at(outline.top_speed, hull), len(self.names)
        width = math.hypot(hull["X_uu"].spread, 2 * TOP_SPEED_WIDTHS[top_speed_known])
        known = "as given" if top_speed_known else "assumed"
        share = f" over {count}" if count > 1 else ""
        said = f"the drag at the top speed of {outline.top_speed:.3g} m/s ({known}){share}"
        return drag / count, min(width, WIDEST), said

    def _curve(self, thrust: float, said: str) -> tuple[dict[str, float], dict[str, str]]:
        """The thrust curve and what it rests on."""
        astern = ASTERN if self.astern_ratio is None else self.astern_ratio
        exponent, why = EXPONENT, "assumed: between linear and quadratic"
        if self.unit in PER_REVOLUTION:
            exponent, why = SHAFT_EXPONENT, "the square of the shaft speed"
        told = {"full_thrust": said, "exponent": why}
        given = self.astern_ratio is not None
        told["astern_ratio"] = "1 / MOT_THST_ASYM of the log" if given else "assumed"
        return {"full_thrust": thrust, "exponent": exponent, "astern_ratio": astern}, told

    def _scale(self, name: str) -> tuple[dict[str, object], dict[str, str]]:
        """Unit, neutral and ends of the orders, and what they rest on."""
        if self.unit in PER_REVOLUTION and self.shaft_speed is not None:
            most = self.shaft_speed * PER_REVOLUTION[self.unit]
            usual = MotorScale(0.0, most, -most, name in self.reversed, "as given")
        else:
            usual = MotorScale(*SCALES[self.unit], reversed=name in self.reversed)
        scale = self.scales.get(name, usual)
        ends = {key: getattr(scale, key) for key in ("neutral", "full_ahead", "full_astern")}
        table: dict[str, object] = {"unit": self.unit, **ends}
        table |= {"reversed": True} if scale.reversed else {}
        return table, dict.fromkeys(ends, f"{self.unit}, {scale.said_by}")


@dataclasses.dataclass(frozen=True)
class Azimuths:
    """Thrusters that turn, by name at (x, y): m ahead of amidships, m to starboard.

    `thrusters` says all else of them; its names are theirs.
    """

    places: Mapping[str, tuple[float, float]]
    thrusters: Thrusters

    def parts(
        self, outline: Outline, hull: Mapping[str, DerivativeEstimate], top_speed_known: bool
    ) -> list[Part]:
        """The azimuth thrusters' tables.

        Raises:
            UserError: one that lies outside the hull, or what `Thrusters.parts` refuses.
        """
        made = []
        for part in self.thrusters.parts(outline, hull, top_speed_known):
            x, y = self.places[str(part.table["name"])]
            if abs(x) > 0.6 * outline.length or abs(y) > 0.75 * outline.beam:
                raise UserError(
                    f"azimuth thruster {part.table['name']!r} at {x:g} m ahead of amidships and "
                    f"{y:g} m to starboard lies outside a hull of {outline.length:g} m by "
                    f"{outline.beam:g} m"
                )
            placed = {"x": x, "y": y, "angle_time_constant": TURNING_LAG}
            turning = "s, assumed: a pod that turns to its angle"
            why = {"x": "m, as given", "y": "m, as given", "angle_time_constant": turning}
            widths = {"angle.time_constant": LAG_WIDTH} | {
                "force.time_constant" if key == "time_constant" else key: width
                for key, width in part.widths.items()
            }
            table, reasons = part.table | placed, part.reasons | why
            made.append(Part("azimuth_thruster", table, reasons, widths))
        return made


@dataclasses.dataclass(frozen=True)
class RudderDrive:
    """A rudder behind a propeller (orders in rev/s), or behind one thruster of orders in a unit.

    `area` (m^2), `diameter` (m), `shaft_speed` (rev/s, the largest ahead) and the places of rudder
    and propeller (m ahead of amidships) are assumed where they are None.

    Raises:
        UserError: a rudder or a propeller outside the hull, by `parts`.
    """

    area: float | None = None
    diameter: float | None = None
    thruster: Thrusters | None = None  # in the propeller's place
    shaft_speed: float | None = None
    rudder_x: float | None = None
    propeller_x: float | None = None

    def parts(
        self, outline: Outline, hull: Mapping[str, DerivativeEstimate], top_speed_known: bool
    ) -> list[Part]:
        """The tables of propeller or thruster, and rudder."""
        if self.thruster is not None:
            driving = self.thruster.parts(outline, hull, top_speed_known)
            return [*driving, self._rudder(outline, None)]
        return [self._propeller(outline, hull), self._rudder(outline, "propeller")]

    def _propeller(self, outline: Outline, hull: Mapping[str, DerivativeEstimate]) -> Part:
        wake = max(0.5 * outline.block_coefficient - 0.05, 0.0)
        inflow = (1 - wake) * outline.top_speed
        thrust = drag_at(outline.top_speed, hull) / ((1 - THRUST_DEDUCTION) * outline.water_density)
        holds = f"holds the top speed of {outline.top_speed:.3g} m/s"
        x, of_x = _placed("propeller", self.propeller_x, -0.47, outline)
        D, of_D = self.diameter, "as given"
        n, of_n = self.shaft_speed, "rev/s, as given"
        widths = {"k_T.0": K_T_WIDTH, "astern_factor": ASTERN_WIDTH}
        if D is None and n is not None:
            D, of_D = _diameter(n, inflow, thrust), holds
        elif D is None:
            D, of_D = PROPELLER_SHARE * outline.draught, "assumed: 0.65 of the draught"
        if self.diameter is None:
            widths["diameter"] = DIAMETER_WIDTH
        if n is None:
            n, of_n = _shaft_speed(D, inflow, thrust), f"rev/s, {holds}"
        table: dict[str, object] = {
            "name": "propeller",
            "x": x,
            "diameter": D,
            "k_T": list(K_T),
            "wake_fraction": wake,
            "thrust_deduction": THRUST_DEDUCTION,
            "astern_factor": ASTERN,
            "max_speed": n,
            "min_speed": -ASTERN_SPEED * n,
        }
        reasons = {
            "x": of_x,
            "diameter": of_D,
            "k_T": "about Wageningen B4-55 at pitch ratio 0.9; the first one, its pitch, is free",
            "wake_fraction": "0.5 C_B - 0.05 (Taylor)",
            "thrust_deduction": "assumed",
            "astern_factor": "assumed: K_T at rest astern over ahead",
            "max_speed": of_n,
            "min_speed": "assumed",
        }
        return Part("propeller", table, reasons, widths)

    def _rudder(self, outline: Outline, propeller: str | None) -> Part:
        L, B, T = outline.length, outline.beam, outline.draught
        area, why = self.area, "as given"
        if area is None and outline.is_streamlined:
            area, why = L * T / 100 * (1 + 25 * (B / L) ** 2), "Det Norske Veritas"
        elif area is None:
            area, why = L * T / BOAT_RUDDER, f"assumed: L T / {BOAT_RUDDER}"
        x, of_x = _placed("rudder", self.rudder_x, -0.5, outline)
        aspect = 1.6
        table: dict[str, object] = {
            "name": "rudder",
            "area": area,
            "height": math.sqrt(aspect * area),
            "x": x,
            "max_angle": MAX_ANGLE,
            "lift_slope": 6.13 * aspect / (aspect + 2.25),
        }
        reasons = {
            "area": why,
            "height": "assumed: aspect ratio 1.6",
            "x": of_x,
            "max_angle": "rad, assumed: 35 deg",
            "lift_slope": "6.13 A / (A + 2.25) at aspect ratio A (Fujii)",
        }
        widths = {"area": 0.4 if propeller else 0.7}
        if propeller is not None:
            table |= {"propeller": propeller, "kappa": KAPPA}
            reasons["kappa"] = "slipstream: half sped up in the disc, wholly far behind"
            widths["kappa"] = KAPPA_WIDTH
        if outline.is_streamlined:
            with_hull = _interaction(outline)
            table |= with_hull
            reasons |= dict.fromkeys(with_hull, KIJIMA) | {"x_H": "-0.45 L"}
        if propeller is not None or outline.is_streamlined:
            sides = ("gamma_R_port", "gamma_R_starboard")
            table |= {"l_R": -0.9 * L} | dict.fromkeys(sides, _straightening(outline))
            reasons |= {"l_R": "-0.9 L"} | dict.fromkeys(sides, KIJIMA)
            widths |= dict.fromkeys(sides, STRAIGHTENING_WIDTH)
        return Part("rudder", table, reasons, widths)


def _interaction(outline: Outline) -> dict[str, object]:
    """What a ship's rudder and hull add to one another's forces (Kijima et al. 1990)."""
    C_B, L = outline.block_coefficient, outline.length
    t_R, a_H = max(0.45 - 0.28 * C_B, 0.0), max(0.627 * C_B - 0.153, 0.0)
    return {"t_R": t_R, "a_H": a_H, "x_H": -0.45 * L}


def _straightening(outline: Outline) -> float:
    """gamma_R: how much of a drift the rudder feels behind hull and propeller (Kijima et al.)."""
    q = outline.block_coefficient * outline.hull_beam / outline.length
    return max(0.68 + 0.02 * q - 22.2 * q**2, 0.2)


def _shaft_speed(diameter: float, inflow: float, thrust: float) -> float:
    """The shaft speed (rev/s) of n^2 D^4 K_T(J) = thrust / rho, with J = inflow / (n D)."""
    k0, k1, k2 = K_T
    return _largest_root((k0, k1 * inflow, k2 * inflow**2 - thrust / diameter**2)) / diameter


def _placed(name: str, x: float | None, usual: float, outline: Outline) -> tuple[float, str]:
    """Where a part sits (m ahead of amidships), and what that rests on; `usual` in lengths."""
    if x is None:
        return usual * outline.length, f"m, assumed: {-usual:g} L aft"
    if abs(x) > 0.6 * outline.length:
        raise UserError(
            f"the {name} at {x:g} m ahead of amidships lies outside a hull of {outline.length:g} m"
        )
    return x, "m, as given"


def _diameter(shaft_speed: float, inflow: float, thrust: float) -> float:
    """The diameter (m) of n^2 D^4 K_T(J) = thrust / rho, with J = inflow / (n D)."""
    k0, k1, k2 = K_T
    n = shaft_speed
    return _largest_root((k0 * n**2, k1 * inflow * n, k2 * inflow**2, 0.0, -thrust))


def _largest_root(coefficients: tuple[float, ...]) -> float:
    """Of a polynomial that is negative at zero and grows in the end."""
    roots = np.roots(coefficients)
    return float(np.max(roots.real[np.abs(roots.imag) < 1e-9 * np.abs(roots)]))


def drag_at(speed: float, hull: Mapping[str, DerivativeEstimate]) -> float:
    """The estimated drag ahead (N) at a speed (m/s)."""
    return -(hull["X_u"].value * speed + hull["X_uu"].value * speed**2)
