"""Diagnosis: which physics a vessel's model lacks, with a name, a size and the evidence for it.

`verdict` goes from start to end, by stepwise `selection`. `score` linearises a fitted model and
tests candidates off its nuisances, `screening` makes the short list and says what could have been
seen, `localisation` says where the mismatch is and models what has no name; `hypotheses` come from
`refits`, and `decision` says which to believe; `bootstrap` simulates chance. `experiment` says what
to record next, and `record` writes it all as diagnosis.json. The room may import
identification and what lies below it; nothing here knows of reports or the command line.
"""

from diffsea.diagnosis.experiment import Experiment as Experiment
from diffsea.diagnosis.experiment import next_experiment as next_experiment
from diffsea.diagnosis.record import summary as summary
from diffsea.diagnosis.verdict import Diagnosis as Diagnosis
from diffsea.diagnosis.verdict import diagnose as diagnose
