"""Benchmarks: measured in turns with their references, kept in results.json and the README.

    python -m benchmarks.run [engine] [jacobian] [fit] [diagnosis] [sweep] [startup]
                             [closed-loop] [envs] [growth] [commands] [scale] [gpu]

Without a part, all of them, each below ten minutes. A part replaces only its own figures.
"""

import argparse
import importlib
import sys
import time

from benchmarks.record import keep


PARTS = {
    "engine": "engine", "jacobian": "derivatives", "fit": "fits", "diagnosis": "diagnoses",
    "sweep": "sweeps", "closed-loop": "closed_loops", "envs": "envs", "startup": "startup",
    "growth": "growth", "commands": "commands", "scale": "scale", "gpu": "gpu",
}  # fmt: skip


def main() -> None:
    """Measure the parts that are named."""
    parser = argparse.ArgumentParser(description=str(__doc__).splitlines()[0])
    parser.add_argument("parts", nargs="*", metavar="PART", help=f"of {', '.join(PARTS)}")
    parts = parser.parse_args().parts or list(PARTS)
    if unknown := [part for part in parts if part not in PARTS]:
        parser.error(f"there is no part {unknown[0]!r}: choose among {', '.join(PARTS)}")
    for part in parts:
        began = time.monotonic()
        print(f"{part} ...", file=sys.stderr, flush=True)
        figures = importlib.import_module(f"benchmarks.{PARTS[part]}").measure()
        keep(figures)
        for figure in figures:
            told = figure.as_dict()
            ratio = "" if told["ratio"] is None else f", ratio {told['ratio']:.2f}"
            print(f"  {figure.name}: {told['value']:.3g} {figure.unit}{ratio}", flush=True)
        print(f"  {time.monotonic() - began:.0f} s", file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
