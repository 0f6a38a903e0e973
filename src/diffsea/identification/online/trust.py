"""How far an online estimate can be trusted, from 0 to 1, and why.

Four questions, each a statistical test with the same false-alarm rate; trust is the lowest of
the four answers:

- *innovations*: are they no larger than the filter thinks, and free of bias? Sums over a fading
  window are compared with their chi-squared and normal distributions, channel by channel
  (Bar-Shalom, Li and Kirubarajan 2001, section 5.4).
- *excitation*: have the data said anything? The mean share of the prior's variance that they
  took away (degrees of freedom for signal: Rodgers 2000, section 2.4) answers; and no parameter
  may be known less than beforehand.
- *bounds*: is the estimate possible (positive mass, no energy from drag) and within the prior?
- *steadiness*: has it moved by more than the information that came in? The corrections of a
  sound filter are uncorrelated, each with the variance that it took away (Kailath 1968), so
  that their sum over the window has a known distribution.

An answer of 1 stands for what is seen in 95 of 100 windows of a sound filter, 0.5 for the alarm
level, which a sound filter reaches once in `false_alarm_interval`, 0 for as far again. For
excitation 0.5 means that half of the variance is gone, 1 three quarters.
"""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from diffsea.parameters import Parameter, replace
from diffsea.scales import positive_inertia, time_scale
from diffsea.types import Environment, Scalar, State
from diffsea.vessel.base import Force, Vessel


ALARM = 0.5  # trust at the alarm level
_ROOT = np.sqrt(2 * np.pi)
_USUAL = 0.05  # share of a sound filter's windows beyond which trust falls below one


class Evidence(eqx.Module):
    """What one step of an estimator says about itself. EKF and RLS both give it."""

    white: Float[Array, "channel"]  # whitened innovations, zero where missing
    share: Float[Array, "channel"]  # independent samples that the row counts for, 0 to 1
    change: Float[Array, "parameter"]  # of the coordinates by the data
    settled: Float[Array, "parameter"]  # variance of the coordinates that the data took away
    coordinates: Float[Array, "parameter"]
    covariance: Float[Array, "parameter parameter"]


class Limits(eqx.Module):
    """What is compared with what."""

    vessel: Vessel  # at its prior
    spread: Float[Array, "parameter"]  # prior standard deviations
    window: Scalar  # s, time constant with which the past fades
    false_alarm_interval: Scalar  # s
    scale: Float[Array, "channel"]  # of the innovations of sound runs, one in theory
    width: "Scores"  # spread of the scores of sound runs, one in theory
    motions: Float[Array, "motion 3"]  # (u, v, r) at which drag must brake
    parameters: tuple[Parameter, ...] = eqx.field(static=True)
    channels: tuple[str, ...] = eqx.field(static=True)

    def level(self, tests: int) -> tuple[Scalar, Scalar]:
        """Scores of the usual and of the alarm level for the largest of so many two-sided tests.

        A fading sum of white noise is a Gauss-Markov process with the window as time constant,
        which leaves +-z every T / (2 z phi(z)) seconds (Leadbetter, Lindgren and Rootzen 1983,
        section 12.2).
        """
        rate = self.window / (2 * tests * self.false_alarm_interval)
        alarm = jnp.sqrt(-2 * jnp.log(rate))
        for _ in range(8):  # z phi(z) = rate, a contraction for z above one
            alarm = jnp.sqrt(2 * jnp.log(alarm / (rate * _ROOT)))
        return jax.scipy.stats.norm.isf(_USUAL / (2 * tests)), alarm


class Scores(eqx.Module):
    """Test statistics, standard normal for a sound filter."""

    size: Float[Array, "channel"]  # of the innovations: positive where they are too large
    bias: Float[Array, "channel"]
    moved: Float[Array, "parameter"]


class Memory(eqx.Module):
    """Fading sums over the past."""

    count: Float[Array, "channel"]  # of weights
    squares: Float[Array, "channel"]  # of squared weights
    white: Float[Array, "channel"]
    white_squared: Float[Array, "channel"]
    change: Float[Array, "parameter"]
    settled: Float[Array, "parameter"]  # with squared weights


class Trust(eqx.Module):
    """The verdict of one instant, with what it rests on."""

    innovations: Scalar
    excitation: Scalar
    bounds: Scalar
    steadiness: Scalar
    scores: Scores
    determined: Scalar  # share of the prior's variance that the data took, mean over directions
    least: Float[Array, "parameter"]  # variance over the prior's
    far: Float[Array, "parameter"]  # coordinate over the prior's standard deviation
    inertia: Bool[Array, ""]  # mass matrix positive definite
    drag: Bool[Array, ""]  # drag brakes

    @property
    def fault(self) -> Scalar:
        """The lowest of the answers that tell of a fault, 0 to 1: all but excitation."""
        return jnp.minimum(jnp.minimum(self.innovations, self.bounds), self.steadiness)

    @property
    def value(self) -> Scalar:
        """Trust, 0 to 1: the lowest of the four answers."""
        return jnp.minimum(self.fault, self.excitation)


def limits(
    vessel: Vessel,
    parameters: Sequence[Parameter],
    channels: Sequence[str],
    window: float = 15.0,
    false_alarm_interval: float = 7200.0,
) -> Limits:
    """Limits for an estimator of these parameters.

    Arguments:
        vessel: at its prior mean.
        channels: names of the innovations, for the reasons in words.
        window: s over which innovations are looked at together: shorter finds a fault sooner,
            longer a smaller one.
        false_alarm_interval: mean time between false alarms of each of the tests, s.
    """
    spread = jnp.array([parameter.spread for parameter in parameters])
    width = Scores(jnp.ones(len(channels)), jnp.ones(len(channels)), jnp.ones(len(parameters)))
    return Limits(
        vessel, spread, jnp.asarray(float(window)), jnp.asarray(float(false_alarm_interval)),
        jnp.ones(len(channels)), width,
        _braked(vessel), tuple(parameters), tuple(channels),
    )  # fmt: skip


def begin(limits: Limits) -> Memory:
    """Nothing remembered."""
    channel, parameter = jnp.zeros(len(limits.channels)), jnp.zeros(len(limits.parameters))
    return Memory(channel, channel, channel, channel, parameter, parameter)


def assess(limits: Limits, memory: Memory, evidence: Evidence, dt: Scalar) -> tuple[Memory, Trust]:
    """The trust after one more step of `dt` s. Pure, for `jit` and `lax.scan`."""
    keep = jnp.exp(-dt / limits.window)
    share, white = evidence.share, evidence.white / limits.scale
    memory = Memory(
        keep * memory.count + share,
        keep**2 * memory.squares + share,
        keep * memory.white + share * white,
        keep * memory.white_squared + share * white**2,
        keep * memory.change + evidence.change,
        keep**2 * memory.settled + evidence.settled,
    )
    raw = scores(memory)
    found = jax.tree.map(lambda score, width: score / width, raw, limits.width)
    far = evidence.coordinates / limits.spread
    least = jnp.diag(evidence.covariance) / limits.spread**2
    determined = 1 - jnp.mean(least)
    # Alarm levels: half of the prior's variance left, or twice of it in one parameter.
    known = jnp.clip(2 * determined - ALARM, 0.0, 1 / jnp.maximum(jnp.max(least), 1.0))
    vessel = replace(
        limits.vessel,
        {p.name: p.decode(evidence.coordinates[k]) for k, p in enumerate(limits.parameters)},
    )
    inertia, drag = positive_inertia(vessel.mass_matrix()), _brakes(vessel, limits.motions)
    within = _answer(limits, far)
    # Innovations that are too small make an estimate slow, not wrong.
    both = jnp.concatenate([jnp.maximum(found.size, 0.0), found.bias])
    return memory, Trust(
        innovations=_answer(limits, both),
        excitation=known,
        bounds=jnp.where(inertia & drag, within, 0.0),
        steadiness=_answer(limits, found.moved),
        scores=found,
        determined=determined,
        least=least,
        far=far,
        inertia=inertia,
        drag=drag,
    )


def scores(memory: Memory) -> Scores:
    """Test statistics of fading sums.

    A sum of squares with fading weights w has mean A = sum w and variance 2 sum w^2 = 2 B: as
    A^2 / B degrees of freedom of chi-squared (Satterthwaite 1946), whose cube root is very
    nearly normal (Wilson and Hilferty 1931).
    """
    some = memory.squares > 0
    A, B = (jnp.where(some, part, 1.0) for part in (memory.count, memory.squares))
    scatter = 2 * B / (9 * A**2)
    size = (jnp.cbrt(memory.white_squared / A) - (1 - scatter)) / jnp.sqrt(scatter)
    moved = memory.change / jnp.sqrt(jnp.where(memory.settled > 0, memory.settled, 1.0))
    return Scores(
        jnp.where(some, size, 0.0),
        jnp.where(some, memory.white / jnp.sqrt(B), 0.0),
        jnp.where(memory.settled > 0, moved, 0.0),
    )


def calibrated(
    limits: Limits, sound: Sequence[Evidence], dt: Sequence[Array], settling: float = 3.0
) -> Limits:
    """Limits by which sound runs have innovations and scores of unit size.

    For a filter whose noise is a guess, and for residuals that are not white. Neither is made
    smaller than in theory, which would only find fault with a filter that is too careful.

    Arguments:
        sound: evidence along each of several runs known to be sound, leaves (time, ...).
        dt: the steps of each run, s, (time,).
        settling: how many windows at the start of each run are left out.
    """
    late = [np.cumsum(np.asarray(steps)) > settling * float(limits.window) for steps in dt]
    white = [np.where(e.share > 0, e.white, np.nan)[k] for e, k in zip(sound, late, strict=True)]
    scale = np.maximum(1.0, np.sqrt(np.nanmean(np.concatenate(white) ** 2, axis=0)))
    ones = jax.tree.map(jnp.ones_like, limits.width)
    limits = eqx.tree_at(lambda at: (at.scale, at.width), limits, (jnp.asarray(scale), ones))

    @jax.jit
    def along(evidence: Evidence, dt: Array) -> Scores:
        def body(memory: Memory, row: tuple) -> tuple[Memory, Scores]:
            memory, verdict = assess(limits, memory, *row)
            return memory, verdict.scores

        return jax.lax.scan(body, begin(limits), (evidence, dt))[1]

    found = [jax.tree.map(lambda leaf, k=k: np.asarray(leaf)[k], along(e, jnp.asarray(steps)))
             for e, steps, k in zip(sound, dt, late, strict=True)]  # fmt: skip
    together = jax.tree.map(lambda *leaves: np.concatenate(leaves), *found)
    width = jax.tree.map(
        lambda leaf: jnp.asarray(np.maximum(1.0, np.sqrt(np.mean(leaf**2, axis=0)))), together
    )
    # Only the upper side of the size counts.
    upper = np.sqrt(np.mean(np.maximum(together.size, 0.0) ** 2, axis=0) * 2)
    width = eqx.tree_at(lambda w: w.size, width, jnp.asarray(np.maximum(1.0, upper)))
    return eqx.tree_at(lambda at: at.width, limits, width)


def reasons(limits: Limits, trust: Trust) -> tuple[str, ...]:
    """What lowers the trust to the alarm level or below, in words; the worst first."""
    found = [
        (float(trust.innovations), _of_innovations(limits, trust)),
        (float(trust.excitation), _of_excitation(limits, trust)),
        (float(trust.bounds), _of_bounds(limits, trust)),
        (float(trust.steadiness), _of_steadiness(limits, trust)),
    ]
    return tuple(text for answer, text in sorted(found) if not answer > ALARM)


def _answer(limits: Limits, scores: Float[Array, "test"]) -> Scalar:
    """From the largest score to [0, 1]; a score that is not finite is no trust."""
    usual, alarm = limits.level(scores.size)
    largest = jnp.max(jnp.abs(scores))
    trust = jnp.clip(1 - (1 - ALARM) * (largest - usual) / (alarm - usual), 0.0, 1.0)
    return jnp.where(jnp.isfinite(largest), trust, 0.0)


def _power(vessel: Vessel, motion: Float[Array, "3"]) -> Scalar:
    """Power (W) that the hull's resistance puts into a motion (u, v, r) through still water.

    Other forces, an estimated disturbance say, may drive.
    """
    u, v, r = motion
    zero = jnp.zeros(())
    state = State(zero, zero, zero, u, v, r)
    resisting = (force for force in vessel.forces.values() if force.resists)
    drag = sum((force(state, Environment(), zero) for force in resisting), Force())
    return drag.X * u + drag.Y * v + drag.N * r


def _brakes(vessel: Vessel, motions: Float[Array, "motion 3"]) -> Bool[Array, ""]:
    return jnp.all(jax.vmap(lambda motion: _power(vessel, motion))(motions) < 0)


def _braked(vessel: Vessel) -> Float[np.ndarray, "motion 3"]:
    """Motions at which the vessel's own drag brakes.

    Derivative sets that hold inertial terms as well (Abkowitz) put power into some motions at
    no fault of theirs; nothing is asked of an estimate there.
    """
    length = float(vessel.rigid_body.length)
    speed = 0.3 * length / time_scale(float(vessel.rigid_body.length))
    ends = np.array([-1.0, -0.3, 0.0, 0.3, 1.0])
    grid = np.stack(np.meshgrid(ends, ends, ends), -1).reshape(-1, 3)
    grid = grid[np.abs(grid).sum(1) > 0] * np.array([speed, 0.3 * speed, speed / length])
    power = np.asarray(jax.vmap(lambda motion: _power(vessel, motion))(jnp.asarray(grid)))
    return grid[power < 0]


def _of_innovations(limits: Limits, trust: Trust) -> str:
    size, bias = np.asarray(trust.scores.size), np.asarray(trust.scores.bias)
    both = np.concatenate([np.maximum(size, 0.0), np.abs(bias)])
    k = int(np.argmax(np.where(np.isfinite(both), both, np.inf)))
    channel = limits.channels[k % size.size]
    fault = "is biased" if k >= size.size else "scatters too much"
    alarm = float(limits.level(both.size)[1])
    return (
        f"the innovation of {channel} {fault}: {both[k]:.1f} standard deviations from a sound "
        f"filter's, alarm at {alarm:.1f}; a sensor or the model is not what the filter assumes"
    )


def _of_excitation(limits: Limits, trust: Trust) -> str:
    least = np.asarray(trust.least)
    k = int(np.argmax(least))
    name = limits.parameters[k].name
    if least[k] > 1:
        return f"{name} is known less than beforehand: {least[k]:.1f} times the prior's variance"
    return (
        f"the data have removed {100 * float(trust.determined):.0f} % of the prior's "
        f"variance, less than half; {name} is known least: manoeuvre more"
    )


def _of_bounds(limits: Limits, trust: Trust) -> str:
    if not bool(trust.inertia):
        return "the estimated mass matrix is not positive definite"
    if not bool(trust.drag):
        return "the estimated drag would put energy into the motion"
    far = np.abs(np.asarray(trust.far))
    k = int(np.argmax(far))
    return (
        f"{limits.parameters[k].name} is {far[k]:.1f} standard deviations of its prior away "
        f"from {limits.parameters[k].value:.4g}"
    )


def _of_steadiness(limits: Limits, trust: Trust) -> str:
    moved = np.abs(np.asarray(trust.scores.moved))
    k = int(np.argmax(moved))
    return (
        f"{limits.parameters[k].name} has moved by {moved[k]:.1f} times the standard deviation "
        "that the data account for"
    )
