"""A trial's log with the quantities derived from it, time counted from the onset."""

import jax
import jax.numpy as jnp
import numpy as np

from diffsea.kinematics import wrap
from diffsea.segments.signals import Signals
from diffsea.trajectory import MOTION_CHANNELS, Samples
from diffsea.types import Scalar, State
from diffsea.vessel.base import Vessel
from diffsea.vessel.forces import Force


def state_log(vessel: Vessel, signals: Signals, onset: float) -> dict[str, Samples]:
    """Columns by name, after Rezayan (2026, eq. 9), SI units and rad, positive to starboard.

    `psi_wrapped`, `psi_unwrapped` and `psi_relative` (to that at the onset) are the heading,
    `r_calc` is its slope, `delta_cmd` and `delta_exec` are ordered and executed steering, where
    there is any, `T_<channel>` is the thrust at rest (N) of what a propulsor executed, and `tau_z`
    the yaw moment (N m) of all actuators as they act in the motion.

    Arguments:
        onset: s, on the clock of the recording.
    """
    run, t, psi = signals.run, signals.t, signals.psi
    columns = {
        "t": t - onset, "x": run.x, "y": run.y, "psi_wrapped": np.asarray(wrap(psi)),
        "psi_unwrapped": psi, "psi_relative": psi - np.interp(onset, t, psi),
        "u": run.u, "v": run.v, "r": run.r, "r_calc": np.gradient(psi, t),
    }  # fmt: skip
    for name, angle in (("delta_cmd", signals.commanded), ("delta_exec", signals.steer)):
        columns |= {} if angle is None else {name: angle}
    for channel, thrust in vessel.thrusts_at_rest.items():
        columns[f"T_{channel}"] = np.asarray(thrust(run.executed[channel]), float)
    state = State(*(jnp.asarray(getattr(run, channel)) for channel in MOTION_CHANNELS))
    executed: dict[str, Scalar] = {c: jnp.asarray(run.executed[c]) for c in vessel.channels}

    def yaw_moment(state: State, executed: dict[str, Scalar], t: Scalar) -> Scalar:
        forces = vessel.breakdown(state, executed, vessel.environment, t)
        return sum((forces[name] for name in vessel.actuators), Force()).N

    moments = jax.jit(jax.vmap(yaw_moment))(state, executed, jnp.asarray(t))
    return columns | {"tau_z": np.asarray(moments, float)}
