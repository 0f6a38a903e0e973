"""The audit of several recordings as one set: what one cannot tell, others made alike may.

Runs of a set need not be of one convention: a logger is set up anew between two days. Each is
judged by itself; only where it cannot tell, and all others that can agree, does it take what they
tell.
"""

from collections.abc import Hashable, Sequence

import numpy as np

from diffsea.recordings.auditing.audit import audit, cleaned_motion
from diffsea.recordings.auditing.axes import axes_evidence
from diffsea.recordings.auditing.finding import Finding
from diffsea.recordings.auditing.kinematics.selection import SIGNIFICANCE
from diffsea.recordings.mappings import native_channels
from diffsea.runtime import one_blas_thread
from diffsea.trajectory import Trajectory


@one_blas_thread
def audit_set(runs: Sequence[Trajectory], level: float = SIGNIFICANCE) -> list[list[Finding]]:
    """What is wrong with each recording of a set, judged together and apart; see `audit`.

    The axes of velocities are told by the runs of the same channels together.
    """
    if len(runs) < 2:
        return [audit(run, level) for run in runs]
    told = [axes_evidence(cleaned_motion(run)[0]) for run in runs]
    made = [_made(run) for run in runs]
    return [
        audit(run, level, [told[j] for j in range(len(runs)) if j != i and made[j] == made[i]])
        for i, run in enumerate(runs)
    ]


def _made(run: Trajectory) -> Hashable:
    """What runs have in common that were recorded alike: the channels that have samples."""
    channels = native_channels(run)
    return frozenset(name for name, series in channels.items() if np.any(np.isfinite(series)))
