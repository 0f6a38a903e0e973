"""Sea-trial campaigns: trials found in long recordings, traced and made ready to identify.

The room knows orders and motion, not forces: it imports recordings, metrics and the servos of a
vessel, and JAX with them, but nothing of identification.
"""

from diffsea.segments.export import cut_out as cut_out
from diffsea.segments.export import export as export
from diffsea.segments.places import by_place as by_place
from diffsea.segments.segments import SEGMENT_KINDS as SEGMENT_KINDS
from diffsea.segments.segments import Segment as Segment
from diffsea.segments.segments import find_segments as find_segments
from diffsea.segments.segments import group_repeats as group_repeats
from diffsea.segments.spans import ApproachConditions as ApproachConditions
from diffsea.segments.spans import SegmentSettings as SegmentSettings
from diffsea.segments.traceability import Check as Check
from diffsea.segments.traceability import traceability as traceability
