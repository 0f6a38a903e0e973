"""An online estimator with its trust and its gate, step by step or along a recording.

A fault is found some time after it began, and by then the estimate has followed it. So an estimate
waits for `quarantine` seconds, and only if trust never fell to the alarm level in between is it
handed on. At an alarm the gate closes: what waits is thrown away and the controller keeps what it
has (the prior mean at first). The gate opens again after trust has been above a higher level for
as long (hysteresis in level and time).

An estimator that followed a fault is sure of what is wrong. So it starts again, from what the
controller has and with the prior's uncertainty, when the gate closes, and every two windows after
that while its trust is at the alarm level: so it also follows a sudden change of the vessel.
"""

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from diffsea.errors import UserError
from diffsea.identification.data.dataset import make_dataset
from diffsea.identification.filter.covariance import Noise
from diffsea.identification.filter.noise_fit import noise_prior
from diffsea.identification.online import trust
from diffsea.identification.online.ekf import kalman_filter
from diffsea.identification.online.estimator import (
    AbstractBelief,
    AbstractEstimator,
    Measurement,
    Orders,
    ParameterChoice,
    decode_parameters,
)
from diffsea.identification.online.rls import recursive_least_squares
from diffsea.identification.online.trust import FadingSums, StepEvidence, Trust, TrustLimits
from diffsea.series import median_interval
from diffsea.simulation.actuation import recorded_actuation, true_actuation
from diffsea.trajectory import Trajectory
from diffsea.types import Scalar, State
from diffsea.vessel.base import Vessel


_WAITING_SLOTS = 8  # estimates that wait: one passes at most an eighth of a quarantine late


class GateState(eqx.Module):
    """What has passed the gate by one instant."""

    handed: Float[Array, "parameter"]  # coordinates for the controller
    open: Bool[Array, ""]
    good: Scalar  # s for which trust has been above the level that opens
    clock: Scalar  # s since the last estimate began to wait
    waiting: Float[Array, "slot parameter"]  # the oldest first
    filled: Scalar  # how many of them are estimates


class Gate(eqx.Module):
    """How long an estimate waits, and which trust opens; the alarm level closes."""

    quarantine: Scalar  # s
    reopen: Scalar = 0.75  # half way between the alarm and the usual level

    def init(self, parameters: int) -> GateState:
        """A closed gate that has handed on the prior mean, coordinates of zero."""
        zero, slots = jnp.zeros(()), jnp.zeros((_WAITING_SLOTS, parameters))
        return GateState(jnp.zeros(parameters), jnp.asarray(False), zero, zero, slots, zero)

    def step(
        self, state: GateState, estimate: Float[Array, "parameter"], value: Scalar, dt: Scalar
    ) -> GateState:
        """What has passed after one more step of `dt` s at a trust of `value`. Pure."""
        good = jnp.where(value >= self.reopen, state.good + dt, 0.0)
        # A trust that is not a number fails both comparisons.
        sound = value > trust.ALARM_TRUST
        opened = jnp.where(state.open, sound, good >= self.quarantine)
        waits = sound & (state.open | (good > 0))
        clock = jnp.where(waits, state.clock + dt, 0.0)
        due = waits & ((clock >= self.quarantine / _WAITING_SLOTS) | (state.filled == 0))
        ripe = due & (state.filled >= _WAITING_SLOTS) & opened
        shifted = jnp.concatenate([state.waiting[1:], estimate[None]])
        filled = jnp.minimum(state.filled + due.astype(float), _WAITING_SLOTS)
        return GateState(
            handed=jnp.where(ripe, state.waiting[0], state.handed),
            open=opened,
            good=good,
            clock=jnp.where(due, 0.0, clock),
            waiting=jnp.where(due, shifted, state.waiting),
            filled=jnp.where(waits, filled, 0.0),
        )


class GuardedState(eqx.Module):
    """Everything that a step carries on."""

    belief: AbstractBelief
    sums: FadingSums
    gate: GateState
    closed: Scalar  # s since the estimator last started, while the gate is closed


class GuardedStep(eqx.Module):
    """What one step of a guarded estimator reports."""

    evidence: StepEvidence
    trust: Trust
    handed: Float[Array, "parameter"]  # coordinates for the controller
    open: Bool[Array, ""]
    restarted: Bool[Array, ""]  # the estimator started again after this step


class GuardedEstimator(eqx.Module):
    """An estimator, what its trust is measured by, and the gate."""

    estimator: AbstractEstimator
    limits: TrustLimits
    gate: Gate

    def decode(self, coordinates: Float[Array, "parameter"]) -> dict[str, Scalar]:
        """Parameters in SI units at some coordinates."""
        return decode_parameters(self.estimator.parameters, coordinates)

    def init(self, belief: AbstractBelief) -> GuardedState:
        """The state before the first measurement, the gate closed."""
        sums, gate = self.limits.init(), self.gate.init(len(self.estimator.parameters))
        return GuardedState(belief, sums, gate, jnp.zeros(()))

    def step(
        self, state: GuardedState, orders: Orders, measurement: Measurement, dt: Scalar
    ) -> tuple[GuardedState, GuardedStep]:
        """One step of estimator, trust and gate; arguments as of the estimator's. Pure."""
        belief, news = self.estimator.step(state.belief, orders, measurement, dt)
        estimate, covariance = belief.coordinates, belief.parameter_covariance
        evidence = StepEvidence(
            news.white, news.share, news.change, news.settled, estimate, covariance
        )
        sums, verdict = trust.assess(self.limits, state.sums, evidence, dt)
        gate = self.gate.step(state.gate, estimate, verdict.value, dt)
        closed = jnp.where(gate.open, 0.0, state.closed + dt)
        wrong = ~(verdict.fault > trust.ALARM_TRUST) & (closed >= 2 * self.gate.quarantine)
        again = (state.gate.open & ~gate.open) | wrong
        fresh = self.estimator.reset(belief, gate.handed), self.limits.init()
        belief, sums = jax.tree.map(
            lambda new, old: jnp.where(again, new, old), fresh, (belief, sums)
        )
        return (
            GuardedState(belief, sums, gate, jnp.where(again, 0.0, closed)),
            GuardedStep(evidence, verdict, gate.handed, gate.open, again),
        )


def guard_estimator(
    estimator: AbstractEstimator, limits: TrustLimits | None = None
) -> GuardedEstimator:
    """An estimator behind a gate whose quarantine is the trust's window.

    Arguments:
        limits: of the trust; by default those of `trust.trust_limits` for this estimator.
    """
    if limits is None:
        limits = trust.trust_limits(estimator.vessel, estimator.parameters, estimator.channels)
    return GuardedEstimator(estimator, limits, Gate(limits.window))


class OnlineRun(NamedTuple):
    """Histories of an estimator along a recording; time is that of the recording's rows."""

    t: Float[np.ndarray, "time"]  # s
    estimate: dict[str, Float[np.ndarray, "time"]]  # SI
    std: dict[str, Float[np.ndarray, "time"]]  # SI, to first order
    handed: dict[str, Float[np.ndarray, "time"]]  # what the gate passed, SI
    nis: Float[np.ndarray, "time"]  # normalised innovation squared
    degrees: Int[np.ndarray, "time"]  # its degrees of freedom
    trust: Float[np.ndarray, "time"]  # 0 to 1
    open: Bool[np.ndarray, "time"]  # whether the gate is open
    steps: GuardedStep  # everything else, leaves (time, ...)
    guard: GuardedEstimator

    def reasons(self, row: int) -> tuple[str, ...]:
        """Why trust is at the alarm level or below in a row, in words; the worst first."""
        at = jax.tree.map(lambda leaf: leaf[row], self.steps.trust)
        return trust.reasons(self.guard.limits, at)


def run_online(
    vessel: Vessel,
    recording: Trajectory,
    free: ParameterChoice,
    *,
    noise: Noise | None = None,
    drift: float | Mapping[str, float] = 0.0,
    limits: TrustLimits | None = None,
) -> OnlineRun:
    """Extended Kalman filter with trust and gate along a recording.

    The first state is the first sample of every channel, as an instrument waits for its first
    fix. Measured actuation is used where it was measured throughout. Rows further apart than
    five usual intervals have steps without measurement in between.

    Arguments:
        noise: gust and sensor noise; by default `noise_prior`, which reads the sensor noise
            off the whole recording.
        drift, free: as of `kalman_filter`.
        limits: as of `guard_estimator`, calibrated perhaps.

    Raises:
        UserError: a recording that does not fit the vessel, or a choice that cannot be estimated.
    """
    dataset = make_dataset(vessel, [recording])
    noise = Noise.of(noise_prior(vessel, dataset).mean) if noise is None else noise
    make = functools.partial(kalman_filter, vessel, free, noise, drift=drift)
    return _run_along(vessel, recording, make, limits)


def run_least_squares(
    vessel: Vessel,
    recording: Trajectory,
    free: ParameterChoice,
    *,
    limits: TrustLimits | None = None,
    **options: Any,
) -> OnlineRun:
    """Recursive least squares with trust and gate along a recording.

    Arguments:
        options: `memory`, `bandwidth`, `disturbance_memory` and `noise` of
            `recursive_least_squares`.

    Raises:
        UserError: as `run_online`, or no complete rows of heading and velocities.
    """
    motion = recording.counted().motion
    if np.isfinite([motion[c] for c in ("psi", "u", "v", "r")]).all(0).sum() < 10:
        raise UserError(
            f"{recording.name}: recursive least squares needs rows with heading, u, v and r "
            "together, and there are fewer than ten; use the extended Kalman filter"
        )
    make = functools.partial(recursive_least_squares, vessel, free, **options)
    return _run_along(vessel, recording, make, limits)


def calibrate_limits(runs: Sequence[OnlineRun]) -> TrustLimits:
    """Limits of the trust by which these runs, known to be sound, are sound: `trust.calibrate`.

    Raises:
        UserError: no run, or none long enough.
    """
    if not any(run.t[-1] - run.t[0] > 6 * run.guard.limits.window for run in runs):
        raise UserError("calibration needs a sound run of at least six windows of the trust")
    steps = [np.diff(run.t, prepend=run.t[0]) for run in runs]
    return trust.calibrate(runs[0].guard.limits, [run.steps.evidence for run in runs], steps)


@eqx.filter_jit
def _scan(guard: GuardedEstimator, state: GuardedState, rows: tuple) -> GuardedStep:
    return jax.lax.scan(lambda now, row: guard.step(now, *row), state, rows)[1]


def _run_along(
    vessel: Vessel,
    recording: Trajectory,
    make_estimator: Callable[..., AbstractEstimator],
    limits: TrustLimits | None,
) -> OnlineRun:
    """A recording as steps, each of what held before a measurement and the measurement."""
    run = recording.counted()
    t, motion = run.t, np.stack([*run.motion.values()], -1)
    orders, executed = recorded_actuation(vessel, recording)
    right = {
        c: np.asarray(true_actuation(vessel, c, jnp.asarray(t), jnp.asarray(done)))
        for c, done in executed.items()
    }
    actuation = {c: right.get(c, orders[c]) for c in vessel.channels}
    interval = 5 * median_interval(t)
    estimator = make_estimator(measured=tuple(executed), interval=interval)
    guard = guard_estimator(estimator, limits)

    parts = np.maximum(1, np.ceil(np.diff(t) / interval - 1e-9)).astype(int)
    row = np.append(0, np.repeat(np.arange(1, len(t)), parts))
    kept = np.append(0, np.cumsum(parts))  # steps that end in a row of the recording
    measurement = np.full((len(row), 6), np.nan)
    measurement[kept] = motion
    held = {c: values[np.maximum(row - 1, 0)] for c, values in actuation.items()}
    dt = np.append(0.0, np.repeat(np.diff(t) / parts, parts))
    known = np.isfinite(motion)
    first = np.where(known.any(0), motion[known.argmax(0), np.arange(6)], 0.0)
    settled = {c: float(values[0]) for c, values in actuation.items()}
    belief = estimator.init(State(*first), orders=settled, t=float(t[0]))
    rows = jax.tree.map(jnp.asarray, (held, measurement, dt))
    steps = _scan(guard, guard.init(belief), rows)

    return online_run(run.t, jax.tree.map(lambda leaf: np.asarray(leaf)[kept], steps), guard)


def online_run(
    t: Float[np.ndarray, "time"], steps: GuardedStep, guard: GuardedEstimator
) -> OnlineRun:
    """The histories of what a guarded estimator reported step by step, at `t` s."""
    coordinates = steps.evidence.coordinates
    deviation = np.sqrt(np.diagonal(steps.evidence.covariance, axis1=1, axis2=2))
    estimate, std, handed = {}, {}, {}
    for k, p in enumerate(guard.estimator.parameters):
        estimate[p.name] = np.asarray(p.decode(coordinates[:, k]))
        slope = [p.slope(float(c)) for c in coordinates[:, k]]
        std[p.name] = np.array(slope) * deviation[:, k]
        handed[p.name] = np.asarray(p.decode(steps.handed[:, k]))
    return OnlineRun(
        t=t,
        estimate=estimate,
        std=std,
        handed=handed,
        nis=np.asarray(steps.evidence.white**2).sum(1),
        degrees=(np.asarray(steps.evidence.share) > 0).sum(1),
        trust=np.asarray(steps.trust.value),
        open=np.asarray(steps.open),
        steps=steps,
        guard=guard,
    )
