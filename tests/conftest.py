"""Settings of the test run: those of the command line, and stricter.

Shape annotations are checked while tests run, dtypes are promoted strictly, and warnings are
errors (`pyproject.toml`).
"""

import pytest
from jaxtyping import install_import_hook

from diffsea.runtime import prepare_jax


prepare_jax()  # before jax is imported, or its XLA flags would come too late
install_import_hook("diffsea", "tests.shapes.check_shapes")

import jax  # isort: skip
import tests.shapes  # noqa: F401  isort: skip  the hook finds it by name


jax.config.update("jax_numpy_dtype_promotion", "strict")
# Single operations are compiled by the hundred: once for all files and both workers.
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


def pytest_collection_modifyitems(items):
    """Files with slow tests first: two workers then have something to do until the end."""
    is_slow = lambda item: any(item.get_closest_marker(name) for name in ("slow", "experiment"))
    slow = {item.path for item in items if is_slow(item)}
    items.sort(key=lambda item: item.path not in slow)


@pytest.fixture(scope="module", autouse=True)
def forget_compiled(request):
    """Compiled programs end with their module: LLVM crashes where a process maps too many."""
    seldom_run = request.node.get_closest_marker("compiles") is not None
    jax.config.update("jax_disable_most_optimizations", seldom_run)
    yield
    jax.config.update("jax_disable_most_optimizations", False)
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
