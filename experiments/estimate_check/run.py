"""Estimates of `diffsea new` beside what is stated of every vessel that ships.

    python -m experiments.estimate_check.run

Vessel files write the same forces in different ways: linear, quadratic, power laws, primes. So the
forces are compared, of both models in the same motion, and the added masses.
"""

import math

from experiments.harness.reporting import experiment, table

from diffsea import Environment, State
from diffsea.vessel.base import Vessel
from diffsea.vessel.estimates import Known, Outline, hull_estimates, outline_of
from diffsea.vessel.estimates.scatter import DerivativeEstimate
from diffsea.vessel.files import build, read_vessel, shipped_vessels
from diffsea.vessel.forces import Force


# What an owner would say of each; the draught of a small boat he has seldom measured.
FORMS = {
    "blueboat": "catamaran", "otter": "catamaran", "pytheas": "catamaran",
    "vrx_wamv": "catamaran", "wamv": "catamaran", "marus_usv": "monohull",
    "esso_osaka": "ship", "kvlcc2": "ship", "mariner": "ship", "shioji_maru": "ship",
}  # fmt: skip
KNOWN_DRAUGHT = ("esso_osaka", "kvlcc2", "mariner", "shioji_maru")
SIDEWAYS = 0.3  # sway over the service speed at which drag across is compared
SMALL = 1e-6  # of the service speed: step of the differences by v and by r L / 2
LEAST_SHARE = 1e-3  # of damping in a force over speed: less is drag of a drift that is small
FORCES = ("surge drag", "sway drag", "yaw damping")
AT_SPEED = {"Y_v at speed": "Y_uv", "Y_r at speed": "Y_ur"}
AT_SPEED |= {"N_v at speed": "N_uv", "N_r at speed": "N_ur"}
COLUMNS = ("X_udot", "Y_vdot", "N_rdot", *FORCES, *AT_SPEED)


def main() -> None:
    run = experiment(__file__, __doc__)
    found = {name: compare(name) for name in shipped_vessels()}
    spreads = {column: spread(column, found) for column in COLUMNS}
    rows = [(name, *(one["ratio"][c] for c in COLUMNS)) for name, one in found.items()]
    counts = [sum(one["ratio"][c] is not None for one in found.values()) for c in COLUMNS]
    rows.append(("vessels", *counts))
    rows.append(("spread", *(round(spreads[c], 2) for c in COLUMNS)))
    run.write({"vessels": found, "spreads": spreads}, {"ratios": table(("vessel", *COLUMNS), rows)})


def compare(name: str) -> dict:
    """Numbers of a shipped vessel and of the estimate from its dimensions, and their ratios."""
    file = read_vessel(name)
    body, nondimensional = file.vessel.rigid_body, file.document["hull"].get("nondimensional")
    draught = float(body.draught) if name in KNOWN_DRAUGHT else None
    known = Known(
        FORMS[name],
        float(body.length),
        float(body.beam),
        float(body.mass),
        draught,
        water_density=float(body.water_density),
    )
    outline = outline_of(known)
    estimates = hull_estimates(outline)
    stated = numbers(file.vessel, outline)
    if nondimensional is not None:  # primes say nothing of a hull at rest
        stated |= dict.fromkeys(("sway drag", "yaw damping"), 0.0)
    if nondimensional == "abkowitz":  # resistance and thrust are one
        stated["surge drag"] = 0.0
    estimated = numbers(estimated_vessel(outline, estimates), outline)
    has = {c: abs(stated[c]) > LEAST_SHARE * abs(estimated[c]) for c in COLUMNS}
    ratio = {c: estimated[c] / stated[c] if has[c] else None for c in COLUMNS}
    off = {
        column: (estimated[column] - stated[column]) / abs(estimates[name].value)
        for column, name in AT_SPEED.items()
        if has[column]
    }
    return {
        "form": known.form,
        "froude_number": outline.service_speed / math.sqrt(9.81 * outline.length),
        "stated": {column: stated[column] if has[column] else None for column in COLUMNS},
        "estimated": estimated,
        "ratio": ratio,
        "off": off,
        "I_z": outline.I_z / float(body.I_z),
    }


def estimated_vessel(outline: Outline, estimates: dict[str, DerivativeEstimate]) -> Vessel:
    """The vessel of an outline without actuators."""
    size = ("length", "beam", "draught", "mass", "I_z", "water_density")
    hull = {key: getattr(outline, key) for key in size}
    return build({"hull": hull | {one.name: one.value for one in estimates.values()}})


def numbers(vessel: Vessel, outline: Outline) -> dict[str, float]:
    """Added masses, drag along and across, and forces over speed by v and r, of one model.

    Forces over the service speed: kg/m, kg, kg, kg m, with what added masses bring; zero where the
    model has no damping of its own there.
    """
    U, half = outline.service_speed, 0.5 * outline.length
    slow, turning = SIDEWAYS * U, SIDEWAYS * U / half
    added = {key: float(getattr(vessel.added_mass, key)) for key in ("X_udot", "Y_vdot", "N_rdot")}
    at_rest = {
        "surge drag": resistance(vessel, U).X,
        "sway drag": resistance(vessel, 0.0, slow).Y,
        "yaw damping": resistance(vessel, 0.0, 0.0, turning).N,
    }
    at_speed = {}
    for column, name in AT_SPEED.items():
        axis, letter = name[0], name[-1]
        step = SMALL * U if letter == "v" else SMALL * U / half
        motions = [(U, s * step, 0.0) if letter == "v" else (U, 0.0, s * step) for s in (1, -1)]
        own, bound = (
            [getattr(of(vessel, *motion), axis) for motion in motions]
            for of in (resistance, inertia)
        )
        damping = float(own[0] - own[1]) / (2 * step * U)
        whole = damping + float(bound[0] - bound[1]) / (2 * step * U)
        at_speed[column] = whole if abs(damping) > LEAST_SHARE * abs(whole) else 0.0
    return added | {key: float(value) for key, value in at_rest.items()} | at_speed


def resistance(vessel: Vessel, u: float, v: float = 0.0, r: float = 0.0) -> Force:
    """What the water resists a motion of the hull with (N, N m)."""
    state = State(0.0, 0.0, 0.0, u, v, r)
    made = [f(state, Environment(), 0.0) for f in vessel.forces.values() if f.resists]
    return sum(made, Force())


def inertia(vessel: Vessel, u: float, v: float, r: float) -> Force:
    """Coriolis forces of the added mass (N, N m)."""
    return vessel.added_mass.coriolis(State(0.0, 0.0, 0.0, u, v, r))


def spread(column: str, found: dict[str, dict]) -> float:
    """Root mean square of ln(estimate / stated), at speed of the difference over the estimate."""
    if column in AT_SPEED:
        values = [one["off"][column] for one in found.values() if column in one["off"]]
    else:
        ratios = [one["ratio"][column] for one in found.values()]
        values = [math.log(ratio) for ratio in ratios if ratio is not None]
    return math.sqrt(sum(value**2 for value in values) / len(values))


if __name__ == "__main__":
    main()
