"""What each kind of standard trial is summed up by: pure in the trial, in SI units.

The standard trials by name: their orders, their defaults on any vessel, their numbers.

A `Plan` is a trial with every number settled. `run` and `numbers` are pure in the vessel,
the speed and the throttle: sensitivities and sweeps differentiate and batch them.
"""

import dataclasses
import math
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffsea.errors import UserError, nearest
from diffsea.metrics import (
    Curve,
    curve,
    first_crossing,
    imo_verdicts,
    slopes,
    stopping_metrics,
    turning_metrics,
    value_at,
    zigzag_metrics,
)
from diffsea.metrics.crossings import known
from diffsea.scales import froude_speed, time_scale
from diffsea.simulation import manoeuvres
from diffsea.simulation import standard as kinds
from diffsea.simulation.control import (
    ControlAllocation,
    full_throttle,
    require_steering,
    speed_for,
    speed_hold,
    throttle_for_thrust,
)
from diffsea.simulation.manoeuvres import FULL_CIRCLES, Stages
from diffsea.simulation.trials import Settings, Trial, approach_limit, run_trial
from diffsea.trajectory import Outcome, Trajectory
from diffsea.types import Scalar
from diffsea.vessel.base import Vessel


Numbers = dict[str, Float[Array, ""]]


def turning(side: float, trial: Trial) -> Numbers:
    """Advance, transfer, diameters and the rest of a turn."""
    return turning_metrics(trial.trajectory, trial.execute_time, side)


def zigzag(side: float, trial: Trial) -> Numbers:
    """Overshoots, times and rates of a zig-zag."""
    times = jnp.concatenate([jnp.asarray(trial.execute_time)[None], trial.switch_times[:-1]])
    return zigzag_metrics(trial.trajectory, times, side=side)


def stopping(side: float, trial: Trial) -> Numbers:
    """Reaches and time of a stop."""
    return stopping_metrics(trial.trajectory, trial.execute_time)


def _surge(run: Trajectory) -> Curve:
    return curve(run.t, run.u, slopes(run.t, run.u), run.valid)


def _distance(run: Trajectory, start: Scalar) -> Float[Array, ""]:
    """Distance made good (m) from `start` to the end."""
    at = [value_at(curve(run.t, p, slopes(run.t, p), run.valid), start) for p in (run.x, run.y)]
    last = jnp.max(jnp.where(run.valid, run.t, -jnp.inf))
    end = [value_at(curve(run.t, p, slopes(run.t, p), run.valid), last) for p in (run.x, run.y)]
    square = (end[0] - at[0]) ** 2 + (end[1] - at[1]) ** 2
    return jnp.sqrt(jnp.where(square > 0, square, 1.0)) * (square > 0)


def _speed_change(trial: Trial, share: float, upwards: bool) -> Numbers:
    """Speed at the end, distance made good, and when a share of the change was over."""
    run = trial.trajectory
    surge = _surge(run)
    last = surge.value[-1]
    start = value_at(surge, trial.execute_time)
    level = start + share * ((last if upwards else 0.0) - start)
    reached = first_crossing(surge, level, +1 if upwards else -1, after=trial.execute_time)
    time = known(reached.time - trial.execute_time, reached.found)
    name = "time_to_90_percent" if upwards else "time_to_half_speed"
    distance = _distance(run, trial.execute_time)
    ends = {"final_speed": last, "distance": distance, name: time}
    return ends if upwards else {**ends, "approach_speed": start}


def acceleration(side: float, trial: Trial) -> Numbers:
    """Final speed, distance made good, and when nine tenths of the speed were there."""
    return _speed_change(trial, 0.9, True)


def coasting(side: float, trial: Trial) -> Numbers:
    """Speeds, distance made good, and when half of the speed was lost."""
    return _speed_change(trial, 0.5, False)


def _yaw(trial: Trial) -> Curve:
    run = trial.trajectory
    return curve(run.t, run.r, slopes(run.t, run.r), run.valid)


def pull_out(side: float, trial: Trial) -> Numbers:
    """The turn until the release, and yaw rates (rad/s, towards the side) then and at the end."""
    yaw, ends = _yaw(trial), trial.switch_times
    released = jnp.isfinite(ends[0])
    until = jnp.where(released, ends[0], jnp.inf)
    run = trial.trajectory
    turn = dataclasses.replace(run, valid=run.valid & (run.t <= until))
    rate = side * value_at(yaw, jnp.where(released, ends[0], 0.0))
    return {
        **turning_metrics(turn, trial.execute_time, side),
        "yaw_rate_at_release": known(rate, released),
        "residual_yaw_rate": known(side * yaw.value[-1], jnp.isfinite(ends[1])),
    }


def spiral(side: float, trial: Trial) -> Numbers:
    """Yaw rate (rad/s) at the end of every stage, in the order in which they were held."""
    yaw, ends = _yaw(trial), trial.switch_times
    there = jnp.isfinite(ends)
    rates = jax.vmap(lambda t: value_at(yaw, t))(jnp.where(there, ends, 0.0))
    return {f"yaw_rate_{k + 1}": known(rates[k], there[k]) for k in range(ends.size)}


_MOST_STEPS = 2e6  # a run keeps every step in memory
_MOST_EXECUTES = 100
PULL_OUT_TURN = math.radians(360)  # heading change after which the rudder is released
_LENGTHS = (
    "advance", "transfer", "tactical_diameter", "max_advance", "max_transfer",
    "steady_turning_diameter", "initial_turning_distance", "track_reach", "head_reach",
    "lateral_deviation", "distance",
)  # fmt: skip


@dataclasses.dataclass(frozen=True)
class TrialPlan:
    """A standard trial with every number settled."""

    manoeuvre: str
    angle: float  # rad, rudder or rudder-equivalent, without its side
    heading: float  # rad, of a zig-zag's switching
    side: float  # +1 starboard first, -1 port first
    executes: int
    seconds: float  # s, of every timed stage
    speed: float | None  # m/s, at the start of the approach and, without a throttle, held
    throttle: float | None  # open loop
    nominal_speed: float  # m/s, by which durations were chosen
    settings: Settings
    approach_seconds: float
    keep_speed: bool = False  # the speed controller goes on after the execute


@dataclasses.dataclass(frozen=True)
class StandardTrial:
    """One standard trial. Durations are in ship lengths run at the approach speed."""

    stages: Callable[[TrialPlan], Stages]
    numbers: Callable[[float, Trial], Numbers]  # of the side
    limit: Callable[[TrialPlan], float]  # lengths after which it is given up
    angle: float = 0.0  # deg, by default; zero where nothing is steered
    heading: float = 0.0  # deg
    timed: float = 0.0  # lengths, default of the timed stages
    from_rest: bool = False
    propelled: bool = False  # whether it needs a throttle


def plan_trial(
    vessel: Vessel,
    manoeuvre: str,
    angle: float | None = None,
    heading: float | None = None,
    side: float = 1.0,
    speed: float | None = None,
    thrust: float | None = None,
    seconds: float | None = None,
    step: float | None = None,
    executes: int = 4,
    keep_speed: bool = False,
) -> TrialPlan:
    """Settle a trial of a vessel. Angles in rad; `None` takes the default.

    Arguments:
        speed: approach speed, m/s; 0.2 sqrt(g L) by default, or the reference speed of an
            Abkowitz set.
        thrust: total thrust in N, instead of a speed.
        seconds: duration of every timed stage (acceleration, coasting, spiral, the straight
            part of a pull-out); of the other trials the time limit.
        keep_speed: whether the speed controller goes on after the execute; trials by the book
            leave the throttle alone.

    Raises:
        UserError: an unknown manoeuvre, or one that the vessel cannot run.
    """
    kind = standard(manoeuvre)
    if executes > _MOST_EXECUTES:
        raise UserError(f"{executes} executes are too many; at most {_MOST_EXECUTES} are run")
    allocation = ControlAllocation(vessel)
    if kind.angle:
        require_steering(vessel, manoeuvre)
    if not allocation.propelled and (kind.propelled or thrust is not None):
        raise UserError(
            f"{vessel.name!r} has no propulsion to command, so "
            + ("a thrust cannot be set" if thrust is not None else f"it cannot run {manoeuvre}")
        )
    throttle = None
    start = speed
    if thrust is not None:
        throttle = float(throttle_for_thrust(vessel, thrust))
        if not throttle <= full_throttle(vessel):
            raise UserError(f"{thrust:g} N is more than {vessel.name!r} can push; lower the thrust")
        speed = _reached(vessel, throttle, thrust)
    elif speed is None:
        start = speed = default_speed(vessel)
    elif speed > top_speed(vessel):
        raise UserError(
            f"{vessel.name!r} does not reach {speed:g} m/s: at full throttle it runs "
            f"{top_speed(vessel):.3g} m/s; choose a lower speed"
        )
    if keep_speed and throttle is not None:
        raise UserError("a thrust that is left alone cannot keep the speed: give a speed instead")
    if not allocation.propelled:
        throttle = 0.0
    length = float(vessel.rigid_body.length)
    lengths = length / speed
    timed = seconds if kind.timed and seconds is not None else kind.timed * lengths
    settled = TrialPlan(
        manoeuvre,
        math.radians(kind.angle) if angle is None else angle,
        math.radians(kind.heading) if heading is None else heading,
        math.copysign(1.0, side), executes, timed, start, throttle, speed, Settings(), 0.0,
    )  # fmt: skip
    limit = rounded_up(kind.limit(settled) * lengths)
    if kind.timed:
        limit += timed * kind.stages(settled).count
    elif seconds is not None:
        limit = seconds
    settings = Settings(
        step=default_step(length) if step is None else step,
        seconds=limit,
        from_rest=kind.from_rest,
        longest_delay=_longest_delay(vessel),
    )
    approach = rounded_up(approach_limit(vessel, speed, settings))
    steps = (settings.seconds + approach) / settings.step
    if steps > _MOST_STEPS:
        raise UserError(
            f"a step of {settings.step:g} s makes {steps:.2g} steps of up to {approach:g} s of "
            f"approach and {settings.seconds:g} s of {manoeuvre}: take a longer step, a higher "
            "speed, or fewer seconds"
        )
    return dataclasses.replace(
        settled, settings=settings, approach_seconds=approach, keep_speed=keep_speed
    )


def standard(name: str) -> StandardTrial:
    """A standard trial by name. Raises `UserError` for an unknown one."""
    if name not in STANDARDS:
        raise UserError(
            f"there is no manoeuvre {name!r}{nearest(name, STANDARDS)}; "
            f"choose one of {', '.join(STANDARDS)}"
        )
    return STANDARDS[name]


def run(
    vessel: Vessel, plan: TrialPlan, speed: Scalar | None = None, throttle: Scalar | None = None
) -> Trial:
    """Run a plan; `speed` (m/s) or `throttle` in place of the plan's may be traced."""
    if speed is None and throttle is None:
        speed, throttle = plan.speed, plan.throttle
    elif throttle is None and not ControlAllocation(vessel).propelled:
        throttle = 0.0
    return run_trial(
        vessel, STANDARDS[plan.manoeuvre].stages(plan), speed, throttle, plan.settings,
        approach_seconds=plan.approach_seconds,
        governor=speed_hold(vessel, speed) if plan.keep_speed else None,
    )  # fmt: skip


def measured(vessel: Vessel, plan: TrialPlan) -> tuple[Trial, Numbers]:
    """Run a plan, compiled, with its numbers."""
    vessel = jax.tree.map(lambda leaf: jnp.asarray(leaf, float), vessel)
    start = [None if v is None else jnp.asarray(v, float) for v in (plan.speed, plan.throttle)]
    stages = STANDARDS[plan.manoeuvre].stages(plan)
    trial = _compiled_run(
        vessel, stages, *start, plan.settings, plan.approach_seconds, plan.keep_speed
    )
    return trial, _compiled_numbers(trial, (plan.manoeuvre, plan.side))


@eqx.filter_jit
def _compiled_run(
    vessel: Vessel,
    stages: Stages,
    speed: Scalar | None,
    throttle: Scalar | None,
    settings: Settings,
    approach_seconds: float,
    keep_speed: bool,
) -> Trial:
    governor = speed_hold(vessel, speed) if keep_speed else None
    return run_trial(
        vessel, stages, speed, throttle, settings, approach_seconds=approach_seconds,
        governor=governor,
    )  # fmt: skip


@eqx.filter_jit
def _compiled_numbers(trial: Trial, kind: tuple[str, float]) -> Numbers:
    return STANDARDS[kind[0]].numbers(kind[1], trial)


def numbers(plan: TrialPlan, trial: Trial) -> Numbers:
    """The trial's numbers in SI units; NaN for one that it does not contain."""
    return STANDARDS[plan.manoeuvre].numbers(plan.side, trial)


def summary(vessel: Vessel, plan: TrialPlan, trial: Trial, values: Numbers | None = None) -> dict:
    """What stands in metrics.json: numbers, the same over L, orders, outcome and IMO verdicts."""
    values = numbers(plan, trial) if values is None else values
    found = {name: float(value) for name, value in values.items() if np.isfinite(value)}
    length = float(vessel.rigid_body.length)
    outcome = Outcome(int(trial.trajectory.outcome))
    result = {
        "vessel": vessel.name,
        "manoeuvre": plan.manoeuvre,
        "outcome": label(outcome),
        "outcome_message": outcome.sentence,
        "execute_time": float(trial.execute_time),
        "switch_times": _orders_given(trial),
        **_ordered(plan),
        **found,
        **{f"{name}_over_L": found[name] / length for name in _LENGTHS if name in found},
    }
    return {**result, "imo": verdicts(plan, found, length), "notes": _notes(plan, outcome, values)}


def verdicts(plan: TrialPlan, found: dict[str, float], length: float) -> dict:
    """IMO verdicts on the numbers of a trial of a vessel of `length` m."""
    speed = found.get("approach_speed", 0.0)
    if not speed > 0:
        return {}
    kind = "zigzag" if plan.manoeuvre == "modified-zigzag" else plan.manoeuvre
    return imo_verdicts(found, length, speed, kind, plan.angle, plan.heading or None)


def label(outcome: Outcome) -> str:
    """An outcome as it stands in files, for example `time-limit`."""
    return outcome.name.lower().replace("_", "-")


def default_speed(vessel: Vessel) -> float:
    """Approach speed (m/s): Froude number 0.2, or the reference speed of an Abkowitz set.

    At most four fifths of what full throttle reaches.
    """
    for part in (*vessel.forces.values(), *vessel.actuators.values()):
        scaling = getattr(part, "scaling", None)
        if scaling is not None and scaling.kind == "abkowitz":
            return float(scaling.reference_speed)
    return min(froude_speed(float(vessel.rigid_body.length), 0.2), 0.8 * top_speed(vessel))


def top_speed(vessel: Vessel) -> float:
    """Speed (m/s) at full throttle; infinite where nothing limits it."""
    full = full_throttle(vessel)
    reached = float(speed_for(vessel, full)) if math.isfinite(full) else math.inf
    return reached if reached > 0 else math.inf


def default_step(length: float) -> float:
    """Time step (s) near 0.05 sqrt(L / g), one of 1, 2 and 5 times a power of ten."""
    wanted = 0.05 * time_scale(length)
    decade = 10.0 ** math.floor(math.log10(wanted))
    candidates = [m * decade for m in (1.0, 2.0, 5.0, 10.0)]
    return float(f"{min(candidates, key=lambda c: abs(math.log(c / wanted))):.1g}")


def rounded_up(seconds: float) -> float:
    """A time (s), up to two digits: neighbouring speeds then share a compiled program."""
    unit = 10.0 ** (math.floor(math.log10(seconds)) - 1)
    return math.ceil(seconds / unit - 1e-9) * unit


def _reached(vessel: Vessel, throttle: float, thrust: float) -> float:
    speed = float(speed_for(vessel, throttle))
    if not (math.isfinite(speed) and speed > 0):
        raise UserError(f"{vessel.name!r} reaches no steady speed ahead under {thrust:g} N")
    return speed


def _longest_delay(vessel: Vessel) -> float | None:
    delays = [float(s.delay) for s in vessel.servos.values() if s.delay is not None]
    return 1.5 * max(delays) if delays else None


def _ordered(plan: TrialPlan) -> dict:
    kind = STANDARDS[plan.manoeuvre]
    if not kind.angle:
        return {}
    side = {"side": "starboard" if plan.side > 0 else "port", "order_angle": plan.angle}
    return side | ({"switching_heading": plan.heading} if kind.heading else {})


def _orders_given(trial: Trial) -> list[float]:
    """The execute and every later change of orders (s)."""
    ends = np.asarray(trial.switch_times, float)[:-1]
    return [float(trial.execute_time), *(float(t) for t in ends if np.isfinite(t))]


def _notes(plan: TrialPlan, outcome: Outcome, values: Numbers) -> list[str]:
    missing = [name for name, value in values.items() if not np.isfinite(value)]
    notes = [] if outcome is Outcome.COMPLETED else [outcome.sentence]
    return notes + ([f"the run does not contain {', '.join(missing)}"] if missing else [])


def _small_angles(plan: TrialPlan) -> float:
    """Factor on the duration of a turn by its angle: small ones turn slowly."""
    return max(1.0, math.radians(20) / max(plan.angle, math.radians(1)))


def _zigzag_limit(plan: TrialPlan) -> float:
    return 40.0 * plan.executes * max(1.0, plan.heading / max(plan.angle, math.radians(1)))


def _zigzag_stages(plan: TrialPlan) -> Stages:
    return manoeuvres.zigzag(plan.side * plan.angle, plan.heading, plan.executes)


STANDARDS: dict[str, StandardTrial] = {
    "turning-circle": StandardTrial(
        lambda p: manoeuvres.turning_circle(p.side * p.angle, FULL_CIRCLES),
        kinds.turning, lambda p: 120.0 * _small_angles(p), angle=35.0,
    ),
    "zigzag": StandardTrial(_zigzag_stages, kinds.zigzag, _zigzag_limit, angle=20.0, heading=20.0),
    "modified-zigzag": StandardTrial(
        _zigzag_stages, kinds.zigzag, _zigzag_limit, angle=10.0, heading=1.0
    ),
    "acceleration": StandardTrial(
        lambda p: manoeuvres.acceleration(p.seconds), kinds.acceleration, lambda p: 1.0, timed=40.0,
        from_rest=True, propelled=True,
    ),
    "stopping": StandardTrial(
        lambda p: manoeuvres.stopping(), kinds.stopping, lambda p: 200.0, propelled=True
    ),
    "coasting": StandardTrial(
        lambda p: manoeuvres.coasting(p.seconds), kinds.coasting, lambda p: 1.0, timed=60.0,
        propelled=True,
    ),
    "pull-out": StandardTrial(
        lambda p: manoeuvres.pull_out(p.side * p.angle, PULL_OUT_TURN, p.seconds),
        kinds.pull_out, lambda p: 100.0 * _small_angles(p), angle=20.0, timed=30.0,
    ),
    "spiral": StandardTrial(
        lambda p: manoeuvres.spiral(p.side * p.angle, p.seconds), kinds.spiral, lambda p: 1.0,
        angle=20.0, timed=25.0,
    ),
}  # fmt: skip
