"""Whether a program is being compiled just now, and how long compiling took, as JAX tells it.

A program that the cache of compiled programs holds is read from it and counts for nothing here.
"""

import sys
import threading
import time
from typing import Any


LOWERED = "/jax/core/compile/jaxpr_to_mlir_module_duration"  # what comes before compiling
CACHED = "/jax/compilation_cache/cache_hits"
COMPILED = "/jax/core/compile/backend_compile_duration"  # also where it came from the cache
NOTICED = 0.3  # s after which somebody who waits is told


class Compiling:
    """Programs that are compiled in this process, in all its threads.

    Attributes:
        programs: how many have been compiled.
        seconds: in which at least one was.
    """

    def __init__(self) -> None:
        self.programs, self.seconds = 0, 0.0
        self._begun: dict[int, float] = {}  # by thread
        self._counted_until = 0.0
        self._lock = threading.Lock()
        self._listens = False

    def listen(self) -> None:
        """Listen from now on, where JAX has been imported; a command that needs none starts none.

        To be called by the thread that imports it.
        """
        if "jax" in sys.modules and not self._listens:
            from jax import monitoring

            monitoring.register_event_listener(self.on_event)
            monitoring.register_event_duration_secs_listener(self.on_duration)
            self._listens = True

    @property
    def is_running(self) -> bool:
        """Whether a compilation goes on that somebody who waits has noticed."""
        now = time.monotonic()
        return any(now - begun > NOTICED for begun in tuple(self._begun.values()))

    @property
    def is_kept(self) -> bool:
        """Whether there is a cache that outlives this process."""
        jax = sys.modules.get("jax")
        return bool(jax is not None and jax.config.jax_compilation_cache_dir)

    def on_event(self, event: str, **_: Any) -> None:
        """What JAX tells of the cache."""
        if event == CACHED:
            self._begun.pop(threading.get_ident(), None)

    def on_duration(self, event: str, duration_secs: float, **_: Any) -> None:
        """What JAX tells of a step that has ended."""
        now, thread = time.monotonic(), threading.get_ident()
        if event == LOWERED:
            self._begun[thread] = now
        elif event == COMPILED and (begun := self._begun.pop(thread, None)) is not None:
            with self._lock:
                self.programs += 1
                self.seconds += now - max(begun, self._counted_until)
                self._counted_until = now


COMPILING = Compiling()
