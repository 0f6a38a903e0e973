"""A campaign: the standard trials of a vessel to both sides, judged, traced and compared."""

import dataclasses
import math
import pathlib
from collections.abc import Sequence
from typing import Any

from diffsea.errors import UserError
from diffsea.metrics.imo import SHORTEST_SHIP
from diffsea.metrics.ittc import approach_verdict
from diffsea.metrics.repeats import mean_and_half_width
from diffsea.progress import Progress, no_progress
from diffsea.report.pages.campaign import TrialRun, campaign_page
from diffsea.segments.segments import segments_of, with_window
from diffsea.segments.signals import Signals, signals_of
from diffsea.segments.spans import approach_to
from diffsea.segments.state_log import state_log
from diffsea.segments.traceability import checks_of
from diffsea.simulation import planning
from diffsea.simulation.standard import standard_trial
from diffsea.simulation.trials import Trial
from diffsea.trajectory import Outcome, Samples, Trajectory
from diffsea.vessel.base import Vessel
from diffsea.vessel.files import VesselFile
from diffsea.workflows.audits import Tabulated
from diffsea.workflows.trials import as_vessel


SIDES = {"starboard": 1.0, "port": -1.0}
AHEAD = "ahead"  # in place of a side, of a trial that steers to none
FAILED = (Outcome.DIVERGED, Outcome.APPROACH_UNSTEADY)


@dataclasses.dataclass(frozen=True)
class PlannedTrial:
    """A trial of a campaign: its manoeuvre, and angles (rad) where they are not the usual ones."""

    manoeuvre: str
    angle: float | None = None
    heading: float | None = None

    @classmethod
    def from_text(cls, text: str) -> "PlannedTrial":
        """A trial of a text such as `zigzag:10/10`: manoeuvre, angle and heading in deg.

        Raises:
            UserError: an unknown manoeuvre, one that has no such angle, or no angles.
        """
        manoeuvre, colon, angles = text.partition(":")
        trial, given = standard_trial(manoeuvre), angles.split("/") if colon else []
        usual = [angle for angle in (trial.angle, trial.heading) if angle]
        if len(given) > len(usual):
            example = ":".join(filter(None, [manoeuvre, "/".join(f"{a:g}" for a in usual)]))
            raise UserError(f"{text!r} has too many angles: write for example {example}")
        try:
            sizes = [float(angle) for angle in given]
        except ValueError:
            raise UserError(f"{text!r}: the angles are numbers, in deg") from None
        if not all(0 < size <= 180 for size in sizes):
            raise UserError(f"{text!r}: an angle is above zero and at most 180 deg")
        return cls(manoeuvre, *map(math.radians, sizes))

    @property
    def name(self) -> str:
        """As it stands in campaign.json and in names of files: `zigzag-10-10`."""
        trial, parts = standard_trial(self.manoeuvre), [self.manoeuvre]
        for given, usual in ((self.angle, trial.angle), (self.heading, trial.heading)):
            if usual:
                parts.append(f"{usual if given is None else math.degrees(given):.4g}")
        return "-".join(parts)

    @property
    def sides(self) -> tuple[str, ...]:
        """Those that it is run to."""
        return tuple(SIDES) if standard_trial(self.manoeuvre).angle else (AHEAD,)


USUAL_TRIALS = (
    PlannedTrial("turning-circle", math.radians(35)),
    PlannedTrial("zigzag", math.radians(10), math.radians(10)),
    PlannedTrial("zigzag", math.radians(20), math.radians(20)),
)


@dataclasses.dataclass(frozen=True)
class CampaignTrial:
    """One trial to one side; `log` are the columns of `state_log`.

    `metrics` is what stands in metrics.json, with the `approach` and the `checks` from order to
    motion; of a trial that has no result it is `failed`, the reason, alone.
    """

    name: str
    side: str
    metrics: dict[str, Any]
    run: Trajectory | None = None
    log: dict[str, Samples] = dataclasses.field(default_factory=dict)

    @property
    def file_name(self) -> str:
        """The beginning of the names of its files."""
        return f"{self.name}-{self.side}"


@dataclasses.dataclass(frozen=True, repr=False)
class CampaignResult(Tabulated):
    """The trials of a campaign in the order in which they were run."""

    vessel: Vessel
    trials: tuple[CampaignTrial, ...]

    @property
    def record(self) -> dict[str, Any]:
        """The content of campaign.json: metrics by trial and side, criteria, both sides."""
        by_trial: dict[str, dict[str, Any]] = {}
        for one in self.trials:
            by_trial.setdefault(one.name, {})[one.side] = one.metrics
        criteria = [row for name, sides in by_trial.items() for row in _criteria(name, sides)]
        verdicts = {row["verdict"] for row in criteria}
        told = "fail" if "fail" in verdicts else "pass" if verdicts else "not judged"
        return {
            "format": 1,
            "vessel": self.vessel.name,
            "length": float(self.vessel.rigid_body.length),
            "verdict": told,
            "criteria": criteria,
            "trials": by_trial,
            "repeats": {n: found for n, sides in by_trial.items() if (found := _repeats(sides))},
            "notes": self.notes(),
        }

    def headline(self) -> str:
        verdict = self.record["verdict"]
        told = f"IMO MSC.137(76): {verdict}" if verdict != "not judged" else "not judged by IMO"
        done = sum(one.run is not None for one in self.trials)
        return f"campaign of {self.vessel.name}: {done} of {len(self.trials)} trials done, {told}"

    def rows(self) -> list[dict[str, Any]]:
        return [
            {
                "trial": one.name,
                "side": one.side,
                "outcome": one.metrics.get("outcome", "failed"),
                "approach": one.metrics.get("approach", {}).get("verdict", "-"),
                "ITTC": one.metrics.get("approach", {}).get("ittc", {}).get("verdict", "-"),
                "IMO": _imo_words(one.metrics.get("imo", {})),
            }
            for one in self.trials
        ]

    def notes(self) -> list[str]:
        told = []
        for one in self.trials:
            failed = [f"failed: {one.metrics['failed']}"] if "failed" in one.metrics else []
            notes = [*failed, *one.metrics.get("notes", ())]
            told += [f"{one.name} {one.side}: {note}" for note in notes]
        if float(self.vessel.rigid_body.length) < SHORTEST_SHIP:
            told.append(
                f"the standards are for ships of {SHORTEST_SHIP:g} m and more: for this vessel "
                "they are a comparison and no requirement"
            )
        return told

    def html(self) -> str:
        """The page."""
        drawn = [
            TrialRun(t.name, t.side, t.run, t.log, t.metrics)
            for t in self.trials
            if t.run is not None
        ]
        source = {"vessel": self.vessel.name} | (
            {"numbers from": self.vessel.source} if self.vessel.source else {}
        )
        return campaign_page(self.record, drawn, source)


def campaign(
    vessel: Vessel | VesselFile | str | pathlib.Path,
    trials: Sequence[PlannedTrial | str] = USUAL_TRIALS,
    progress: Progress = no_progress,
    **options: Any,
) -> CampaignResult:
    """Run the standard trials to both sides, as `diffsea campaign` does.

    A trial that cannot be run, diverges or is never executed is kept with the reason.

    Arguments:
        trials: turning circle at 35 deg and zig-zags 10/10 and 20/20 by default; as text
            `zigzag:10/10`, in deg.
        progress: is told what is being run.
        options: those of `plan_trial` for every trial: `speed` m/s or `thrust` N, `seconds`,
            `step`, `executes`, `keep_speed`.

    Raises:
        UserError: an unknown manoeuvre, a trial that is named twice, or none that has a result.
    """
    asked = [PlannedTrial.from_text(one) if isinstance(one, str) else one for one in trials]
    boat, names = as_vessel(vessel), [one.name for one in asked]
    for name in names:
        if names.count(name) > 1:
            raise UserError(f"the trial {name} is named twice; name each only once")
    done = []
    for planned in asked:
        for side in planned.sides:
            progress(f"{planned.name} {side}")
            done.append(_run_trial(boat, planned, side, options))
    if all(one.run is None for one in done):
        raise UserError(f"no trial of {boat.name!r} has a result. {done[0].metrics['failed']}")
    return CampaignResult(boat, tuple(done))


def _run_trial(
    vessel: Vessel, planned: PlannedTrial, side: str, options: dict[str, Any]
) -> CampaignTrial:
    """One trial, or why it has no result."""
    turned = {"angle": planned.angle, "heading": planned.heading, "side": SIDES.get(side, 1.0)}
    try:
        plan = planning.plan_trial(vessel, planned.manoeuvre, **turned, **options)
        trial, numbers = planning.run_and_measure(vessel, plan)
        outcome = Outcome(int(trial.trajectory.outcome))
        if outcome in FAILED:
            raise UserError(f"{outcome.sentence} (time step {plan.settings.step:g} s)")
        metrics = planning.summarise_trial(vessel, plan, trial, numbers)
        return _with_log(vessel, planned, side, trial, metrics, plan.speed)
    except UserError as error:
        return CampaignTrial(planned.name, side, {"failed": str(error)})


def trial_of_plan(
    vessel: Vessel, plan: planning.TrialPlan, trial: Trial, metrics: dict[str, Any]
) -> CampaignResult:
    """A trial that has been run, as a campaign of its own: its page has criteria, track and checks.

    Arguments:
        metrics: the content of metrics.json.
    """
    planned = PlannedTrial(plan.manoeuvre, plan.angle, plan.heading)
    side = "starboard" if plan.side > 0 else "port"
    side = side if len(planned.sides) > 1 else AHEAD
    return CampaignResult(vessel, (_with_log(vessel, planned, side, trial, metrics, plan.speed),))


def _with_log(
    vessel: Vessel,
    planned: PlannedTrial,
    side: str,
    trial: Trial,
    metrics: dict[str, Any],
    speed: float | None,
) -> CampaignTrial:
    """A trial that has a result, with its checks and its log.

    Arguments:
        speed: that was to be held in the approach (m/s); None at a fixed throttle.

    Raises:
        UserError: the run is too short to be searched for its onset.
    """
    run = dataclasses.replace(trial.trajectory, name=f"{planned.name}-{side}").counted()
    signals = signals_of(run, vessel)
    traced, onset = _traced(vessel, signals, metrics["execute_time"])
    approach = traced["approach"]
    approach["ittc"] = approach_verdict(approach["speed"], approach["yaw_rate"], speed)
    log = state_log(vessel, signals, onset)
    return CampaignTrial(planned.name, side, metrics | traced, run, log)


def _traced(vessel: Vessel, signals: Signals, execute: float) -> tuple[dict[str, Any], float]:
    """Approach and checks from order to motion of the trial found in a run, and its onset (s).

    Where no trial is found in it, as in a run straight ahead, the onset is the execute.
    """
    settings = with_window(signals)
    found = [one for one in segments_of(signals, settings) if one.end > execute]
    trial = max(found, key=lambda one: one.end - one.onset, default=None)
    if trial is None or trial.kind not in ("turning", "zigzag"):
        approach = approach_to(signals, float(signals.t[0]), execute, settings)
        return {"approach": dataclasses.asdict(approach), "checks": []}, execute
    checks = [dataclasses.asdict(one) for one in checks_of(signals, trial, vessel, settings)]
    return {"approach": dataclasses.asdict(trial.approach), "checks": checks}, trial.onset


def _criteria(name: str, sides: dict[str, dict[str, Any]]) -> list[dict[str, Any]]:
    """The IMO criteria that a trial is judged by, with the value to each side.

    A criterion is met where every side that has its number meets it.
    """
    judged = {side: metrics.get("imo", {}) for side, metrics in sides.items()}
    rows = []
    for number in dict.fromkeys(number for items in judged.values() for number in items):
        items = {side: found[number] for side, found in judged.items() if number in found}
        one = next(iter(items.values()))
        passed = all(item["verdict"] == "pass" for item in items.values())
        rows.append(
            {
                "trial": name,
                "number": number,
                **{key: one[key] for key in ("criterion", "limit", "unit")},
                "values": {side: item["value"] for side, item in items.items()},
                "verdict": "pass" if passed else "fail",
            }
        )
    return rows


def _repeats(sides: dict[str, dict[str, Any]]) -> dict[str, dict[str, float]]:
    """Numbers that both sides have, as repeats: mean, half-width of its interval, difference."""
    if any(side not in sides for side in SIDES):
        return {}
    starboard, port = (sides[side] for side in SIDES)
    found = {}
    for number, value in starboard.items():
        if number == "execute_time" or not isinstance(value, float) or number not in port:
            continue
        mean, half_width = mean_and_half_width([value, port[number]])
        found[number] = {
            "mean": mean,
            "half_width": half_width,
            "starboard_less_port": value - port[number],
        }
    return found


def _imo_words(items: dict[str, Any]) -> str:
    return ", ".join(f"{name} {item['verdict']}" for name, item in items.items()) or "-"
