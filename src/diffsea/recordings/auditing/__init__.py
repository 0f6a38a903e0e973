"""Whether a recording is consistent with itself, and what to do where it is not.

`audit` names the faults of labels, units, frames, signs, clocks and sensors, each with a size, an
error and a repair; `audit_set` those of several recordings, judged together; `findings.toml` has
what is said of them. `repair` (imported from its module) makes those repairs that are certain. The
room rests on NumPy and SciPy, the reading of recordings and the statistics, and never on JAX.
"""

from diffsea.recordings.auditing.audit import audit as audit
from diffsea.recordings.auditing.finding import KINDS as KINDS
from diffsea.recordings.auditing.finding import Finding as Finding
from diffsea.recordings.auditing.sets import audit_set as audit_set
