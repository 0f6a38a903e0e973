"""Logs that are known: mappings of their formats as data, chosen by what a log contains.

A layout, a TOML file of `layouts/`, lists where each group of channels may stand, best first; the
first whose topics and fields are all in the log becomes part of the mapping. May import the
formats of logs and the repair's text of mappings. Needs no JAX.
"""

from diffsea.recordings.known.outputs import Output as Output
from diffsea.recordings.known.recognition import Recognised as Recognised
from diffsea.recordings.known.recognition import recognise as recognise
