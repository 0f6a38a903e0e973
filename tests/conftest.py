"""Settings of the test run: 64-bit, and the XLA flags that the command line sets."""

import os

from diffsea.cli import XLA_FLAGS


os.environ.setdefault("XLA_FLAGS", XLA_FLAGS)

import jax


jax.config.update("jax_enable_x64", True)
