"""Central finite differences beside exact derivatives, at many step sizes."""

from experiments.overshoot_sensitivity.trial_lanes import Bench

import numpy as np
from jaxtyping import Float


STEPS = 10.0 ** -np.arange(1.0, 10.5, 0.5)  # of ln p


def central(
    bench: Bench, trial: int, chosen: list[int], steps: Float[np.ndarray, "step"]
) -> Float[np.ndarray, "step chosen number"]:
    """d number / d ln factor by (f(+h) - f(-h)) / 2 h for every step h."""
    count = len(bench.factors)
    units = np.eye(count)[chosen]
    points = np.concatenate([sign * h * units for h in steps for sign in (1.0, -1.0)], axis=0)
    value = bench.run(points, None, trial).value
    value = value.reshape(len(steps), 2, len(chosen), -1)
    return (value[:, 0] - value[:, 1]) / (2 * np.asarray(steps)[:, None, None])


def errors(
    approximate: Float[np.ndarray, "step chosen number"],
    exact: Float[np.ndarray, "chosen number"],
) -> Float[np.ndarray, "step chosen number"]:
    """Errors relative to the largest exact derivative of the same number."""
    scale = np.nanmax(np.abs(exact), axis=0)
    return np.abs(approximate - exact) / np.where(scale > 0, scale, 1.0)


def best(steps: Float[np.ndarray, "step"], error: Float[np.ndarray, "step chosen"]) -> dict:
    """The step with the smallest median error, and that error beside those of other steps."""
    middle = np.median(error, axis=1)
    k = int(np.argmin(middle))
    return {
        "best_step": float(steps[k]),
        "median_error_at_best": float(middle[k]),
        "worst_error_at_best": float(error[k].max()),
        "steps": steps.tolist(),
        "median_error": middle.tolist(),
        "worst_error": error.max(axis=1).tolist(),
    }


def order(steps: Float[np.ndarray, "step"], error: Float[np.ndarray, "step"]) -> float:
    """Power of the step with which an error falls, where neither limits nor rounding matter yet."""
    small = (steps < 5e-3) & (steps > 2e-4)
    return float(np.polyfit(np.log(steps[small]), np.log(error[small]), 1)[0])
