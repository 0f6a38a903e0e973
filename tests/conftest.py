"""Settings of the test run: those of the command line, so that compiled programs are shared."""

import pytest

from diffsea.runtime import prepare_jax


prepare_jax()  # before jax is imported, or its XLA flags would come too late

import jax  # isort: skip


@pytest.fixture(scope="module", autouse=True)
def forget_compiled():
    """Compiled programs end with their module: LLVM crashes where a process maps too many."""
    yield
    jax.clear_caches()


@pytest.fixture(scope="module")
def own_cache(tmp_path_factory):
    """A cache of compiled programs that ends with the module."""
    patch = pytest.MonkeyPatch()
    patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
    before = jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]
    yield
    patch.undo()
    jax.config.update("jax_compilation_cache_dir", before)
