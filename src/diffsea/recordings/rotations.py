"""Orientations as logs have them: quaternions by four fields, and the angles that they are."""

import re
import warnings
from collections.abc import Iterable, Mapping

import numpy as np
from jaxtyping import Float

from diffsea.trajectory import Samples


ANGLES = ("roll", "pitch", "yaw")
# What is before the part: anything up to a mark (`orientation.w`), or a q (`imu_qw`); of numbered
# parts, the first of which is w, a q alone (`q[0]`, `q_d.0`).
_LAST_OF_LETTERS = re.compile(r"(.*(?:[._/: ]|(?<![A-Za-z])q|quat))(w)()", re.IGNORECASE)
_LAST_OF_NUMBERS = re.compile(r"((?:.*[._/: ])?q(?:_\w+)?[.\[])(3)(\]?)")


def quaternions_in(names: Iterable[str]) -> dict[str, tuple[str, str, str, str]]:
    """The names of w, x, y and z of every quaternion, by what its angles' names begin with."""
    known, found = frozenset(names), {}
    for name in names:
        letters, numbers = _LAST_OF_LETTERS.fullmatch(name), _LAST_OF_NUMBERS.fullmatch(name)
        whole = letters or numbers
        if whole is None:
            continue
        start, part, end = whole.groups()
        places = ("WXYZ" if part.isupper() else "wxyz") if letters else "0123"
        w, x, y, z = (f"{start}{place}{end}" for place in places)
        if known.issuperset((w, x, y, z)):
            found[_start_of_angles(start)] = w, x, y, z
    return found


def _start_of_angles(start: str) -> str:
    """`pose.orientation.` of its parts, `q.` of `q[`, and `imu_q_` of `imu_qw`."""
    start = start.replace("[", ".")
    return start if re.search(r"\W$|_$", start) else f"{start}_"


def angles_in(fields: Mapping[str, Samples]) -> dict[str, Float[np.ndarray, "time"]]:
    """Roll, pitch and yaw (rad) of every quaternion among fields, by their names."""
    found = {}
    for start, parts in quaternions_in(fields).items():
        angles = euler_angles(*(fields[part] for part in parts))
        found |= {f"{start}{name}": angles[name] for name in ANGLES}
    return found


def euler_angles(
    w: Samples, x: Samples, y: Samples, z: Samples
) -> dict[str, Float[np.ndarray, "time"]]:
    """Roll, pitch and yaw (rad) of rotations given by quaternions of any length above zero.

    The rotation is yaw about z, then pitch about the new y, then roll about the new x, as in
    Fossen's handbook, (2.58); frames are those of the message. NaN for a quaternion of zeros.
    """
    from scipy.spatial.transform import Rotation  # a fifth of a second, for logs alone

    quaternions = np.stack([x, y, z, w], axis=-1).astype(float)
    angles = np.full((len(quaternions), 3), np.nan)
    length = np.linalg.norm(quaternions, axis=-1)
    turned = (length > 0) & np.isfinite(length)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # bow straight up: roll is taken as zero
        if turned.any():
            angles[turned] = Rotation.from_quat(quaternions[turned]).as_euler("ZYX")
    return dict(zip(("yaw", "pitch", "roll"), angles.T, strict=True))
