"""Settings of the whole test run: tests work in 64-bit, the package never sets it."""

import jax


jax.config.update("jax_enable_x64", True)
