"""The standard trials by name: one record of each, which every stage of a trial reads.

A `StandardTrial` says what is ordered, what the trial is summed up by, what it is in a recording,
and how it is run as the next manoeuvre of an identification. Numbers are pure in the trial and in
SI units, so that sensitivities and sweeps differentiate and batch them.
"""

import dataclasses
import math
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from diffsea.errors import UserError, nearest
from diffsea.metrics import (
    RECORDED_TRIALS,
    DifferencedCurve,
    RecordedTrial,
    first_crossing,
    stopping_metrics,
    turning_metrics,
    value_at,
    zigzag_metrics,
)
from diffsea.metrics.crossings import value_or_nan
from diffsea.simulation import manoeuvres
from diffsea.simulation.manoeuvres import Stages
from diffsea.simulation.trials import Trial, TrialSettings
from diffsea.trajectory import Trajectory


PULL_OUT_TURN = math.radians(360)  # heading change after which the rudder is released

Numbers = dict[str, Float[Array, ""]]
Times = Float[np.ndarray, "time"]
Schedule = Callable[[Times], tuple[Times, Times]]  # sqrt(L / g) to throttle share and angle (rad)


@dataclasses.dataclass(frozen=True)
class TrialPlan:
    """A standard trial of a vessel with every number settled."""

    manoeuvre: str
    angle: float  # rad, rudder or rudder-equivalent, without its side
    heading: float  # rad, of a zig-zag's switching
    side: float  # +1 starboard first, -1 port first
    executes: int
    seconds: float  # s, of every timed stage
    speed: float | None  # m/s, at the start of the approach and, without a throttle, held
    throttle: float | None  # open loop
    nominal_speed: float  # m/s, by which durations were chosen
    settings: TrialSettings
    approach_seconds: float
    keep_speed: bool = False  # the speed controller goes on after the execute

    @property
    def signed_angle(self) -> float:
        """The first order, rad, positive to starboard."""
        return self.side * self.angle

    @property
    def trial(self) -> "StandardTrial":
        """The record of the trial."""
        return STANDARD_TRIALS[self.manoeuvre]


@dataclasses.dataclass(frozen=True)
class StandardTrial:
    """One standard trial. Durations are in ship lengths run at the approach speed.

    `numbers` takes the side of the first order (+1 starboard, -1 port). `limit` is when the trial
    is given up. Angles are defaults, in deg: zero where nothing is steered. `recorded` is what
    the trial is in a recording, where it can be told from others; its criteria judge this one too.
    `schedule` is for identification: see `diffsea.identification.uncertainty.design`.
    """

    help: str  # for the command line
    stages: Callable[[TrialPlan], Stages]
    numbers: Callable[[float, Trial], Numbers]
    limit: Callable[[TrialPlan], float]
    angle: float = 0.0
    heading: float = 0.0
    timed: float = 0.0  # default of the timed stages
    from_rest: bool = False
    propelled: bool = False  # whether it needs a throttle
    recorded: RecordedTrial | None = None
    schedule: Schedule | None = None


def standard_trial(name: str) -> StandardTrial:
    """A standard trial by name. Raises `UserError` for an unknown one."""
    if name not in STANDARD_TRIALS:
        raise UserError(
            f"there is no manoeuvre {name!r}{nearest(name, STANDARD_TRIALS)}; "
            f"choose one of {', '.join(STANDARD_TRIALS)}"
        )
    return STANDARD_TRIALS[name]


# What a trial is summed up by


def zigzag_numbers(side: float, trial: Trial) -> Numbers:
    """Overshoots, times and rates of a zig-zag."""
    times = jnp.concatenate([jnp.asarray(trial.execute_time)[None], trial.switch_times[:-1]])
    return zigzag_metrics(trial.trajectory, times, side=side, spare_rows_repeat=True)


def turning_circle_numbers(side: float, trial: Trial) -> Numbers:
    """Advance, diameters, speeds and rates of a turn."""
    run = trial.trajectory
    return turning_metrics(run, trial.execute_time, side, spare_rows_repeat=True)


def stopping_numbers(side: float, trial: Trial) -> Numbers:
    """Reaches and times of a stop."""
    return stopping_metrics(trial.trajectory, trial.execute_time, spare_rows_repeat=True)


def speed_change_numbers(trial: Trial, share: float, upwards: bool, time_name: str) -> Numbers:
    """Last speed (m/s), straight distance made good (m), and when a share of the change was over.

    The change is from the speed at the execute up to the last one, or down to rest; its time (s
    from the execute) goes by `time_name`.
    """
    run, start = trial.trajectory, trial.execute_time
    surge = _channel_curve(run, run.u)
    final, first = surge.value[-1], value_at(surge, start)
    level = first + share * ((final if upwards else 0.0) - first)
    reached = first_crossing(surge, level, +1 if upwards else -1, after=start)
    north, east = (
        track.value[-1] - value_at(track, start)
        for track in (_channel_curve(run, position) for position in (run.x, run.y))
    )
    square = north**2 + east**2
    return {
        "final_speed": final,
        "distance": jnp.where(
            square > 0, jnp.sqrt(jnp.where(square > 0, square, 1.0)), 0.0 * square
        ),
        time_name: value_or_nan(reached.time - start, reached.found),
    }


def coasting_numbers(side: float, trial: Trial) -> Numbers:
    """Speeds, distance made good, and when half of the speed was lost."""
    surge = _channel_curve(trial.trajectory, trial.trajectory.u)
    numbers = speed_change_numbers(trial, 0.5, False, "time_to_half_speed")
    return {**numbers, "approach_speed": value_at(surge, trial.execute_time)}


def pull_out_numbers(side: float, trial: Trial) -> Numbers:
    """The turn until the release, and yaw rates (rad/s, towards the side) then and at the end."""
    run, ends = trial.trajectory, trial.switch_times
    yaw = _channel_curve(run, run.r)
    released = jnp.isfinite(ends[0])
    until = jnp.where(released, ends[0], jnp.inf)
    turn = dataclasses.replace(run, valid=run.valid & (run.t <= until))
    rate = side * value_at(yaw, jnp.where(released, ends[0], 0.0))
    return {
        **turning_metrics(turn, trial.execute_time, side),
        "yaw_rate_at_release": value_or_nan(rate, released),
        "residual_yaw_rate": value_or_nan(side * yaw.value[-1], jnp.isfinite(ends[1])),
    }


def spiral_numbers(side: float, trial: Trial) -> Numbers:
    """Yaw rate (rad/s) at the end of every stage, in the order in which they were held."""
    yaw, ends = _channel_curve(trial.trajectory, trial.trajectory.r), trial.switch_times
    there = jnp.isfinite(ends)
    rates = jax.vmap(lambda t: value_at(yaw, t))(jnp.where(there, ends, 0.0))
    return {f"yaw_rate_{k + 1}": value_or_nan(rates[k], there[k]) for k in range(ends.size)}


def _channel_curve(run: Trajectory, values: Float[Array, "time"]) -> DifferencedCurve:
    """A channel of a simulated run, whose spare rows repeat the row before."""
    return DifferencedCurve(run.t, values)


# What is ordered, and for how long at most


def _slow_turn(plan: TrialPlan) -> float:
    """Factor on the duration of a turn by its angle: small ones turn slowly."""
    return max(1.0, math.radians(20) / max(plan.angle, math.radians(1)))


def _zigzag_stages(plan: TrialPlan) -> Stages:
    return manoeuvres.zigzag(plan.signed_angle, plan.heading, plan.executes)


def _zigzag_limit(plan: TrialPlan) -> float:
    return 40.0 * plan.executes * max(1.0, plan.heading / max(plan.angle, math.radians(1)))


def alternating_schedule(period: float, angle: float) -> Schedule:
    """Angle (rad) to either side in turns of `period` sqrt(L / g), at 0.6 of full throttle."""

    def schedule(t: Times) -> tuple[Times, Times]:
        return np.full_like(t, 0.6), np.where((t // period) % 2 == 0, angle, -angle)

    return schedule


STANDARD_TRIALS: dict[str, StandardTrial] = {
    "turning-circle": StandardTrial(
        help="one order held through 540 deg",
        stages=lambda plan: manoeuvres.turning_circle(plan.signed_angle),
        numbers=turning_circle_numbers,
        limit=lambda plan: 120.0 * _slow_turn(plan),
        angle=35.0,
        recorded=RECORDED_TRIALS["turning-circle"],
        schedule=alternating_schedule(math.inf, 0.35),
    ),
    "zigzag": StandardTrial(
        help="reversed each time that the heading has changed by --heading",
        stages=_zigzag_stages,
        numbers=zigzag_numbers,
        limit=_zigzag_limit,
        angle=20.0,
        heading=20.0,
        recorded=RECORDED_TRIALS["zigzag"],
        schedule=alternating_schedule(17.0, 0.35),
    ),
    "modified-zigzag": StandardTrial(
        help="a zig-zag with a small heading",
        stages=_zigzag_stages,
        numbers=zigzag_numbers,
        limit=_zigzag_limit,
        angle=10.0,
        heading=1.0,
        recorded=RECORDED_TRIALS["zigzag"],
    ),
    "acceleration": StandardTrial(
        help="from rest, straight ahead",
        stages=lambda plan: manoeuvres.acceleration(plan.seconds),
        numbers=lambda side, trial: speed_change_numbers(trial, 0.9, True, "time_to_90_percent"),
        limit=lambda plan: 1.0,
        timed=40.0,
        from_rest=True,
        propelled=True,
    ),
    "stopping": StandardTrial(
        help="full astern until dead in the water",
        stages=lambda plan: manoeuvres.stopping(),
        numbers=stopping_numbers,
        limit=lambda plan: 200.0,
        propelled=True,
        recorded=RECORDED_TRIALS["stopping"],
    ),
    "coasting": StandardTrial(
        help="without throttle",
        stages=lambda plan: manoeuvres.coasting(plan.seconds),
        numbers=coasting_numbers,
        limit=lambda plan: 1.0,
        timed=60.0,
        propelled=True,
    ),
    "pull-out": StandardTrial(
        help="a full turn, then rudder amidships",
        stages=lambda plan: manoeuvres.pull_out(plan.signed_angle, PULL_OUT_TURN, plan.seconds),
        numbers=pull_out_numbers,
        limit=lambda plan: 100.0 * _slow_turn(plan),
        angle=20.0,
        timed=30.0,
        recorded=RECORDED_TRIALS["pull-out"],
    ),
    "spiral": StandardTrial(
        help="Dieudonne's: from side to side and back in steps",
        stages=lambda plan: manoeuvres.spiral(plan.signed_angle, plan.seconds),
        numbers=spiral_numbers,
        limit=lambda plan: 1.0,
        angle=20.0,
        timed=25.0,
    ),
}
