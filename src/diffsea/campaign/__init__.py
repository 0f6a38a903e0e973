"""Sea-trial campaigns: trials found in long recordings, traced and made ready to identify."""

from diffsea.campaign.approach import Approach as Approach
from diffsea.campaign.export import cut_out as cut_out
from diffsea.campaign.export import export as export
from diffsea.campaign.groups import grouped as grouped
from diffsea.campaign.places import by_place as by_place
from diffsea.campaign.segments import SEGMENT_KINDS as SEGMENT_KINDS
from diffsea.campaign.segments import Segment as Segment
from diffsea.campaign.segments import segments as segments
from diffsea.campaign.settings import Settings as Settings
from diffsea.campaign.traceability import Check as Check
from diffsea.campaign.traceability import traceability as traceability
