"""`python -m diffsea`: the command line."""

import sys

from diffsea.cli import main


sys.exit(main())
