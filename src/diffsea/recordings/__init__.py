"""Recordings of real or simulated runs: reading, judging and preparing them.

May import the trajectory, its series, statistics and errors. Needs no JAX: a recording is read
and audited before JAX has started.
"""

from diffsea.recordings.auditing.audit import audit as audit
from diffsea.recordings.auditing.finding import KINDS as KINDS
from diffsea.recordings.auditing.finding import MAPPING_KINDS as MAPPING_KINDS
from diffsea.recordings.auditing.finding import Finding as Finding
from diffsea.recordings.auditing.finding import unreadable as unreadable
from diffsea.recordings.auditing.sets import audit_set as audit_set
from diffsea.recordings.conditioning import cut as cut
from diffsea.recordings.conditioning import resample as resample
from diffsea.recordings.conditioning import thin as thin
from diffsea.recordings.mappings import Column as Column
from diffsea.recordings.mappings import Mapping as Mapping
from diffsea.recordings.mappings import read_mapping as read_mapping
from diffsea.recordings.readers import read_recording as read_recording
from diffsea.recordings.readers import to_frame as to_frame
from diffsea.recordings.readers import write_recording as write_recording
