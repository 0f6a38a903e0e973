"""What a log shows by itself, without a vessel: answers to orders, trials, open questions.

Above recordings and segments, below diagnosis: it knows orders and motion, not forces.
"""

from diffsea.checks.answers import Answers as Answers
from diffsea.checks.log_check import LogCheck as LogCheck
from diffsea.checks.log_check import check_run as check_run
from diffsea.checks.pooled import PooledCheck as PooledCheck
from diffsea.checks.pooled import check_together as check_together
