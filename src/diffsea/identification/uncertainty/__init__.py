"""How far an estimate can be trusted: what data determine, intervals, what to record next."""

from diffsea.identification.uncertainty.design import NextManoeuvre as NextManoeuvre
from diffsea.identification.uncertainty.design import next_manoeuvre as next_manoeuvre
from diffsea.identification.uncertainty.identifiability import Identifiability as Identifiability
from diffsea.identification.uncertainty.identifiability import identifiability as identifiability
from diffsea.identification.uncertainty.identifiability import profile_interval as profile_interval
from diffsea.identification.uncertainty.sources import Source as Source
from diffsea.identification.uncertainty.sources import Sources as Sources
from diffsea.identification.uncertainty.sources import sources as sources
