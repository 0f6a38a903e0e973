"""A trial's log with the quantities derived from it, time counted from the onset."""

import numpy as np

from diffsea.kinematics import wrap
from diffsea.segments.signals import Signals
from diffsea.simulation.actuation import yaw_moments
from diffsea.trajectory import Samples
from diffsea.vessel.base import Vessel


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
        "t": t - onset,
        "x": run.x,
        "y": run.y,
        "psi_wrapped": np.asarray(wrap(psi)),
        "psi_unwrapped": psi,
        "psi_relative": psi - np.interp(onset, t, psi),
        "u": run.u,
        "v": run.v,
        "r": run.r,
        "r_calc": np.gradient(psi, t),
    }
    for name, angle in (("delta_cmd", signals.commanded), ("delta_exec", signals.steer)):
        columns |= {} if angle is None else {name: angle}
    for channel, thrust in vessel.thrusts_at_rest.items():
        columns[f"T_{channel}"] = np.asarray(thrust(run.executed[channel]), float)
    return columns | {"tau_z": yaw_moments(vessel, run)}
