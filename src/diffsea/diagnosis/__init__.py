"""Diagnosis: which physics a vessel's model lacks, with a name, a size and the evidence for it.

`search` goes from start to end. `jacobians` linearises a fitted model, `score` tests candidates off
its nuisances, `screening` makes the short list and says what could have been seen, and
`localisation` where the mismatch is; `refit`, `constancy` and `decision` weigh hypotheses;
`bootstrap` simulates chance. `unexplained` models what has no name, `experiment` says which
manoeuvre to record next, and `record` writes it all as diagnosis.json. The room may import
identification and what lies below it; nothing here knows of reports or the command line.
"""

from diffsea.diagnosis.experiment import Experiment as Experiment
from diffsea.diagnosis.experiment import next_experiment as next_experiment
from diffsea.diagnosis.record import summary as summary
from diffsea.diagnosis.search import Diagnosis as Diagnosis
from diffsea.diagnosis.search import diagnose as diagnose
