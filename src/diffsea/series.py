"""Angles in recordings: made continuous without hiding that one is in degrees."""

import numpy as np


def unwrap(angle: np.ndarray) -> np.ndarray:
    """The angle (rad) without jumps of a turn, continued through missing samples.

    An angle that is really in degrees is unwrapped as such: by turns of 2 pi it would be
    garbled beyond repair, and the audit would no longer see what is wrong with it.
    """
    finite = np.isfinite(angle)
    continuous = np.array(angle, dtype=float)
    period = _period(continuous[finite])
    if period > 0:
        continuous[finite] = np.unwrap(continuous[finite], period=period)
    return continuous


def _period(angle: np.ndarray) -> float:
    """The jump that a wrapped angle makes: 2 pi, or 360; zero where it is not wrapped."""
    if angle.size < 2 or np.max(np.abs(angle)) <= 4 * np.pi:
        return 2 * np.pi
    jumps = np.abs(np.diff(angle))
    if np.any(jumps > 300):
        return 360.0
    return 2 * np.pi if np.any(np.abs(jumps - 2 * np.pi) < 1) else 0.0
