"""Figures of benchmarks: measured in turns, kept in results.json, shown in the README's table."""

import dataclasses
import json
import os
import platform
import re
import statistics
import time
from collections.abc import Callable
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any


HERE = Path(__file__).resolve().parent
RESULTS, README = HERE / "results.json", HERE / "README.md"
UNIT = "vessel-steps/s"
PACKAGES = (
    "jax", "jaxlib", "equinox", "optimistix", "numpy", "scipy", "casadi", "numba", "diffrax",
    "shipmmg",
)  # fmt: skip


@dataclasses.dataclass(frozen=True)
class Figure:
    """One measured number beside that of its reference.

    Attributes:
        samples: ours, in `unit`; a speed where that is "per s", else a time.
        reference: samples of the reference, taken in turns with ours; none without one.
        against: what the reference is, in words.
        more: what else results.json is to have of it.
    """

    name: str
    unit: str
    samples: list[float]
    reference: list[float] = dataclasses.field(default_factory=list)
    against: str = ""
    more: dict[str, Any] = dataclasses.field(default_factory=dict)

    @property
    def ratio(self) -> float | None:
        """Ours over the reference's for speeds, the reverse for times: above one is better.

        The median of the ratios of neighbours, which the load of the machine changes alike.
        """
        if not self.reference:
            return None
        pairs = zip(self.samples, self.reference, strict=True)
        fast = self.unit.endswith("/s")
        return statistics.median(a / b if fast else b / a for a, b in pairs)

    def as_dict(self) -> dict[str, Any]:
        """As results.json has it."""
        return {
            "name": self.name,
            "value": statistics.median(self.samples),
            "unit": self.unit,
            "reference": statistics.median(self.reference) if self.reference else None,
            "ratio": self.ratio,
            "samples": self.samples,
            "reference_samples": self.reference,
            "against": self.against,
            **self.more,
        }


def seconds(work: Callable[[], object]) -> float:
    """How long it takes."""
    began = time.perf_counter()
    work()
    return time.perf_counter() - began


def in_turns(
    ours: Callable[[], object], other: Callable[[], object], times: int = 7
) -> tuple[list[float], list[float]]:
    """Seconds of both, one after the other so many times, a first time of each left out."""
    for work in (ours, other):
        work()
    pairs = [(seconds(ours), seconds(other)) for _ in range(times)]
    return [a for a, _ in pairs], [b for _, b in pairs]


def keep(figures: list[Figure]) -> None:
    """Put figures into results.json in place of those of the same names, and into the README."""
    earlier = json.loads(RESULTS.read_text(encoding="utf-8")) if RESULTS.exists() else {}
    kept: list[dict[str, Any]] = earlier.get("figures", [])
    new = [figure.as_dict() for figure in figures]
    names = {figure["name"] for figure in new}
    kept = [figure for figure in kept if figure["name"] not in names] + new
    elsewhere = all("device" in figure for figure in new)  # a lent card's figures name it
    at = earlier["machine"] if elsewhere and earlier else machine()
    record = {"machine": at, "figures": kept}
    RESULTS.write_text(json.dumps(_rounded(record), indent=1) + "\n", encoding="utf-8")
    write_table()


def write_table() -> None:
    """The README's table, from results.json."""
    record = json.loads(RESULTS.read_text(encoding="utf-8"))
    text = README.read_text(encoding="utf-8")
    for place, body in {"figures": table(record), "stages": stage_table(record)}.items():
        begin, end = f"<!-- {place} -->", f"<!-- end of {place} -->"
        pattern = re.compile(f"{begin}.*{end}", re.DOTALL)
        whole = f"{begin}\n{body}\n{end}"
        text = pattern.sub(lambda _, whole=whole: whole, text)
    README.write_text(text, encoding="utf-8")


def stage_table(record: dict[str, Any]) -> str:
    """Seconds of the stages of each figure that has some, a column each, as Markdown."""
    staged = {f["name"]: f["stages"] for f in record["figures"] if "stages" in f}
    stages = dict.fromkeys(stage for own in staged.values() for stage in own)
    rows = [[stage, *(f"{own.get(stage, 0.0):.1f}" for own in staged.values())] for stage in stages]
    lines = [["stage, s", *staged], ["---"] * (1 + len(staged)), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def table(record: dict[str, Any]) -> str:
    """Machine and figures as Markdown."""
    at = record["machine"]
    lines = [
        f"{at['processor']}, {at['cores']} cores, {at['system']}, Python {at['python']}, "
        + ", ".join(f"{name} {number}" for name, number in at["packages"].items())
        + ".",
        "",
        "| figure | median | least to most | reference | ratio |",
        "| --- | --- | --- | --- | --- |",
    ]
    for one in record["figures"]:
        spread = f"{min(one['samples']):.3g} to {max(one['samples']):.3g}"
        beside = "-" if one["reference"] is None else f"{one['reference']:.3g}, {one['against']}"
        if "device" in one:
            beside += f" ({one['device']})"
        if "interval" in one:
            beside = "95 %: {:.2f} to {:.2f}".format(*one["interval"])
        ratio = "-" if one["ratio"] is None else f"{one['ratio']:.2f}"
        lines.append(
            f"| {one['name']} | {one['value']:.3g} {one['unit']} | {spread} | {beside} | {ratio} |"
        )
    return "\n".join(lines)


def machine() -> dict[str, Any]:
    """What the figures were measured on."""
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "system": platform.system(),
        "python": platform.python_version(),
        "packages": {name: version(name) for name in PACKAGES if find_spec(name)},
    }


def _processor() -> str:
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        return platform.processor() or platform.machine()
    found = re.search(r"model name\s*:\s*(.+)", text)
    wide = "AVX-512" if "avx512f" in text else "AVX2" if "avx2" in text else "no AVX2"
    return f"{found[1].strip() if found else platform.machine()} ({wide})"


def _rounded(value: Any) -> Any:
    """Numbers with five digits."""
    if isinstance(value, dict):
        return {key: _rounded(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_rounded(entry) for entry in value]
    return float(f"{value:.5g}") if isinstance(value, float) else value
