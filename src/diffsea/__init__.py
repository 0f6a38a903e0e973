"""Differentiable simulation, identification and diagnosis of surface vessels.

`import diffsea` loads nothing else and changes nothing. A public name is loaded when it is first
used; the first one that needs JAX sets 64-bit numbers and XLA's fast flags where JAX has not been
imported yet (see `diffsea.runtime`). The names stand in `__init__.pyi`, where editors and type
checkers find them too.
"""

import lazy_loader


_load, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

# Loaded without JAX: reading and auditing recordings starts at once.
_WITHOUT_JAX = frozenset(
    (
        "Finding", "Findings", "Mapping", "Outcome", "Trajectory", "UserError", "audit", "cut",
        "prepare_jax", "propose_mapping", "read_mapping", "read_recording", "repair", "resample",
        "write_recording",
    )
)  # fmt: skip


def __getattr__(name: str):
    if name in __all__ and name not in _WITHOUT_JAX:
        from diffsea.runtime import prepare_library

        prepare_library()
    return _load(name)
