"""How JAX and the linear algebra of NumPy are set up: flags, precision, caches, threads."""

import functools
import gc
import importlib.metadata
import os
import pathlib
import sys
import warnings
from collections.abc import Callable
from typing import ParamSpec, TypeVar

from threadpoolctl import threadpool_limits


_prepared = False  # whether a script's set-up is done

P = ParamSpec("P")
R = TypeVar("R")

# The first is worth eight times on a single run, the second compiles a fit in three quarters of
# the time, the third a trial's derivatives in two thirds. The rest lets the compiler contract and
# reorder sums and products (a batch of trials 1.7 times as fast, fits and derivatives 1.5), while
# not-a-number, infinity, divisions and functions keep their meaning. None makes programs slower.
# Measured on the jaxlib named here; another one's XLA might end the process over an option that it
# lacks.
MEASURED_WITH = "0.10."
MEASURED_FLAG = "xla_cpu_small_while_loop_byte_threshold"  # the one worth most
CACHE_SETTING = "jax_compilation_cache_dir"
XLA_FLAGS = (
    "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=100000000,"
    "xla_cpu_disable_new_fusion_emitters,xla_cpu_flatten_after_fusion "
    "--xla_cpu_prefer_vector_width=512 --xla_cpu_enable_fast_math=true "
    "--xla_cpu_fast_math_honor_nans=true --xla_cpu_fast_math_honor_infs=true "
    "--xla_cpu_fast_math_honor_division=true --xla_cpu_fast_math_honor_functions=true"
)

# Compiler options of programs that run once or twice: compiled in two thirds of the time. Like the
# flags, of the jaxlib named above.
SELDOM_RUN = {"xla_backend_optimization_level": 0}


def one_blas_thread(function: Callable[P, R]) -> Callable[P, R]:
    """The function with one thread for BLAS while it runs.

    Matrices of some hundred rows gain nothing by more, and the threads wait for one another in
    loops: where other processes have work, too, an audit takes ten to twenty times as long.
    """

    @functools.wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        with threadpool_limits(1, user_api="blas"):
            return function(*args, **kwargs)

    return limited


def set_xla_flags() -> None:
    """The XLA flags above, before JAX starts; not over the user's own, nor for another jaxlib."""
    if are_flags_known():
        os.environ.setdefault("XLA_FLAGS", XLA_FLAGS)


def are_flags_known() -> bool:
    """Whether the installed jaxlib is one that the flags were measured with."""
    return importlib.metadata.version("jaxlib").startswith(MEASURED_WITH)


def prepare_library() -> None:
    """Set up JAX for a script: once, and only where that is left to the library.

    Where JAX has not been imported yet, 64-bit numbers and XLA's fast flags are set. Where it has,
    diffsea works with what it finds, and a warning says once what that costs. `DIFFSEA_SETUP=off`
    leaves everything alone.
    """
    global _prepared
    if _prepared or os.environ.get("DIFFSEA_SETUP", "").lower() == "off":
        return
    _prepared = True
    if "jax" not in sys.modules:
        set_xla_flags()
        os.environ.setdefault("JAX_ENABLE_X64", "1")
        return
    import jax

    lacking = []
    if not jax.config.read("jax_enable_x64"):
        lacking.append(
            "numbers have 32 bits, too few for fits, diagnoses and located switching "
            "(jax.config.update('jax_enable_x64', True) before anything is calculated)"
        )
    if MEASURED_FLAG not in os.environ.get("XLA_FLAGS", "") and are_flags_known():
        lacking.append(
            "XLA's flags are not diffsea's, so that a single run takes up to eight times as long "
            "(use a name of diffsea, or call diffsea.prepare_jax(), before JAX is imported)"
        )
    if lacking:
        warnings.warn(f"JAX was imported before diffsea: {'; '.join(lacking)}", stacklevel=3)


def prepare_jax() -> None:
    """XLA flags, 64-bit numbers, rarer garbage collection, a cache that outlives the command.

    Does not start JAX, which takes a second: where it has not started yet, it finds the settings
    in its environment variables when it does.
    """
    if "jax" not in sys.modules:
        set_xla_flags()
        os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")  # XLA's remarks on slow compiling
    # Tracing a program makes many objects that stay: looking through them took a third of its time.
    gc.set_threshold(100_000, 20, 100)
    settings: dict[str, bool | float | str] = {"jax_enable_x64": True}
    jax = sys.modules.get("jax")
    chosen = jax.config.jax_compilation_cache_dir if jax else os.environ.get(CACHE_SETTING.upper())
    if not chosen and (cache := _cache_folder()):
        settings |= {CACHE_SETTING: str(cache), "jax_persistent_cache_min_compile_time_secs": 0.0}
    for name, value in settings.items():
        if jax:
            jax.config.update(name, value)
        else:
            os.environ[name.upper()] = str(value)


def _cache_folder() -> pathlib.Path | None:
    """The user's cache folder, None where it cannot be written."""
    base = os.environ.get("XDG_CACHE_HOME")
    try:
        folder = (pathlib.Path(base) if base else pathlib.Path.home() / ".cache") / "diffsea"
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):  # no home, or one that cannot be written
        return None
    return folder if os.access(folder, os.W_OK) else None
