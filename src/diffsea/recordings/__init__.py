"""Recordings of real or simulated runs: reading, judging and preparing them."""

from .mappings import Column as Column
from .mappings import Mapping as Mapping
from .mappings import read_mapping as read_mapping
from .readers import read_recording as read_recording
from .readers import write_recording as write_recording
