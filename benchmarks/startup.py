"""What the command needs before it does anything."""

import subprocess
import sys

from benchmarks.record import Figure, in_turns


def measure() -> list[Figure]:
    """`diffsea --help`, beside a Python that does nothing."""
    command = [sys.executable, "-m", "diffsea", "--help"]
    ours = lambda: subprocess.run(command, check=True, capture_output=True)
    python = lambda: subprocess.run([sys.executable, "-c", "pass"], check=True)
    mine, bare = in_turns(ours, python)
    return [Figure("startup", "s", mine, bare, "python alone")]
