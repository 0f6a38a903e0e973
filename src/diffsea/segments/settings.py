"""What the finding of trials takes for granted, in one place."""

import dataclasses
import math

from diffsea.errors import UserError


@dataclasses.dataclass(frozen=True)
class SegmentSettings:
    """Thresholds that no statistic of the recording can give. Angles in rad.

    Times follow from one of the vessel's own, the `window`: as long as it takes to turn by 90
    deg at the fastest rate that the recording shows.

    Raises `UserError` for any that is not above zero.
    """

    window: float | None = None  # s; None takes it from the recording
    turning_share: float = 1 / 15  # of the fastest yaw rate: 6 deg per window is turning
    averaging: float = 1 / 3  # windows over which yaw rate is averaged to find turning
    merging: float = 1.0  # windows; turning motions nearer than this are one
    least_turn: float = math.radians(20)  # change of heading that makes a turning motion
    circle: float = math.radians(120)  # change of heading under one order that makes a trial
    legs: int = 3  # alternating orders that make a zig-zag
    reversal: float = math.radians(3)  # heading at its reversals, on average, to be one
    holding: float = 1 / 20  # windows that the steering must stay to count as held
    piece: float = 0.25  # windows: straight runs, coasting and rest that are shorter do not count
    order: float = math.radians(2)  # smaller angles are no order
    still: float = 0.1  # of the fastest speed: slower is on station
    idle: float = 0.05  # of the largest push: less is none
    steady_speed: float = 0.05  # of the speed, may be gained or lost, or scatter, in an approach
    steady_heading: float = math.radians(2)  # the heading may wander in an approach
    alike: float = 0.15  # relative difference of order and speed among repeats

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if value is not None and not (math.isfinite(value) and value > 0):
                raise UserError(f"{field.name} must be above zero, not {value}")

    @property
    def seconds(self) -> float:
        """The window (s), which must be known by now, see `with_window`."""
        assert self.window is not None
        return self.window
