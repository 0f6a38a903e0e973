"""Logs of robots and of MATLAB: many topics, each with a clock of its own, made one recording."""

from diffsea.recordings.logs.reading import contents as contents
from diffsea.recordings.logs.reading import is_log as is_log
from diffsea.recordings.logs.reading import read_log as read_log
