"""Logs of robots and of MATLAB: many topics, each with a clock of its own, made one recording.

May import what recordings are made of (mappings, geodesy), and needs no JAX. The
packages that formats are read with are optional and imported when a log of theirs is.
"""

from diffsea.recordings.logs.reading import FORMATS as FORMATS
from diffsea.recordings.logs.reading import contents as contents
from diffsea.recordings.logs.reading import format_of as format_of
from diffsea.recordings.logs.reading import is_log as is_log
from diffsea.recordings.logs.reading import log_table as log_table
from diffsea.recordings.logs.reading import read_log as read_log
from diffsea.recordings.logs.streams import LogFormat as LogFormat
