"""Columns that are one quantity together: a sine and a cosine, a speed and its course."""

from typing import NamedTuple

import numpy as np

from diffsea.recordings.mapping_proposal.names import NAMED, Suggestion
from diffsea.recordings.mappings import UNITS
from diffsea.trajectory import Samples


_ON_CIRCLE = 0.05  # by which the squares of sine and cosine may add up to more or less than one
_CALLED_A_SPEED = (0.2, 0.7)  # weights of surge between which a name is that of some speed


def are_on_a_circle(sine: Samples | None, cosine: Samples | None) -> bool:
    """Whether the squares of two columns add up to one."""
    if sine is None or cosine is None:
        return False
    off = np.abs(sine**2 + cosine**2 - 1)
    return bool(np.isfinite(off).any() and np.nanmedian(off) < _ON_CIRCLE)


def with_headings(table: dict[str, Samples], cosines: dict[str, str]) -> dict[str, Samples]:
    """The table with headings (rad) in place of their sines, and without their cosines."""
    there = {s: c for s, c in cosines.items() if s in table and c in table}
    others = {name: series for name, series in table.items() if name not in there.values()}
    return others | {s: np.arctan2(table[s], table[c]) for s, c in there.items()}


class Course(NamedTuple):
    """A column of courses, and the unit that they are in."""

    column: str
    unit: str


def courses_of_speeds(
    suggestions: dict[str, Suggestion], table: dict[str, Samples]
) -> dict[str, Course]:
    """The course over ground by its speed: where a table has one of each, and a heading.

    What is only called a speed is of the same receiver, beside its course.
    """
    speeds = [name for name in table if suggestions[name].is_speed_over_ground]
    if not speeds:
        plain = {name: suggestions[name].weights for name in table}
        speeds = [
            n
            for n, weights in plain.items()
            if _CALLED_A_SPEED[0] < weights["u"] < _CALLED_A_SPEED[1]
        ]
    courses = [name for name in table if suggestions[name].is_course_over_ground]
    headed = any(suggestions[name].weights["psi"] > NAMED for name in table)
    if len(speeds) != 1 or len(courses) != 1 or not headed:
        return {}
    is_size = np.nanmin(table[speeds[0]]) >= 0
    unit = _course_unit(table[courses[0]])
    return {speeds[0]: Course(courses[0], unit)} if is_size and unit else {}


def _course_unit(course: Samples) -> str:
    """The unit that a course is in by its values; none where it is no course."""
    low, high = np.nanmin(course), np.nanmax(course)
    if low >= -np.pi - 0.01 and high <= 2 * np.pi + 0.01:
        return "rad"
    return "deg" if low >= -180.5 and high <= 360.5 else ""


def with_velocities(table: dict[str, Samples], courses: dict[str, Course]) -> dict[str, Samples]:
    """The table with velocities north and east in place of speeds and courses over ground."""
    found = dict(table)
    for speed, (course, unit) in courses.items():
        if speed in table and course in table:
            angle = table[course] * UNITS[unit][1]
            found |= {speed: table[speed] * np.cos(angle), course: table[speed] * np.sin(angle)}
    return found
