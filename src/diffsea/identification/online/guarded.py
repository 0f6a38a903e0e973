"""An online estimator with its trust and its gate, step by step or along a recording.

An estimator that followed a fault is sure of what is wrong, and would take long to find back.
So it starts again, from what the controller has and with the prior's uncertainty, when the gate
closes, and every two windows after that while its trust is at the alarm level. The same lets it
follow a real change of the vessel that is faster than its random walk.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from diffsea.errors import UserError
from diffsea.identification.data.dataset import make_dataset
from diffsea.identification.filter.noise_fit import noise_prior
from diffsea.identification.filter.process_noise import Noise
from diffsea.identification.online import ekf, rls, trust
from diffsea.identification.online.choice import Choice
from diffsea.identification.online.gate import Gate, Passage, passed, shut
from diffsea.identification.online.trust import Evidence, Limits, Memory, Trust
from diffsea.parameters import Parameter
from diffsea.series import median_interval
from diffsea.simulation.actuation import recorded_actuation
from diffsea.trajectory import MOTION_CHANNELS, Trajectory
from diffsea.types import Scalar, State
from diffsea.vessel.base import Vessel


EKF_CHANNELS = MOTION_CHANNELS
RLS_CHANNELS = ("surge force", "sway force", "yaw moment")


class Guarded(eqx.Module):
    """An estimator, what its trust is measured by, and the gate."""

    estimator: ekf.Filter | rls.Regression
    limits: Limits
    gate: Gate

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """What is estimated."""
        return self.estimator.parameters

    def decode(self, coordinates: Float[Array, "parameter"]) -> dict[str, Scalar]:
        """Parameters in SI units at some coordinates."""
        return {p.name: p.decode(c) for p, c in zip(self.parameters, coordinates, strict=True)}


class Standing(eqx.Module):
    """Everything that a step carries on."""

    belief: ekf.Belief | rls.Running
    memory: Memory
    passage: Passage
    closed: Scalar  # s since the estimator last started, while the gate is closed


def guarded(
    estimator: ekf.Filter | rls.Regression,
    belief: ekf.Belief | rls.Running,
    limits: Limits | None = None,
) -> tuple[Guarded, Standing]:
    """An estimator behind a gate whose quarantine is the trust's window.

    Arguments:
        limits: of the trust; by default those of `trust.limits` for this estimator.
    """
    if limits is None:
        channels = EKF_CHANNELS if isinstance(estimator, ekf.Filter) else RLS_CHANNELS
        limits = trust.limits(estimator.vessel, estimator.parameters, channels)
    standing = Standing(belief, trust.begin(limits), shut(len(estimator.parameters)), jnp.zeros(()))
    return Guarded(estimator, limits, Gate(limits.window)), standing


class Step(eqx.Module):
    """What one step of a guarded estimator reports."""

    evidence: Evidence
    trust: Trust
    handed: Float[Array, "parameter"]  # coordinates for the controller
    open: Bool[Array, ""]
    restarted: Bool[Array, ""]  # the estimator started again after this step


def step(
    guard: Guarded,
    standing: Standing,
    orders: dict[str, Scalar],
    measurement: Float[Array, "6"],
    dt: Scalar,
) -> tuple[Standing, Step]:
    """One step of estimator, trust and gate; arguments as of `ekf.step`. Pure."""
    kind = ekf if isinstance(guard.estimator, ekf.Filter) else rls
    belief, news = kind.step(guard.estimator, standing.belief, orders, measurement, dt)
    evidence = Evidence(
        news.white, news.share, news.change, news.settled, belief.coordinates, belief.spread
    )
    memory, verdict = trust.assess(guard.limits, standing.memory, evidence, dt)
    passage = passed(guard.gate, standing.passage, belief.coordinates, verdict.value, dt)
    closed = jnp.where(passage.open, 0.0, standing.closed + dt)
    wrong = ~(verdict.fault > guard.gate.close) & (closed >= 2 * guard.gate.quarantine)
    again = (standing.passage.open & ~passage.open) | wrong
    fresh = kind.reset(guard.estimator, belief, passage.handed), trust.begin(guard.limits)
    belief, memory = jax.tree.map(
        lambda new, old: jnp.where(again, new, old), fresh, (belief, memory)
    )
    return (
        Standing(belief, memory, passage, jnp.where(again, 0.0, closed)),
        Step(evidence, verdict, passage.handed, passage.open, again),
    )


class OnlineRun(NamedTuple):
    """Histories of an estimator along a recording; time is that of the recording's rows."""

    t: np.ndarray  # s, (time,)
    estimate: dict[str, np.ndarray]  # SI, (time,)
    std: dict[str, np.ndarray]  # SI, (time,), to first order
    handed: dict[str, np.ndarray]  # what the gate passed, SI, (time,)
    nis: np.ndarray  # normalised innovation squared, (time,)
    degrees: np.ndarray  # its degrees of freedom, (time,)
    trust: np.ndarray  # 0 to 1, (time,)
    open: np.ndarray  # whether the gate is open, (time,)
    steps: Step  # everything else, leaves (time, ...)
    guard: Guarded
    standing: Standing

    def reasons(self, row: int) -> tuple[str, ...]:
        """Why trust is at the alarm level or below in a row, in words; the worst first."""
        at = jax.tree.map(lambda leaf: leaf[row], self.steps.trust)
        return trust.reasons(self.guard.limits, at)


def run_online(
    vessel: Vessel,
    recording: Trajectory,
    free: Choice,
    *,
    noise: Noise | None = None,
    drift: float | Mapping[str, float] = 0.0,
    limits: Limits | None = None,
) -> OnlineRun:
    """Extended Kalman filter with trust and gate along a recording.

    The first state is the first sample of every channel, as an instrument waits for its first
    fix. Measured actuation is used where it was measured throughout. Rows further apart than
    five usual intervals have steps without measurement in between.

    Arguments:
        noise: gust and sensor noise; by default `noise_prior`, which reads the sensor noise
            off the whole recording.
        drift, free: as of `ekf.init`.
        limits: as of `guarded`, calibrated perhaps.

    Raises:
        UserError: a recording that does not fit the vessel, or a choice that cannot be estimated.
    """
    dataset = make_dataset(vessel, [recording])
    noise = Noise.of(noise_prior(vessel, dataset).mean) if noise is None else noise
    rows = _Rows.of(vessel, recording)
    estimator, belief = ekf.init(
        vessel, free, noise, State(*rows.first), drift=drift, orders=rows.settled,
        measured=rows.measured, interval=rows.interval, t=float(rows.t[0]),
    )  # fmt: skip
    return _along(*guarded(estimator, belief, limits), rows)


def run_least_squares(
    vessel: Vessel,
    recording: Trajectory,
    free: Choice,
    *,
    limits: Limits | None = None,
    **options: float,
) -> OnlineRun:
    """Recursive least squares with trust and gate along a recording.

    Arguments:
        options: `memory`, `bandwidth`, `disturbance_memory` and `noise` of `rls.init`.

    Raises:
        UserError: as `run_online`, or no complete rows of heading and velocities.
    """
    rows = _Rows.of(vessel, recording)
    if np.isfinite(rows.measurement[:, 2:]).all(1).sum() < 10:
        raise UserError(
            f"{recording.name}: recursive least squares needs rows with heading, u, v and r "
            "together, and there are fewer than ten; use the extended Kalman filter"
        )
    vessel = ekf.with_direct(vessel, rows.measured)
    regression, running = rls.init(
        vessel, free, orders=rows.settled, interval=rows.interval, t=float(rows.t[0]), **options
    )
    return _along(*guarded(regression, running, limits), rows)


def calibrated(runs: Sequence[OnlineRun]) -> Limits:
    """Limits of the trust by which these runs, known to be sound, are sound: `trust.calibrated`.

    Raises:
        UserError: no run, or none long enough.
    """
    if not any(run.t[-1] - run.t[0] > 6 * run.guard.limits.window for run in runs):
        raise UserError("calibration needs a sound run of at least six windows of the trust")
    steps = [np.diff(run.t, prepend=run.t[0]) for run in runs]
    return trust.calibrated(runs[0].guard.limits, [run.steps.evidence for run in runs], steps)


class _Rows(NamedTuple):
    """A recording as steps: what held before each measurement, and the measurement."""

    t: np.ndarray
    dt: np.ndarray
    measurement: np.ndarray
    orders: dict[str, np.ndarray]
    kept: np.ndarray  # steps that end in a row of the recording
    first: np.ndarray
    settled: dict[str, float]
    measured: tuple[str, ...]
    interval: float

    @staticmethod
    def of(vessel: Vessel, recording: Trajectory) -> "_Rows":
        run = recording.counted()
        t, motion = run.t, np.stack([*run.motion.values()], -1)
        orders, executed = recorded_actuation(vessel, recording)
        held = {c: executed.get(c, orders[c]) for c in vessel.channels}
        interval = 5 * median_interval(t)
        parts = np.maximum(1, np.ceil(np.diff(t) / interval - 1e-9)).astype(int)
        row = np.append(0, np.repeat(np.arange(1, len(t)), parts))
        kept = np.append(0, np.cumsum(parts))
        measurement = np.full((len(row), 6), np.nan)
        measurement[kept] = motion
        before = np.maximum(row - 1, 0)
        return _Rows(
            t, np.append(0.0, np.repeat(np.diff(t) / parts, parts)), measurement,
            {c: values[before] for c, values in held.items()}, kept, _first(motion),
            {c: float(values[0]) for c, values in held.items()}, tuple(executed), interval,
        )  # fmt: skip


def _first(motion: np.ndarray) -> np.ndarray:
    """First sample of every channel; zero where there is none."""
    known = np.isfinite(motion)
    return np.where(known.any(0), motion[known.argmax(0), np.arange(6)], 0.0)


@eqx.filter_jit
def _scanned(guard: Guarded, standing: Standing, rows: tuple) -> tuple[Standing, Step]:
    return jax.lax.scan(lambda now, row: step(guard, now, *row), standing, rows)


def _along(guard: Guarded, standing: Standing, rows: _Rows) -> OnlineRun:
    inputs = jax.tree.map(jnp.asarray, (rows.orders, rows.measurement, rows.dt))
    standing, steps = _scanned(guard, standing, inputs)
    steps = jax.tree.map(lambda leaf: np.asarray(leaf)[rows.kept], steps)
    coordinates = steps.evidence.coordinates
    deviation = np.sqrt(np.diagonal(steps.evidence.covariance, axis1=1, axis2=2))
    estimate, std, handed = {}, {}, {}
    for k, p in enumerate(guard.parameters):
        estimate[p.name] = np.asarray(p.decode(coordinates[:, k]))
        slope = [p.slope(float(c)) for c in coordinates[:, k]]
        std[p.name] = np.array(slope) * deviation[:, k]
        handed[p.name] = np.asarray(p.decode(steps.handed[:, k]))
    return OnlineRun(
        rows.t, estimate, std, handed, (steps.evidence.white**2).sum(1),
        (steps.evidence.share > 0).sum(1), np.asarray(steps.trust.value), steps.open, steps, guard,
        standing,
    )  # fmt: skip
