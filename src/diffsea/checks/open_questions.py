"""What logs cannot tell, and which minutes would.

Three of a small boat; of a slower vessel as many more as she takes longer to become steady.
"""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from diffsea.checks.answers import Answers
from diffsea.checks.spans import STAYED
from diffsea.segments import Segment
from diffsea.trajectory import Trajectory


LENGTH = 180.0  # s, of what is proposed to a small boat
_FULL = 0.8  # of full order, from which on it is nearly full
_ASTERN = -0.15  # of full order
_LEVELS = 3  # speeds that a curve of resistance needs
_TURNED = 0.1  # of full order, from which on an order turns
_HEADINGS = math.radians(120)  # of the circle, that headings must range over
_VAGUE = 0.6  # s, width of the interval of a small boat's dead time that is not well known


@dataclasses.dataclass(frozen=True)
class OpenQuestion:
    """Something that a log cannot tell.

    Attributes:
        what: cannot be told.
        why: what the log has, or lacks.
        record: what would tell, None where no run would.
        seconds: how long that takes; infinite of what is not run.
    """

    what: str
    why: str
    record: str | None = None
    seconds: float = 0.0

    def as_dict(self) -> dict[str, object]:
        """As it stands in check.json."""
        return dataclasses.asdict(self)


def open_questions(
    runs: Sequence[Trajectory],
    answers: Answers,
    trials: Sequence[Segment],
    missing: Sequence[str],
    is_judged: bool,
) -> list[OpenQuestion]:
    """What the used parts of logs leave open, what matters most first.

    Arguments:
        runs: the used part of each log, with orders as shares.
        missing: what was not recorded, in the words of the format.
        is_judged: whether its orders are of a kind that answers are found for.
    """
    found = [OpenQuestion("what was not recorded", sentence) for sentence in missing]
    if not any(run.commanded or run.executed for run in runs):
        found.append(
            OpenQuestion(
                "everything that follows orders", "no order and no executed actuation is recorded"
            )
        )
    elif not is_judged:
        found.append(
            OpenQuestion(
                "speed, turning rate and lag by order",
                "orders of azimuth thrusters act in all directions, and are judged by a fit alone",
            )
        )
    else:
        found += [*_of_turning(answers, trials), *_of_speed(answers)]
    found += _of_surroundings(runs)
    slowness = _slowness(answers)
    return [dataclasses.replace(one, seconds=slowness * one.seconds) for one in found]


def next_length(answers: Answers) -> float:
    """How long (s) what is proposed may last."""
    return LENGTH * _slowness(answers)


def next_minutes(questions: Sequence[OpenQuestion], length: float) -> list[OpenQuestion]:
    """What to record in the next `length` s: what matters most and still fits, each once."""
    chosen: list[OpenQuestion] = []
    left = length
    for one in questions:
        if one.record and one.seconds <= left and one.record not in [c.record for c in chosen]:
            chosen.append(one)
            left -= one.seconds
    return chosen


def _slowness(answers: Answers) -> float:
    """How many times longer than a small boat she takes; one where no order turned her."""
    return 1.0 if answers.lag_of_turning is None else answers.stayed / STAYED


def _of_turning(answers: Answers, trials: Sequence[Segment]) -> list[OpenQuestion]:
    """What turning leaves open: inertia, dead time, circles to both sides."""
    found, lag = [], answers.lag_of_turning
    zigzags = "a zig-zag of three legs either way at half ahead"
    if not np.any(np.isfinite(answers.turn)):
        return [OpenQuestion("how it turns", "no order to turn is recorded")]
    if lag is None:
        why = "less than 30 % of the turning rate's variance follows the orders"
        found.append(OpenQuestion("how fast it answers an order to turn", why, zigzags, 60.0))
    elif lag.delay.high - lag.delay.low > _VAGUE * _slowness(answers):
        why = f"the dead time is known to between {lag.delay.low:.1f} and {lag.delay.high:.1f} s"
        found.append(OpenQuestion("how late it answers", why, zigzags, 60.0))
    orders = [point.order for point in answers.turning]
    circles = [one.side for one in trials if one.kind == "turning"]
    for side, sign in (("starboard", 1.0), ("port", -1.0)):
        if not any(sign * order > _TURNED for order in orders) and side not in circles:
            why = f"no order to {side} stood for {answers.stayed:.0f} s"
            record = f"a full circle to {side} at half ahead"
            found.append(OpenQuestion(f"steady turning to {side}, and so drift", why, record, 45.0))
    return found


def _of_speed(answers: Answers) -> list[OpenQuestion]:
    """What speed leaves open: resistance, full speed, stopping."""
    found, orders = [], [point.order for point in answers.speed]
    if len(orders) < _LEVELS:
        courses = f"straight courses at {len(orders)} order{'s' * (len(orders) > 1)}"
        why = f"{courses if orders else 'no straight course at an order'} that stood"
        leg = _two_digits(20.0 * _slowness(answers))
        record = f"straight ahead at three orders, {leg} s each"
        found.append(OpenQuestion("resistance by speed", why, record, 60.0))
    elif max(orders) < _FULL:
        why = f"the largest order that stood is {100 * max(orders):.0f} % of full"
        found.append(OpenQuestion("speed at full order", why, "straight at full order", 25.0))
    if answers.ahead.size and np.mean(answers.ahead < _ASTERN) * answers.ahead.size < 1:
        why = "no order astern is in it"
        record = "from half ahead to half astern until it stops"
        found.append(OpenQuestion("thrust astern and stopping", why, record, 30.0))
    return found


def _of_surroundings(runs: Sequence[Trajectory]) -> list[OpenQuestion]:
    """What no order tells: current and compass by headings, and the scale of forces."""
    found = []
    psi = np.concatenate([np.asarray(run.psi, float) for run in runs])
    psi = psi[np.isfinite(psi)]
    if psi.size:
        marks = np.unique(np.floor(np.degrees(psi % (2 * math.pi)) / 10))
        if math.radians(10) * marks.size < _HEADINGS:
            why = f"headings cover {10 * marks.size:.0f} deg of the circle"
            record = "the same leg there and back, at one order"
            what = "current and wind, and errors of the compass"
            found.append(OpenQuestion(what, why, record, 60.0))
    if not any({"wind_speed", "wind_direction"} <= run.extra.keys() for run in runs):
        why = "no wind is recorded: it shows only as what is left over"
        found.append(OpenQuestion("wind apart from current", why))
    why, record = "motion fixes forces only over mass", "weigh the boat, or pull at a bollard"
    found.append(OpenQuestion("thrust in newton", why, record, math.inf))
    return found


def _two_digits(seconds: float) -> int:
    """Seconds to two digits, as people time a leg."""
    return int(round(seconds, 1 - math.floor(math.log10(seconds))))
