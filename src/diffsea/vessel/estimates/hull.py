"""The derivatives of a hull: all estimates of an outline, each with its value and its prior."""

import statistics

from diffsea.vessel.estimates.added_mass import added_masses
from diffsea.vessel.estimates.lateral import LINEAR_AT, cross_flow_drag, lift_derivatives
from diffsea.vessel.estimates.outline import Outline
from diffsea.vessel.estimates.resistance import BALANCE, linear_share, resistances
from diffsea.vessel.estimates.scatter import DerivativeEstimate, combined


INERTIA_WIDTH = 0.4  # of I_z, which the prior of N_rdot carries: a fit leaves I_z as it is
AT_REST = 0.7  # further width of linear damping at rest, for which there is no published estimate


def hull_estimates(
    outline: Outline, thrust_at_top: float | None = None
) -> dict[str, DerivativeEstimate]:
    """Every derivative and added mass of the vessel file, by name.

    Arguments:
        thrust_at_top: all thrust (N) that holds the top speed, where it is known: it is the drag
            then, and no formula is needed.
    """
    masses = added_masses(outline)
    inertia = INERTIA_WIDTH * outline.I_z / abs(statistics.fmean(masses["N_rdot"].values()))
    found = [
        combined("X_udot", masses["X_udot"]),
        combined("Y_vdot", masses["Y_vdot"]),
        combined("N_rdot", masses["N_rdot"], inertia, note="its width carries that of I_z, 40 %"),
        *_surge_drag(outline, thrust_at_top),
    ]
    X_udot, Y_vdot, _, X_u, X_uu = found
    found += _lateral_drag(outline, X_u.value, X_uu.value)
    lifted = lift_derivatives(outline, -X_udot.value, -Y_vdot.value, -X_uu.value)
    found += [combined(name, methods) for name, methods in lifted.items()]
    return {one.name: one for one in found}


def _surge_drag(outline: Outline, thrust_at_top: float | None) -> list[DerivativeEstimate]:
    """X_u (N s/m) and X_uu (N s^2/m^2): together they are the drag at one speed, and its slope."""
    if thrust_at_top is None:
        speed = outline.service_speed
        drags = resistances(outline, speed)
    else:
        speed, drags = outline.top_speed, {BALANCE: thrust_at_top}
    share = linear_share(outline, speed)
    linear = {source: -share * drag / speed for source, drag in drags.items()}
    square = {source: -(1 - share) * drag / speed**2 for source, drag in drags.items()}
    note = f"the drag at {speed:.3g} m/s, and its slope with speed by ITTC-57"
    return [combined("X_u", linear, note=note), combined("X_uu", square, note=note)]


def _lateral_drag(outline: Outline, X_u: float, X_uu: float) -> list[DerivativeEstimate]:
    """Damping of sway and yaw at rest, linear and quadratic."""
    strips, lever = cross_flow_drag(outline), 0.5 * outline.spacing
    turned = {source: x + X_uu * lever**3 for source, x in strips["N_rr"].items()}
    slow = LINEAR_AT * outline.service_speed
    Y_v = {source: slow * value for source, value in strips["Y_vv"].items()}
    rate = 2 * slow / outline.length  # at which the ends move as fast
    N_r = {source: rate * x + X_u * lever**2 for source, x in turned.items()}
    note = f"assumed: as large as the quadratic part at {slow:.2g} m/s"
    return [
        combined("Y_v", Y_v, AT_REST, note=note),
        combined("Y_vv", strips["Y_vv"]),
        combined("N_r", N_r, AT_REST, note=note + " of the ends"),
        combined("N_rr", turned),
    ]
