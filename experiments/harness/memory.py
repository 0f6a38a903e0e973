"""Largest memory of a process."""

import re
import resource
import sys
from pathlib import Path


STATUS = Path("/proc/self/status")


def peak_memory() -> float:
    """Largest resident memory of this program so far, GiB.

    Linux's `ru_maxrss` starts from the memory of whatever started the program, so the kernel's
    count for the program alone is read where there is one.
    """
    if STATUS.exists() and (peak := re.search(r"VmHWM:\s+(\d+) kB", STATUS.read_text())):
        return int(peak[1]) / 2**20
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most / (2**30 if sys.platform == "darwin" else 2**20)
