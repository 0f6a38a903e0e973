"""Folders that tests read from."""

from pathlib import Path

from experiments.check_data import data_folder


TESTS = Path(__file__).resolve().parent
ROOT = TESTS.parent
ORACLE = TESTS / "oracle"
EXPERIMENTS = ROOT / "experiments"
DATA = data_folder()  # real recordings; tests that need them skip without
