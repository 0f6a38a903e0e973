"""At which frequencies a wave train may be: peaks in the spectrum of the filter's latent force."""

import numpy as np
from jaxtyping import Float

from diffsea.diagnosis.columns import latent_acceleration
from diffsea.identification.estimates import Estimate
from diffsea.identification.problem import Problem


PEAKS = 4
TOGETHER = 2.0  # times the longest run: clocks of runs that lie within it begin together
NEIGHBOURS = 40  # frequencies around one whose median is what gusts alone show


def peaks(problem: Problem, fitted: Estimate) -> tuple[Float[np.ndarray, "peak"], float]:
    """The most prominent frequencies (Hz) common to all runs, and the resolution of the data.

    Earth-fixed components of the lasting gusts that the filter finds, relative to the median of the
    spectrum around each frequency. Runs whose clocks begin together keep a common phase; of others,
    powers are added.
    """
    tape = problem.tape
    push = latent_acceleration(problem, fitted)
    psi = np.asarray(problem.tuned(fitted.coordinates, fitted.noise).state)[:, 2]
    t, dt = np.asarray(tape.run_time), np.asarray(tape.dt)
    rows = np.asarray(tape.known).any(1) & (dt > 0)
    force = (push[:, 0] + 1j * push[:, 1]) * np.exp(1j * psi)
    force, t, dt = force[rows], t[rows], dt[rows]
    run = np.asarray(tape.run)[rows]
    inside = [run == number for number in np.unique(run)]
    longest = max(float(np.ptp(t[own])) for own in inside)
    if np.ptp(t) < TOGETHER * longest:
        inside = [np.ones(len(t), bool)]
    resolution = 0.5 / max(longest, 1e-9)
    grid = np.arange(4 * resolution, 0.25 / float(np.median(dt)), resolution)
    if len(grid) < 8 or not np.isfinite(force).all():
        return np.zeros(0), resolution
    force = force - force.mean()
    power = np.zeros(len(grid))
    for own in inside:
        wave = np.exp(-2j * np.pi * grid[:, None] * t[own]) * dt[own]
        # North and east are real and imaginary: the power of both is that at f and at -f.
        power += np.abs(wave @ force[own]) ** 2 + np.abs(wave.conj() @ force[own]) ** 2
    around = [
        np.median(power[max(0, k - NEIGHBOURS // 2) : k + NEIGHBOURS // 2 + 1])
        for k in range(len(grid))
    ]
    relative = power / np.maximum(around, 1e-300)
    inner = relative[1:-1]
    high = 1 + np.flatnonzero((inner >= relative[:-2]) & (inner >= relative[2:]))
    return grid[high[np.argsort(-relative[high])][:PEAKS]], resolution
