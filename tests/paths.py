"""Folders that tests read from."""

from pathlib import Path


TESTS = Path(__file__).resolve().parent
ROOT = TESTS.parent
ORACLE = TESTS / "oracle"
EXPERIMENTS = ROOT / "experiments"
DATA = ROOT.parent / "shared" / "data"  # real recordings; tests that need them skip without
