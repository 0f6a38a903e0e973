"""A quick look: what is left out of a fit or a diagnosis, and how that is told."""

from collections.abc import Sequence

from diffsea.recordings import thin
from diffsea.scales import time_scale
from diffsea.trajectory import Trajectory
from diffsea.vessel.base import Vessel


INTERVAL = 0.5  # between samples that are used, in sqrt(L / g): steering takes several of these
NAMES = 1  # that a diagnosis gives at most


def thinned(vessel: Vessel, runs: Sequence[Trajectory]) -> list[Trajectory]:
    """The recordings with samples half of sqrt(L / g) apart, and all at which an order changes."""
    return [thin(run, interval(vessel)) for run in runs]


def interval(vessel: Vessel) -> float:
    """Seconds between the samples that a quick look uses."""
    return INTERVAL * time_scale(float(vessel.rigid_body.length))


def left_out(vessel: Vessel, before: Sequence[Trajectory], after: Sequence[Trajectory]) -> str:
    """Which samples were not used; nothing where all were."""
    whole, used = (sum(len(run.t) for run in runs) for runs in (before, after))
    if used == whole:
        return ""
    return f"{whole - used} of {whole} samples, nearer than {interval(vessel):.2g} s to another"


def of_diagnosis(samples: str) -> tuple[str, ...]:
    """What a quick diagnosis has not done."""
    causes = "a second cause beside the first, or others where none of the likeliest holds"
    return (*([samples] if samples else []), causes, "the manoeuvre that would tell more")


def of_fit(samples: str) -> tuple[str, ...]:
    """What a quick fit has not done."""
    intervals = "intervals from the profile likelihood"
    again = "other starts, where something is missing"
    return (*([samples] if samples else []), again, intervals, "the manoeuvre to record next")
