"""The virtual campaign: the six trials run, logged, traced and made ready to identify.

All trials of one kind run side by side in one compiled program, with actuators that answer at
once and with ones that do not: lag, dead band and limits are exactly absent at zero.
"""

import dataclasses
import itertools
import math
from collections.abc import Sequence

from experiments.virtual_sea_trials import marus_fit, marus_vessel
from experiments.virtual_sea_trials import marus_published as published

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from diffsea import Trajectory, TrialPlan, Vessel, find_segments, recording_metrics, resample
from diffsea.metrics.ittc import approach_verdict
from diffsea.scales import HARD_OVER
from diffsea.segments import Segment, traceability
from diffsea.simulation import planning
from diffsea.vessel.files import Table, build


GUARD = 0.1  # s before the onset that no approach is judged by
SETTLING = 34.0  # ship lengths of steady running before the execute: some 120 s, as published
INTERVAL = 0.02  # s, of the log: a game engine's usual step
# Of the log, assumed: m, rad, m/s, rad/s.
NOISE = {"x": 0.01, "y": 0.01, "psi": math.radians(0.01), "u": 0.002, "v": 0.002,
         "r": math.radians(0.03)}  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Actuators:
    """How thrusters answer. Forces as shares of the thrust that holds the approach speed."""

    lag: float = 0.0  # s
    deadband: float = 0.0
    limit: float = 1e3

    def fitted_to(self, table: Table, thrust: float) -> Table:
        """The vessel's file with these on both thrusters."""
        words = {
            "time_constant": self.lag, "deadband": self.deadband * thrust,
            "max_force": self.limit * thrust, "min_force": -self.limit * thrust,
        }  # fmt: skip
        return table | {"thruster": [part | words for part in table["thruster"]]}


AT_ONCE = Actuators()
REAL = Actuators(lag=0.5, deadband=0.04, limit=0.85)  # assumed: the paper prints none of these


@dataclasses.dataclass(frozen=True)
class Logged:
    """One trial as it was logged, and what the processing makes of it."""

    run: published.Run
    log: Trajectory
    segment: Segment
    checks: list
    metrics: dict


def vessel_of(
    hull: dict[str, float], actuators: Actuators, effects: Sequence[Table] = ()
) -> Vessel:
    """A fitted hull with actuators and effects."""
    return build(document_of(hull, actuators, effects))


def document_of(
    hull: dict[str, float], actuators: Actuators, effects: Sequence[Table] = ()
) -> Table:
    """The file of a fitted hull with actuators and effects."""
    thrust = marus_vessel.drag_at(hull, published.TARGET_SPEED)
    table = actuators.fitted_to(marus_vessel.document(hull), thrust)
    return table | ({"effect": list(effects)} if effects else {})


def simulated(vessels: list[Vessel]) -> list[list[Trajectory]]:
    """The six trials of each vessel, from 0.8311 m/s held for some 120 s."""
    stack = jax.tree.map(
        lambda *leaves: jnp.stack([jnp.asarray(v, float) for v in leaves]), *vessels
    )
    out: list[list] = [[None] * len(published.RUNS) for _ in vessels]
    for kind in ("turning-circle", "zigzag"):
        rows = [n for n, run in enumerate(published.RUNS) if run.manoeuvre == kind]
        orders = _orders([published.RUNS[n] for n in rows])
        plan = marus_fit.plan_of(published.RUNS[rows[0]], vessels[0])
        settings = dataclasses.replace(plan.settings, steady_lengths=SETTLING)
        plan = dataclasses.replace(
            plan, settings=settings, approach_seconds=200.0, angle=0.0, heading=0.0, side=1.0
        )
        found = _all(stack, orders, plan)
        for v in range(len(vessels)):
            for place, row in enumerate(rows):
                trial = jax.tree.map(lambda leaf, v=v, k=place: np.asarray(leaf[v][k]), found)
                out[v][row] = _logged_rows(trial.trajectory, published.RUNS[row].name)
    return out


def _orders(runs: list[published.Run]) -> dict[str, jax.Array]:
    return {
        "angle": jnp.radians(jnp.array([run.angle for run in runs])),
        "heading": jnp.radians(jnp.array([run.heading for run in runs])),
        "side": jnp.array([float(run.side) for run in runs]),
        "speed": jnp.full(len(runs), published.TARGET_SPEED),
    }


@eqx.filter_jit
def _all(vessels: Vessel, orders: dict[str, jax.Array], plan: TrialPlan):
    def one(vessel: Vessel, order: dict[str, jax.Array]):
        return planning.run_plan(vessel, dataclasses.replace(plan, **order))

    return jax.vmap(lambda vessel: jax.vmap(lambda order: one(vessel, order))(orders))(vessels)


def _logged_rows(trajectory: Trajectory, name: str) -> Trajectory:
    """What a logger on a fixed clock keeps."""
    return resample(dataclasses.replace(trajectory, name=name), INTERVAL)


def with_noise(log: Trajectory, seed: int) -> Trajectory:
    """The log as sensors of `NOISE` would give it."""
    rng = np.random.default_rng(seed)
    noisy = {
        name: np.asarray(getattr(log, name)) + std * rng.normal(size=len(log.t))
        for name, std in NOISE.items()
    }
    return dataclasses.replace(log, **noisy)


def processed(clean: Trajectory, seed: int, run: published.Run, vessel: Vessel) -> Logged:
    """A log taken through the campaign: segment, approach, checks and numbers.

    Segment and checks are of the log with noise. Numbers are read off the one without, as the
    paper's are: smoothing noise away rounds the reversals and moves the largest yaw rates.
    """
    log = with_noise(clean, seed)
    kind = "turning" if run.manoeuvre == "turning-circle" else "zigzag"
    found = find_segments(log, vessel)
    chosen = [segment for segment in found if segment.kind == kind]
    if not chosen:
        raise SystemExit(f"{run.name}: no {kind} in the log, only {[s.kind for s in found]}")
    segment = max(chosen, key=lambda one: one.end - one.onset)
    checks = traceability(segment, log, vessel)
    metrics = recording_metrics(clean, published.LENGTH, run.manoeuvre)
    return Logged(run, log, segment, checks, metrics)


def rudder_equivalent(actuation: dict[str, np.ndarray]) -> np.ndarray:
    """Eq. 3 (rad), positive to starboard: the paper's sign is the other one."""
    port, starboard = np.asarray(actuation["port"]), np.asarray(actuation["starboard"])
    total = port + starboard
    some = np.abs(total) > 1e-9
    return np.where(some, HARD_OVER * (port - starboard) / np.where(some, total, 1.0), 0.0)


def onset(log: Trajectory, threshold: float = math.radians(1.0)) -> float:
    """Eq. 5 (s): when the executed rudder-equivalent first passes the threshold (rad)."""
    beyond = np.abs(rudder_equivalent(log.executed)) > threshold
    return float(np.asarray(log.t)[np.argmax(beyond)]) if beyond.any() else math.nan


def realisation(log: Trajectory, start: float) -> dict[str, float]:
    """Eq. 14 over the manoeuvre: median, and extremes of executed over ordered steering."""
    after = np.asarray(log.t) >= start
    asked = np.abs(rudder_equivalent(log.commanded))[after]
    done = np.abs(rudder_equivalent(log.executed))[after]
    ratio = done[asked > math.radians(1)] / asked[asked > math.radians(1)]
    low, middle, high = np.quantile(ratio, [0.02, 0.5, 0.98])
    return {"median": float(middle), "low": float(low), "high": float(high)}


def approach_window(log: Trajectory, start: float, seconds: float = published.WINDOW) -> dict:
    """Eq. 13 and table 2 over the last seconds before the onset, m/s and deg/s."""
    t = np.asarray(log.t)
    # The onset is known to a few samples only: the last ones may have seen the order.
    rows = (t >= start - seconds) & (t < start - GUARD)
    speed = np.hypot(np.asarray(log.u)[rows], np.asarray(log.v)[rows])
    fastest, mean = float(np.max(np.abs(np.asarray(log.r)[rows]))), float(np.mean(speed))
    judged = approach_verdict(mean, fastest, published.TARGET_SPEED)
    return {
        "speed": mean, "speed_std": float(np.std(speed)), "yaw_rate": math.degrees(fastest),
        "verdict": judged["verdict"],
    }  # fmt: skip


def reversals(log: Trajectory, start: float) -> int:
    """How often the executed rudder-equivalent changes its sign after the onset."""
    executed = rudder_equivalent(log.executed)[np.asarray(log.t) >= start]
    signs = np.sign(executed[np.abs(executed) > math.radians(1)])
    return int(np.sum(signs[1:] != signs[:-1]))


def largest_difference(runs: list[list[Trajectory]], again: list[list[Trajectory]]) -> float:
    """Largest difference of any motion sample between trials and their repeats, in SI units."""
    pairs = zip(itertools.chain(*runs), itertools.chain(*again), strict=True)
    return max(
        float(np.max(np.abs(one.motion[name] - other.motion[name])))
        for one, other in pairs
        for name in one.motion
    )


def reconstructed(log: Trajectory) -> np.ndarray:
    """Eq. 11: the yaw rate (rad/s) of the heading, sample by sample."""
    return np.gradient(np.asarray(log.psi), np.asarray(log.t))


def yaw_consistency(log: Trajectory) -> dict[str, float]:
    """Eqs. 11 and 12: logged yaw rate against the heading differentiated sample by sample."""
    r, rebuilt = np.asarray(log.r), reconstructed(log)
    rms = math.degrees(float(np.sqrt(np.mean((r - rebuilt) ** 2))))
    return {"correlation": float(np.corrcoef(r, rebuilt)[0, 1]), "rms": rms}


def state_log(log: Trajectory, start: float) -> dict[str, np.ndarray]:
    """Eq. 9: the time-aligned log with every derived quantity, time from the onset."""
    t, psi = np.asarray(log.t), np.asarray(log.psi)
    at_onset = float(np.interp(start, t, psi))
    thrust = {side: np.asarray(log.executed[side]) for side in ("port", "starboard")}
    return {
        "t": t - start, "x": np.asarray(log.x), "y": np.asarray(log.y),
        "psi_wrapped": (psi + np.pi) % (2 * np.pi) - np.pi, "psi_unwrapped": psi,
        "psi_relative": psi - at_onset, "u": np.asarray(log.u), "v": np.asarray(log.v),
        "r": np.asarray(log.r), "r_calc": reconstructed(log),
        "delta_cmd": rudder_equivalent(log.commanded),
        "delta_exec": rudder_equivalent(log.executed),
        "T_port": thrust["port"], "T_starboard": thrust["starboard"],
        "tau_z": marus_vessel.ARM * (thrust["port"] - thrust["starboard"]),
    }  # fmt: skip
