"""How well it is known when a change began, where no derivative by its time tells it."""

import numpy as np
from scipy.stats import chi2

from diffsea.identification.descent import filter_at
from diffsea.identification.estimates import INTERVAL_LEVEL, Estimate
from diffsea.identification.problem import Problem
from diffsea.vessel.effects import EFFECTS


HALVINGS = 6  # of the bracket of an end


def onset_interval(problem: Problem, fitted: Estimate, effect: str) -> tuple[float, float]:
    """Times (s) between which an onset lies with a probability of 90 %, all else as fitted.

    To either side as far as -2 log posterior rises by no more than it does in that interval of a
    normal one. While nothing acts that changes (a thruster at rest, a pause between recordings) it
    does not rise at all, and its derivative there says nothing of how far.

    Arguments:
        effect: name of one that is in the fit, with an onset.
    """
    entry, layout = EFFECTS[effect], problem.layout
    assert entry.scanned is not None
    place = int(layout.indices((effect,))[entry.scanned[0]])
    size = float(entry.sizes(problem.base)[entry.scanned[0]])
    times = np.asarray(problem.dataset.run_time)[problem.dataset.recorded_rows]
    began = float(fitted.coordinates[place]) * size
    most, step = float(chi2.ppf(INTERVAL_LEVEL, 1)), float(np.median(np.diff(times)))

    def is_likely(time: float) -> bool:
        coordinates = np.array(fitted.coordinates, float)
        coordinates[place] = time / size
        there = filter_at(problem, coordinates, fitted.noise)
        return there.deviance - fitted.deviance <= most

    def end(sign: float, last: float) -> float:
        inner, outer = began, began + sign * step
        while is_likely(outer):
            if sign * (outer - last) >= 0:
                return last
            inner, outer = outer, began + 2 * (outer - began)
        for _ in range(HALVINGS):
            middle = (inner + outer) / 2
            inner, outer = (middle, outer) if is_likely(middle) else (inner, middle)
        return inner

    return end(-1.0, float(times[0])), end(1.0, float(times[-1]))
