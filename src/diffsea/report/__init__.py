"""What people read: pages of diagnoses and fits, still pictures of commands, results in words.

Above everything but the command line, it may import all other rooms; none imports it but the
command line. Only what is light is exported here: numbers and words. Pages come with Plotly
(`diffsea.report.diagnosis`, `diffsea.report.fit`), pictures with Matplotlib
(`diffsea.report.pictures`), and both with JAX.
"""

from diffsea.report.quantities import duration as duration
from diffsea.report.quantities import interval as interval
from diffsea.report.quantities import odds as odds
from diffsea.report.quantities import probability as probability
from diffsea.report.quantities import significant as significant
from diffsea.report.quantities import with_error as with_error
