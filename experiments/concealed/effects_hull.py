"""Hull and inertia."""

from .effect import Effect, sided, timed
from .effects_sensors import weight
from .hulls import Hull
from .model import HEEL, Model


def effects(hull: Hull) -> list[Effect]:
    """The entries for this hull: a damping term only where its file has none."""
    h = hull.document["hull"]
    L, m, U = h["length"], h["mass"], hull.speed
    F, yaw = weight(hull), hull.yaw
    ship = hull.kind == "ship"
    found = [
        Effect("mass-change", "", ("mass",), ("surge", "sway"), 0.1 * m, 1.5 * m, mass, timed,
               onset=True),
        Effect("drag-change", "", ("factor",), ("surge", "sway", "yaw"), 0.1, 2.0, drag, timed,
               onset=True),
        Effect("added-mass-coupling", "Y_rdot", ("Y_rdot",), ("sway", "yaw"), 0.02 * m * L,
               0.5 * m * L, _added("Y_rdot"), sided),
        Effect("added-mass-coupling", "N_vdot", ("N_vdot",), ("sway", "yaw"), 0.02 * m * L,
               0.5 * m * L, _added("N_vdot"), sided),
        Effect("added-mass-coupling", "x_G", ("x_G",), ("sway", "yaw"), 0.02 * L, 0.25 * L,
               _added("x_G"), sided),
    ]  # fmt: skip
    # A file without the moment says that its N_v or N_uv holds all of it.
    if h.get("added_mass_coriolis", "full") == "full":
        found.append(Effect("munk-moment", "", ("Y_vdot - X_udot",), ("yaw",), 0.1 * m, 3.0 * m,
                            munk, sided))  # fmt: skip
    if not ship:
        found += _damping(h, F, L, U, yaw)
    if "Y_vv" not in h and "Y_vvv" not in h:
        found.append(Effect("crossflow-drag", "", ("cd",), ("sway", "yaw"), 0.3, 12.0, strips))
    if "roll" in hull.instruments:
        heel = HEEL * U * yaw / 9.81
        for name, scale in (("Y_phi", F / heel), ("N_phi", F * L / heel)):
            found.append(Effect("roll-coupling", name, (name,), ("sway", "yaw"), 0.03 * scale,
                                5.0 * scale, _roll(name), sided))  # fmt: skip
    return found


def _damping(h: dict, F: float, L: float, U: float, yaw: float) -> list[Effect]:
    """Quadratic, coupling and speed-proportional terms, scaled to be F at U and yaw."""
    found = []
    v = 0.2 * U
    for name, dof, scale in (
        ("X_uu", "surge", F / U**2), ("Y_vv", "sway", F / v**2), ("N_rr", "yaw", F * L / yaw**2),
    ):  # fmt: skip
        if name not in h:
            found.append(Effect("quadratic-damping", name, (name,), (dof,), 0.1 * scale,
                                10.0 * scale, _derivative(name, -1.0)))  # fmt: skip
    for name, dof, scale in (("Y_r", "sway", F / yaw), ("N_v", "yaw", F * L / v)):
        if name not in h:
            found.append(Effect("sway-yaw-coupling", name, (name,), (dof,), 0.1 * scale,
                                2.0 * scale, _derivative(name), sided))  # fmt: skip
    for name, dof, scale in (
        ("Y_ur", "sway", F / U / yaw), ("N_ur", "yaw", F * L / U / yaw),
        ("Y_uv", "sway", F / U / v),  # N_uv is the Munk moment by another name
    ):  # fmt: skip
        if name not in h:
            # Damping of one's own motion is a drag; the cross terms have either sign.
            own = name in ("N_ur", "Y_uv")
            put = _derivative(name, -1.0) if own else _derivative(name)
            draw = (lambda rng, hull: {}) if own else sided
            found.append(Effect("speed-dependent-damping", name, (name,), (dof,), 0.1 * scale,
                                3.0 * scale, put, draw))  # fmt: skip
    return found


def _derivative(name: str, only: float = 0.0):
    def put(model: Model, hull: Hull, size: float, extra: dict) -> dict:
        value = size * (only or extra["side"])
        model.hull[name] = model.hull.get(name, 0.0) + value
        return {name: value}

    return put


def _added(name: str):
    """x_G is added to the vessel's own; the couplings are there from zero."""
    return _derivative(name)


def _roll(name: str):
    def put(model: Model, hull: Hull, size: float, extra: dict) -> dict:
        model.roll[name] = size * extra["side"]
        return dict(model.roll)

    return put


def munk(model: Model, hull: Hull, size: float, extra: dict) -> dict:
    model.munk = size * extra["side"]
    return {"Y_vdot - X_udot": model.munk}


def mass(model: Model, hull: Hull, size: float, extra: dict) -> dict:
    """Taken on; lost only where the hull keeps half of its mass."""
    value = size if extra["side"] > 0 or size > 0.5 * hull.document["hull"]["mass"] else -size
    model.steps.append((extra["time"], "mass", value))
    return {"time": extra["time"], "mass": value}


def drag(model: Model, hull: Hull, size: float, extra: dict) -> dict:
    value = size if extra["side"] > 0 or size > 0.6 else -size
    model.steps.append((extra["time"], "drag", value))
    return {"time": extra["time"], "factor": value}


def strips(model: Model, hull: Hull, size: float, extra: dict) -> dict:
    model.strip_cd = size
    return {"cd": size}
