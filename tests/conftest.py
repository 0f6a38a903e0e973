"""Settings of the test run: those of the command line, so that compiled programs are shared."""

from diffsea.cli import prepare_jax


prepare_jax()
