"""Displacements against integrated velocities: scales, nuisances, what is left unexplained."""

import math

import numpy as np


_FINEST = 1e-5  # share of squared displacement that is never explained


def shares_left(moved: np.ndarray, flow: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Shares of squared displacement (R, F) left by the best positive scale, and the scales."""
    cross = np.maximum(np.real(moved @ np.conj(flow).T), 0.0)
    power = np.sum(np.abs(flow) ** 2, axis=1)[None]
    total = np.sum(np.abs(moved) ** 2, axis=1)[:, None]
    scale = cross / np.maximum(power, 1e-300)
    return 1 - cross * scale / np.maximum(total, 1e-300), scale


def ridge(
    moved: np.ndarray, flow: np.ndarray, causes: list[np.ndarray]
) -> tuple[np.ndarray, float, float]:
    """Residuals (W,), penalty and scale of displacements explained by a flow and nuisances.

    Each nuisance is held to its size as a prior does, relative to residuals whose variance is
    estimated in turn. The scale is NaN, and nothing explained, where it would not be positive.
    """
    columns = [flow, *causes]
    matrix = np.stack([np.concatenate([c.real, c.imag]) for c in columns], axis=1)
    target = np.concatenate([moved.real, moved.imag])
    total = float(target @ target)
    # Nuisances are in the numbers of the velocities: they go with the scale.
    crude = float(matrix[:, 0] @ target) / max(float(matrix[:, 0] @ matrix[:, 0]), 1e-300)
    if crude <= 0:
        return moved, 0.0, math.nan
    matrix[:, 1:] *= crude
    variance, solution, rest = total / target.size, np.zeros(len(columns)), target
    for _ in range(6):
        held = np.diag([0.0, *([variance] * len(causes))])
        solution = np.linalg.lstsq(matrix.T @ matrix + held, matrix.T @ target, rcond=None)[0]
        rest = target - matrix @ solution
        variance = max(float(rest @ rest), _FINEST * total) / target.size
    if solution[0] <= 0:
        return moved, 0.0, math.nan
    half = moved.size
    penalty = variance * float(solution[1:] @ solution[1:])
    return rest[:half] + 1j * rest[half:], penalty, float(solution[0])


def component_shares(moved: np.ndarray, rest: np.ndarray, penalty: float) -> tuple[float, float]:
    """Shares left along x and y, each with half of the penalty."""
    return tuple(
        min(max((np.sum(b**2) + 0.5 * penalty) / max(np.sum(a**2), 1e-300), _FINEST), 1.0)
        for a, b in ((moved.real, rest.real), (moved.imag, rest.imag))
    )


def correlation(a: np.ndarray, b: np.ndarray) -> float:
    spread = float(np.std(a) * np.std(b))
    return float(np.mean((a - a.mean()) * (b - b.mean())) / spread) if spread > 0 else 0.0
