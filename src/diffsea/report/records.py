"""Parts that every report has: fitted parameters, and where a result comes from."""

import importlib.metadata
import math
import platform
from collections.abc import Sequence

from diffsea.report import words as words
from diffsea.report.page import (
    Html,
    element,
    folded,
    joined,
    pairs,
    section,
    table,
    verbatim,
)
from diffsea.report.quantities import rounded, with_error
from diffsea.trajectory import Trajectory


_OWN = ("recordings", "versions", "python")  # told in a form of their own


def parameter_table(rows: Sequence[dict]) -> Html:
    """Fitted parameters with errors and where they come from."""
    cells = [
        [
            verbatim(row["name"]),
            row["meaning"],
            rounded(row["start"]),
            with_error(row["value"], row["std"]),
            _interval(row),
            row["unit"],
            _determined(row["determined"]),
        ]
        for row in rows
    ]
    columns = ["symbol", "name", "start", "estimate", "90 % interval", "unit", "determined by"]
    title = "Fitted with everything else in the model; +- is one standard error"
    return table(columns, cells, title, numeric=(2, 3, 4))


def _interval(row: dict) -> str:
    low, high = (_end(value, row["std"]) for value in row["interval"])
    return f"{low} to {high}"


def _end(value: float, std: float) -> str:
    return rounded(value, 0.3 * std) if math.isfinite(value) else "open"


def _determined(share: float) -> str:
    """How much of an estimate the data determine, in words."""
    percent = f"{100 * share:.0f} %"
    if share > 0.9:
        return f"the data ({percent})"
    if share > 0.5:
        return f"data and vessel file ({percent} data)"
    return f"mostly the vessel file ({percent} data)"


def provenance(source: dict, runs: Sequence[tuple[Trajectory, str]]) -> Html:
    """Versions, settings, files and what was done to each recording."""
    rows = [(words.title(key), _shown(value)) for key, value in source.items() if key not in _OWN]
    rows.append(("software", verbatim(", ".join(_software(source)))))
    recordings = [
        [
            verbatim(run.name), use, _length(run),
            joined(element("div", verbatim(note)) for note in run.provenance),
        ]
        for run, use in runs
    ]  # fmt: skip
    return section(
        "provenance",
        "Where this comes from",
        pairs(rows),
        folded("Recordings", table(["recording", "use", "length", "notes"], recordings)),
    )


def _length(run: Trajectory) -> str:
    t = run.counted().t
    return f"{t[-1] - t[0]:.0f} s, {len(t)} samples"


def _shown(value: object) -> Html:
    if isinstance(value, dict):
        lines = [f"{key}: {_plain(one)}" for key, one in value.items()]
        return joined(element("div", verbatim(line)) for line in lines)
    return verbatim(_plain(value))


def _plain(value: object) -> str:
    if isinstance(value, list | tuple):
        return ", ".join(str(one) for one in value)
    if isinstance(value, dict):
        return ", ".join(f"{key} {one}" for key, one in value.items())
    return str(value)


def _software(source: dict) -> list[str]:
    versions = source.get("versions") or {n: _version(n) for n in ("diffsea", "jax", "optimistix")}
    python = source.get("python", platform.python_version())
    return [*(f"{name} {version}" for name, version in versions.items()), f"Python {python}"]


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "of unknown version"
