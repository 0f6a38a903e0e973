"""How far an online estimate can be trusted, from 0 to 1, and why.

Four questions, each a statistical test with the same false-alarm rate; trust is the lowest of
the four answers:

- *innovations*: no larger than the filter thinks, and free of bias? Sums over a fading window
  against their chi-squared and normal distributions, channel by channel (Bar-Shalom, Li and
  Kirubarajan 2001, section 5.4).
- *excitation*: which mean share of the prior's variance did the data take away (degrees of freedom
  for signal: Rodgers 2000, section 2.4)? No parameter may be known less than beforehand.
- *bounds*: is the estimate possible (positive mass, no energy from drag) and within the prior?
- *steadiness*: has it moved by more than the information that came in? The corrections of a sound
  filter are uncorrelated, each with the variance that it took away (Kailath 1968).

An answer of 1 stands for what is seen in 95 of 100 windows of a sound filter, 0.5 for the alarm
level, which a sound filter reaches once in `false_alarm_interval`, 0 for as far again. For
excitation 0.5 means that half of the variance is gone, 1 three quarters.
"""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from diffsea.identification.online.estimator import Innovation, decode_parameters, prior_std
from diffsea.parameters import Parameter, replace
from diffsea.scales import positive_inertia, time_scale
from diffsea.trajectory import in_words
from diffsea.types import Environment, Scalar, State
from diffsea.vessel.base import Vessel
from diffsea.vessel.forces import Force


ALARM_TRUST = 0.5  # trust at the alarm level
_SQRT_TWO_PI = np.sqrt(2 * np.pi)
_USUAL_TAIL = 0.05  # share of a sound filter's windows beyond which trust falls below one
_SETTLING = 3.0  # windows at the start of a run until the sums are those of any other time


class StepEvidence(Innovation):
    """What one step of any estimator says about itself: its innovation, and the belief after it."""

    coordinates: Float[Array, "parameter"]
    covariance: Float[Array, "parameter parameter"]


class TrustScores(eqx.Module):
    """Test statistics, standard normal for a sound filter."""

    size: Float[Array, "channel"]  # of the innovations: positive where they are too large
    bias: Float[Array, "channel"]
    moved: Float[Array, "parameter"]


class FadingSums(eqx.Module):
    """Fading sums over the past."""

    count: Float[Array, "channel"]  # of weights
    squares: Float[Array, "channel"]  # of squared weights
    white: Float[Array, "channel"]
    white_squared: Float[Array, "channel"]
    change: Float[Array, "parameter"]
    settled: Float[Array, "parameter"]  # with squared weights


class TrustLimits(eqx.Module):
    """What is compared with what."""

    vessel: Vessel  # at its prior
    spread: Float[Array, "parameter"]  # prior standard deviations
    window: Scalar  # s, time constant with which the past fades
    false_alarm_interval: Scalar  # s
    scale: Float[Array, "channel"]  # of the innovations of sound runs, one in theory
    width: TrustScores  # spread of the scores of sound runs, one in theory
    motions: Float[Array | np.ndarray, "motion 3"]  # (u, v, r) at which drag must brake
    parameters: tuple[Parameter, ...] = eqx.field(static=True)
    channels: tuple[str, ...] = eqx.field(static=True)

    def init(self) -> FadingSums:
        """Nothing remembered."""
        channel, parameter = jnp.zeros(len(self.channels)), jnp.zeros(len(self.parameters))
        return FadingSums(channel, channel, channel, channel, parameter, parameter)

    def level(self, tests: int) -> tuple[Scalar, Scalar]:
        """Usual score and alarm level of the largest of so many two-sided tests.

        A fading sum of white noise is a Gauss-Markov process with the window as time constant,
        which leaves +-z every T / (2 z phi(z)) seconds (Leadbetter, Lindgren and Rootzen 1983,
        section 12.2).
        """
        rate = self.window / (2 * tests * self.false_alarm_interval)
        alarm = jnp.sqrt(-2 * jnp.log(rate))
        for _ in range(8):  # z phi(z) = rate, a contraction for z above one
            alarm = jnp.sqrt(2 * jnp.log(alarm / (rate * _SQRT_TWO_PI)))
        return jax.scipy.stats.norm.isf(_USUAL_TAIL / (2 * tests)), alarm


class Trust(eqx.Module):
    """The verdict of one instant, with what it rests on."""

    innovations: Scalar
    excitation: Scalar
    bounds: Scalar
    steadiness: Scalar
    scores: TrustScores
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


def trust_limits(
    vessel: Vessel,
    parameters: Sequence[Parameter],
    channels: Sequence[str],
    window: float = 15.0,
    false_alarm_interval: float = 7200.0,
) -> TrustLimits:
    """Limits for an estimator of these parameters.

    Arguments:
        vessel: at its prior mean.
        channels: names of the innovations, for the reasons in words.
        window: s over which innovations are looked at together: shorter finds a fault sooner,
            longer a smaller one.
        false_alarm_interval: mean time between false alarms of each of the tests, s.
    """
    length = float(vessel.rigid_body.length)
    speed = 0.3 * length / time_scale(length)
    ends = np.array([-1.0, -0.3, 0.0, 0.3, 1.0])
    grid = np.stack(np.meshgrid(ends, ends, ends), -1).reshape(-1, 3)
    grid = grid[np.abs(grid).sum(1) > 0] * np.array([speed, 0.3 * speed, speed / length])
    # Derivative sets that hold inertial terms as well (Abkowitz) put power into some motions at
    # no fault of theirs; nothing is asked of an estimate there.
    braked = np.asarray(_resistance_power(vessel, jnp.asarray(grid))) < 0
    one = jnp.ones(len(channels))
    return TrustLimits(
        vessel=vessel,
        spread=jnp.asarray(prior_std(parameters)),
        window=jnp.asarray(float(window)),
        false_alarm_interval=jnp.asarray(float(false_alarm_interval)),
        scale=one,
        width=TrustScores(one, one, jnp.ones(len(parameters))),
        motions=grid[braked],
        parameters=tuple(parameters),
        channels=tuple(channels),
    )


def assess(
    limits: TrustLimits, sums: FadingSums, evidence: StepEvidence, dt: Scalar
) -> tuple[FadingSums, Trust]:
    """The trust after one more step of `dt` s. Pure, for `jit` and `lax.scan`."""
    keep = jnp.exp(-dt / limits.window)
    share, white = evidence.share, evidence.white / limits.scale
    sums = FadingSums(
        keep * sums.count + share,
        keep**2 * sums.squares + share,
        keep * sums.white + share * white,
        keep * sums.white_squared + share * white**2,
        keep * sums.change + evidence.change,
        keep**2 * sums.settled + evidence.settled,
    )
    found = jax.tree.map(lambda score, width: score / width, scores_of_sums(sums), limits.width)
    far = evidence.coordinates / limits.spread
    least = jnp.diag(evidence.covariance) / limits.spread**2
    determined = 1 - jnp.mean(least)
    # Alarm levels: half of the prior's variance left, or twice of it in one parameter.
    known = jnp.clip(2 * determined - ALARM_TRUST, 0.0, 1 / jnp.maximum(jnp.max(least), 1.0))
    values = decode_parameters(limits.parameters, evidence.coordinates)
    vessel = replace(limits.vessel, values)
    inertia = positive_inertia(vessel.mass_matrix())
    drag = jnp.all(_resistance_power(vessel, limits.motions) < 0)
    within = _trust_of_scores(limits, far)
    # Innovations that are too small make an estimate slow, not wrong.
    both = jnp.concatenate([jnp.maximum(found.size, 0.0), found.bias])
    return sums, Trust(
        innovations=_trust_of_scores(limits, both),
        excitation=known,
        bounds=jnp.where(inertia & drag, within, 0.0),
        steadiness=_trust_of_scores(limits, found.moved),
        scores=found,
        determined=determined,
        least=least,
        far=far,
        inertia=inertia,
        drag=drag,
    )


def scores_of_sums(sums: FadingSums) -> TrustScores:
    """Test statistics of fading sums.

    A sum of squares with fading weights w has mean A = sum w and variance 2 sum w^2 = 2 B: as
    A^2 / B degrees of freedom of chi-squared (Satterthwaite 1946), whose cube root is very
    nearly normal (Wilson and Hilferty 1931).
    """
    some = sums.squares > 0
    A, B = (jnp.where(some, part, 1.0) for part in (sums.count, sums.squares))
    scatter = 2 * B / (9 * A**2)
    size = (jnp.cbrt(sums.white_squared / A) - (1 - scatter)) / jnp.sqrt(scatter)
    moved = sums.change / jnp.sqrt(jnp.where(sums.settled > 0, sums.settled, 1.0))
    return TrustScores(
        jnp.where(some, size, 0.0),
        jnp.where(some, sums.white / jnp.sqrt(B), 0.0),
        jnp.where(sums.settled > 0, moved, 0.0),
    )


def calibrate(
    limits: TrustLimits, sound: Sequence[StepEvidence], dt: Sequence[Float[np.ndarray, "time"]]
) -> TrustLimits:
    """Limits by which sound runs have innovations and scores of unit size.

    For a filter whose noise is a guess, and for residuals that are not white. Neither is made
    smaller than in theory, which would only find fault with a filter that is too careful.

    Arguments:
        sound: evidence along each of several runs known to be sound, leaves (time, ...).
        dt: the steps of each run, s, (time,).
    """
    late = [np.cumsum(np.asarray(steps)) > _SETTLING * float(limits.window) for steps in dt]
    white = [np.where(e.share > 0, e.white, np.nan)[k] for e, k in zip(sound, late, strict=True)]
    scale = np.maximum(1.0, np.sqrt(np.nanmean(np.concatenate(white) ** 2, axis=0)))
    ones = jax.tree.map(jnp.ones_like, limits.width)
    limits = dataclasses.replace(limits, scale=jnp.asarray(scale), width=ones)

    @jax.jit
    def scores_along(evidence: StepEvidence, dt: Array) -> TrustScores:
        def body(sums: FadingSums, row: tuple) -> tuple[FadingSums, TrustScores]:
            sums, verdict = assess(limits, sums, *row)
            return sums, verdict.scores

        return jax.lax.scan(body, limits.init(), (evidence, dt))[1]

    def spread(scores: Float[np.ndarray, "time test"], sides: int = 1) -> Float[Array, "test"]:
        return jnp.asarray(np.maximum(1.0, np.sqrt(np.mean(scores**2, axis=0) * sides)))

    found = []
    for evidence, steps, rows in zip(sound, dt, late, strict=True):
        scores = scores_along(evidence, jnp.asarray(steps))
        found.append(jax.tree.map(lambda leaf, rows=rows: np.asarray(leaf)[rows], scores))
    together = jax.tree.map(lambda *leaves: np.concatenate(leaves), *found)
    # Only the upper side of the size counts.
    size = spread(np.maximum(together.size, 0.0), sides=2)
    width = TrustScores(size, spread(together.bias), spread(together.moved))
    return dataclasses.replace(limits, width=width)


def reasons(limits: TrustLimits, trust: Trust) -> tuple[str, ...]:
    """What lowers the trust to the alarm level or below, in words; the worst first."""
    names = [parameter.name for parameter in limits.parameters]
    size, bias = np.asarray(trust.scores.size), np.asarray(trust.scores.bias)
    scores = np.concatenate([np.maximum(size, 0.0), np.abs(bias)])
    k = int(np.argmax(np.where(np.isfinite(scores), scores, np.inf)))
    innovations = (
        f"the innovation of {in_words([limits.channels[k % size.size]])[0]} "
        f"{'is biased' if k >= size.size else 'scatters too much'}: {scores[k]:.1f} standard "
        f"deviations from a sound filter's, alarm at {float(limits.level(scores.size)[1]):.1f}; "
        "a sensor or the model is not what the filter assumes"
    )
    least = np.asarray(trust.least)
    k = int(np.argmax(least))
    excitation = (
        f"{names[k]} is known less than beforehand: {least[k]:.1f} times the prior's variance"
        if least[k] > 1
        else f"the data have removed {100 * float(trust.determined):.0f} % of the prior's "
        f"variance, less than half; {names[k]} is known least: manoeuvre more"
    )
    far = np.abs(np.asarray(trust.far))
    k = int(np.argmax(far))
    if not bool(trust.inertia):
        bounds = "the estimated mass matrix is not positive definite"
    elif not bool(trust.drag):
        bounds = "the estimated drag would put energy into the motion"
    else:
        bounds = (
            f"{names[k]} is {far[k]:.1f} standard deviations of its prior away "
            f"from {limits.parameters[k].value:.4g}"
        )
    moved = np.abs(np.asarray(trust.scores.moved))
    k = int(np.argmax(moved))
    steadiness = (
        f"{names[k]} has moved by {moved[k]:.1f} times the standard deviation that the data "
        "account for"
    )
    texts = innovations, excitation, bounds, steadiness
    answers = trust.innovations, trust.excitation, trust.bounds, trust.steadiness
    found = sorted(zip(map(float, answers), texts, strict=True))
    return tuple(text for answer, text in found if not answer > ALARM_TRUST)


def _trust_of_scores(limits: TrustLimits, scores: Float[Array, "test"]) -> Scalar:
    """From the largest score to [0, 1]; a score that is not finite is no trust."""
    usual, alarm = limits.level(scores.size)
    largest = jnp.max(jnp.abs(scores))
    trust = jnp.clip(1 - (1 - ALARM_TRUST) * (largest - usual) / (alarm - usual), 0.0, 1.0)
    return jnp.where(jnp.isfinite(largest), trust, 0.0)


def _resistance_power(
    vessel: Vessel, motions: Float[Array | np.ndarray, "motion 3"]
) -> Float[Array, "motion"]:
    """Power (W) that the hull's resistance puts into motions (u, v, r) through still water.

    Other forces, an estimated disturbance say, may drive.
    """
    resisting = [force for force in vessel.forces.values() if force.resists]
    zero = jnp.zeros(())

    def power(motion: Float[Array, "3"]) -> Float[Array, ""]:
        u, v, r = motion
        state = State(zero, zero, zero, u, v, r)
        drag = sum((force(state, Environment(), zero) for force in resisting), Force())
        return drag.X * u + drag.Y * v + drag.N * r

    return jnp.asarray(jax.vmap(power)(jnp.asarray(motions)))
