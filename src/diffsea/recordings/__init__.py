"""Recordings of real or simulated runs: reading, judging and preparing them."""

from .audit import audit as audit
from .conditioning import cut as cut
from .conditioning import resample as resample
from .conditioning import split as split
from .conditioning import typical_interval as typical_interval
from .finding import KINDS as KINDS
from .finding import Finding as Finding
from .mappings import Column as Column
from .mappings import Mapping as Mapping
from .mappings import read_mapping as read_mapping
from .readers import read_recording as read_recording
from .readers import write_recording as write_recording
