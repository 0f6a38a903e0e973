"""Standard trials of a vessel: planned with defaults for any size, run, and summed up."""

import dataclasses
import math
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from diffsea.errors import UserError
from diffsea.metrics import imo_verdicts
from diffsea.metrics.numbers import over_length
from diffsea.scales import froude_speed, time_scale
from diffsea.simulation.control import (
    ControlAllocation,
    full_throttle,
    require_steering,
    speed_for,
    speed_hold,
    throttle_for_thrust,
)
from diffsea.simulation.manoeuvres import Stages
from diffsea.simulation.standard import Numbers, TrialPlan, standard_trial
from diffsea.simulation.trials import Trial, TrialSettings, approach_limit, run_trial
from diffsea.trajectory import Outcome
from diffsea.types import Scalar, as_inputs
from diffsea.vessel.base import Vessel


_STEP_LIMIT = 2e6  # a run keeps every step in memory
_EXECUTES_LIMIT = 100  # every execute is a stage of the compiled program
_DELAY_MARGIN = 1.5  # longest delay over the vessel's own: sensitivities and sweeps change it


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
        side: of the first order, +1 starboard, -1 port.
        speed: approach speed, m/s; 0.2 sqrt(g L) by default, or the reference speed of an
            Abkowitz set.
        thrust: total thrust in N, instead of a speed.
        seconds: duration of every timed stage (acceleration, coasting, spiral, the straight
            part of a pull-out); of the other trials the time limit.
        step: time step, s.
        keep_speed: whether the speed controller goes on after the execute; trials by the book
            leave the throttle alone.

    Raises:
        UserError: an unknown manoeuvre, or one that the vessel cannot run; a number not above zero.
    """
    trial = standard_trial(manoeuvre)
    for name, number in {
        "angle": angle, "heading": heading, "speed": speed, "thrust": thrust, "seconds": seconds,
        "step": step,
    }.items():  # fmt: skip
        if number is not None and not 0 < number < math.inf:
            raise UserError(f"the {name} of a {manoeuvre} must be above zero, got {number:g}")
    if executes > _EXECUTES_LIMIT:
        raise UserError(f"{executes} executes are too many; at most {_EXECUTES_LIMIT} are run")
    if trial.angle:
        require_steering(vessel, manoeuvre)
    start, throttle, nominal = _settle_speed(vessel, manoeuvre, speed, thrust)
    if keep_speed and thrust is not None:
        raise UserError("a thrust that is left alone cannot keep the speed: give a speed instead")
    length = float(vessel.rigid_body.length)
    lengths = length / nominal
    timed = seconds if trial.timed and seconds is not None else trial.timed * lengths
    delays = [float(s.delay) for s in vessel.servos.values() if s.delay is not None]
    settings = TrialSettings(
        step=default_step(length) if step is None else step,
        from_rest=trial.from_rest,
        longest_delay=_DELAY_MARGIN * max(delays) if delays else None,
    )
    plan = TrialPlan(
        manoeuvre,
        angle=math.radians(trial.angle) if angle is None else angle,
        heading=math.radians(trial.heading) if heading is None else heading,
        side=math.copysign(1.0, side),
        executes=executes,
        seconds=timed,
        speed=start,
        throttle=throttle,
        nominal_speed=nominal,
        settings=settings,
        approach_seconds=round_up(approach_limit(vessel, nominal, settings)),
        keep_speed=keep_speed,
    )
    limit = round_up(trial.limit(plan) * lengths)
    if trial.timed:
        limit += timed * trial.stages(plan).count
    elif seconds is not None:
        limit = seconds
    steps = (limit + plan.approach_seconds) / settings.step
    if steps > _STEP_LIMIT:
        raise UserError(
            f"a step of {settings.step:g} s makes {steps:.2g} steps of up to "
            f"{plan.approach_seconds:g} s of approach and {limit:g} s of {manoeuvre}: take a "
            "longer step, a higher speed, or fewer seconds"
        )
    return dataclasses.replace(plan, settings=dataclasses.replace(settings, seconds=limit))


def _settle_speed(
    vessel: Vessel, manoeuvre: str, speed: float | None, thrust: float | None
) -> tuple[float | None, float | None, float]:
    """Speed of the approach (m/s), throttle where it is left alone, and speed of the plan (m/s)."""
    propelled = ControlAllocation(vessel).propelled
    if not propelled and (standard_trial(manoeuvre).propelled or thrust is not None):
        raise UserError(
            f"{vessel.name!r} has no propulsion to command, so "
            + ("a thrust cannot be set" if thrust is not None else f"it cannot run {manoeuvre}")
        )
    if thrust is not None:
        throttle = float(throttle_for_thrust(vessel, thrust))
        if not throttle <= full_throttle(vessel):
            raise UserError(f"{thrust:g} N is more than {vessel.name!r} can push; lower the thrust")
        reached = float(speed_for(vessel, throttle))
        if not (math.isfinite(reached) and reached > 0):
            raise UserError(f"{vessel.name!r} reaches no steady speed ahead under {thrust:g} N")
        return speed, throttle, reached
    if speed is None:
        speed = default_speed(vessel)
    elif speed > top_speed(vessel):
        raise UserError(
            f"{vessel.name!r} does not reach {speed:g} m/s: at full throttle it runs "
            f"{top_speed(vessel):.3g} m/s; choose a lower speed"
        )
    return speed, None if propelled else 0.0, speed


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


def round_up(seconds: float) -> float:
    """A time (s), up to two digits: neighbouring speeds then share a compiled program."""
    unit = 10.0 ** (math.floor(math.log10(seconds)) - 1)
    return math.ceil(seconds / unit - 1e-9) * unit


def run_plan(
    vessel: Vessel, plan: TrialPlan, speed: Scalar | None = None, throttle: Scalar | None = None
) -> Trial:
    """Run a plan; `speed` (m/s) or `throttle` in place of the plan's may be traced.

    Pure in vessel, speed and throttle: differentiate and batch it.
    """
    if speed is None and throttle is None:
        speed, throttle = plan.speed, plan.throttle
    elif throttle is None and not ControlAllocation(vessel).propelled:
        throttle = 0.0
    stages, keep_speed = plan.trial.stages(plan), plan.keep_speed
    return _run_stages(
        vessel, stages, speed, throttle, plan.settings, plan.approach_seconds, keep_speed
    )


def _run_stages(
    vessel: Vessel,
    stages: Stages,
    speed: Scalar | None,
    throttle: Scalar | None,
    settings: TrialSettings,
    approach_seconds: float,
    keep_speed: bool,
) -> Trial:
    governor = speed_hold(vessel, speed) if keep_speed and speed is not None else None
    return run_trial(vessel, stages, speed, throttle, settings, None, approach_seconds, governor)


_compiled_run = eqx.filter_jit(_run_stages)  # of a table of stages: trials share a program


@eqx.filter_jit
def _compiled_numbers(trial: Trial, kind: tuple[str, float]) -> Numbers:
    return standard_trial(kind[0]).numbers(kind[1], trial)


def _given(vessel: Vessel, plan: TrialPlan) -> tuple[Any, ...]:
    """What a plan's run is compiled for."""
    speed = None if plan.speed is None else jnp.asarray(plan.speed, float)
    throttle = None if plan.throttle is None else jnp.asarray(plan.throttle, float)
    settings = plan.settings, plan.approach_seconds, plan.keep_speed
    return as_inputs(vessel), plan.trial.stages(plan), speed, throttle, *settings


def run_and_measure(vessel: Vessel, plan: TrialPlan) -> tuple[Trial, Numbers]:
    """Run a plan, compiled, with its numbers."""
    trial = _compiled_run(*_given(vessel, plan))
    return trial, _compiled_numbers(trial, (plan.manoeuvre, plan.side))


def number_names(vessel: Vessel, plan: TrialPlan) -> list[str]:
    """Names of the numbers that a plan gives, found without running it."""
    trial = eqx.filter_eval_shape(_compiled_run, *_given(vessel, plan))
    return list(eqx.filter_eval_shape(_compiled_numbers, trial, (plan.manoeuvre, plan.side)))


def trial_numbers(plan: TrialPlan, trial: Trial) -> Numbers:
    """The trial's numbers in SI units; NaN for one that it does not contain."""
    return plan.trial.numbers(plan.side, trial)


def summarise_trial(
    vessel: Vessel, plan: TrialPlan, trial: Trial, numbers: Numbers | None = None
) -> dict[str, Any]:
    """What stands in metrics.json: numbers, the same over L, orders, outcome and IMO verdicts."""
    numbers = trial_numbers(plan, trial) if numbers is None else numbers
    found = {name: float(value) for name, value in numbers.items() if np.isfinite(value)}
    missing = [name for name in numbers if name not in found]
    length = float(vessel.rigid_body.length)
    outcome = Outcome(int(trial.trajectory.outcome))
    ends = np.asarray(trial.switch_times, float)[:-1]
    orders: dict[str, Any] = {}
    if plan.trial.angle:
        orders = {"side": "starboard" if plan.side > 0 else "port", "order_angle": plan.angle}
        orders |= {"switching_heading": plan.heading} if plan.trial.heading else {}
    notes = [] if outcome is Outcome.COMPLETED else [outcome.sentence]
    return {
        "vessel": vessel.name,
        "manoeuvre": plan.manoeuvre,
        "outcome": outcome_label(outcome),
        "outcome_message": outcome.sentence,
        "execute_time": float(trial.execute_time),
        "switch_times": [float(trial.execute_time), *ends[np.isfinite(ends)].tolist()],
        **orders,
        **found,
        **over_length(found, length),
        "imo": trial_verdicts(plan, found, length),
        "notes": notes + ([f"the run does not contain {', '.join(missing)}"] if missing else []),
    }


def trial_verdicts(plan: TrialPlan, found: dict[str, float], length: float) -> dict[str, Any]:
    """IMO verdicts on the numbers of a trial of a vessel of `length` m."""
    recorded, speed = plan.trial.recorded, found.get("approach_speed", 0.0)
    if recorded is None or not speed > 0:
        return {}
    return imo_verdicts(found, length, speed, recorded.criteria, plan.angle, plan.heading or None)


def outcome_label(outcome: Outcome) -> str:
    """An outcome as it stands in files, for example `time-limit`."""
    return outcome.name.lower().replace("_", "-")
