"""What the reproductions of published systems share: options, results, tables, figures.

A full run writes `results.json` and `figures/*.png` beside the experiment's README and fills in
the README's tables; a quick one, for tests, writes to `out/` and leaves the README alone.
"""

import argparse
import dataclasses
import io
import json
import math
import os
import re
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from diffsea.runtime import prepare_jax


prepare_jax()

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image


ROOT = Path(__file__).resolve().parents[2]


@dataclasses.dataclass(frozen=True)
class Experiment:
    """One run of an experiment: how thorough, and where its results go."""

    home: Path  # the experiment's folder
    folder: Path  # of results.json and figures/
    quick: bool
    began: float

    def say(self, message: str) -> None:
        """Progress, with the seconds since the start."""
        print(f"[{time.perf_counter() - self.began:5.0f} s] {message}", flush=True)

    def save(self, figure: Figure, name: str) -> None:
        """Write a figure as `figures/<name>.png`, with 256 colours: a third of the size."""
        path = self.folder / "figures" / f"{name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        FigureCanvasAgg(figure)
        drawn = io.BytesIO()
        figure.savefig(drawn, dpi=110, format="png")
        plain_colours = Image.open(drawn).convert("RGB")
        plain_colours.quantize(256, dither=Image.Dither.NONE).save(path, optimize=True)

    def write(self, results: dict, tables: dict[str, str] | None = None) -> None:
        """Write results.json, tables included; a full run fills in the README's, see `fill`.

        A README with a place for `SECONDS` is told there how long the run took.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        seconds = round(time.perf_counter() - self.began, 1)
        record = {"experiment": self.home.name, "quick": self.quick, "seconds": seconds} | results
        record |= {"tables": tables or {}}
        _replace(self.folder / "results.json", json.dumps(plain(record), indent=1) + "\n")
        readme = self.home / "README.md"
        for key, text in (tables or {}).items():
            print(f"\n{text}")
            if self.folder == self.home:
                fill(readme, key, text)
        if self.folder == self.home and "<!-- begin SECONDS -->" in readme.read_text():
            fill(readme, "SECONDS", how_long(seconds))
        print(f"\nwritten to {self.folder} after {seconds:.0f} s")

    def write_part(self, part: str, results: dict, tables: dict[str, str]) -> None:
        """Write one part of results.json and its tables in the README; other parts stay."""
        self.folder.mkdir(parents=True, exist_ok=True)
        path = self.folder / "results.json"
        old = json.loads(path.read_text()) if path.exists() else {"parts": {}, "tables": {}}
        seconds = round(time.perf_counter() - self.began, 1)
        parts = old["parts"] | {part: plain({"seconds_by_its_end": seconds} | results)}
        record = {"experiment": self.home.name, "quick": self.quick, "parts": parts}
        record |= {"tables": old["tables"] | tables}
        _replace(path, json.dumps(record, indent=1) + "\n")
        for key, text in tables.items():
            print(f"\n{text}")
            if self.folder == self.home:
                fill(self.home / "README.md", key, text)
        self.say(f"{part} written to {self.folder}")


def how_long(seconds: float) -> str:
    """What a README says of a full run's time."""
    return f"The full run of these figures took {seconds:.0f} s."


def filled(readme: Path) -> dict[str, str]:
    """What stands in each place of a README, by its key."""
    places = re.findall(
        r"<!-- begin (\S+) -->\n(.*?)\n<!-- end \1 -->", readme.read_text(), re.DOTALL
    )
    return dict(places)


def experiment(script: str, description: str | None) -> Experiment:
    """Read an experiment's command line; `script` is its `__file__`."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--quick", action="store_true", help="a small variant, for tests")
    parser.add_argument("-o", "--output", type=Path, help="folder of the results")
    given = parser.parse_args()
    home = Path(script).resolve().parent
    usual = ROOT / "out" / f"{home.name}-quick" if given.quick else home
    return Experiment(home, (given.output or usual).resolve(), given.quick, time.perf_counter())


def experiment_in_parts(
    script: str, description: str | None, parts: Sequence[str]
) -> tuple[Experiment, list[str]]:
    """Read the command line of an experiment that can be run part by part, all by default."""
    parser = argparse.ArgumentParser(description=str(description).splitlines()[0])
    parser.add_argument("parts", nargs="*", choices=[*parts, []], metavar="PART",
                        help=f"among {', '.join(parts)}; all by default")  # fmt: skip
    parser.add_argument("-o", "--output", type=Path, help="folder of the results")
    given = parser.parse_args()
    home = Path(script).resolve().parent
    folder = (given.output or home).resolve()
    return Experiment(home, folder, False, time.perf_counter()), given.parts or list(parts)


def compared(
    quantity: str, unit: str, published: float | str | None, obtained: object, note: str = ""
) -> dict:
    """One row of a comparison with a published figure; None where nothing was published."""
    return {
        "quantity": quantity, "unit": unit, "published": published, "obtained": obtained,
        "note": note,
    }  # fmt: skip


def limited(quantity: str, unit: str, limit: float | str, obtained: object, note: str = "") -> dict:
    """One row of a comparison with a rule's limit, which nobody measured."""
    return {
        "quantity": quantity, "unit": unit, "limit": limit, "obtained": obtained, "note": note,
    }  # fmt: skip


def comparison(rows: Sequence[dict]) -> str:
    """Rows of `compared` as a table, or rows of `limited`."""
    (beside,) = {"limit" if "limit" in row else "published" for row in rows}
    cells = [
        (row["quantity"], shown(row[beside]), shown(row["obtained"]), row["unit"], row["note"])
        for row in rows
    ]
    return table(("", beside, "obtained", "unit", ""), cells)


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """A table in Markdown; numbers with four digits."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(shown(cell) for cell in line) + " |" for line in lines)


def shown(value: Any) -> str:
    """A number with four digits, None as a dash, anything else as it is."""
    if value is None:
        return "-"
    if isinstance(value, bool | str):
        return str(value)
    number = float(value)
    return "-" if math.isnan(number) else f"{number:.4g}"


def fill(readme: Path, key: str, text: str) -> None:
    """Replace what stands between `<!-- begin KEY -->` and `<!-- end KEY -->` in a README."""
    begin, end = f"<!-- begin {key} -->", f"<!-- end {key} -->"
    old = readme.read_text()
    new, count = re.subn(
        f"{re.escape(begin)}.*?{re.escape(end)}",
        lambda _: f"{begin}\n{text}\n{end}",
        old,
        flags=re.DOTALL,
    )
    if count != 1:
        raise SystemExit(f"{readme} has no place for {key!r}: add the lines\n{begin}\n{end}")
    _replace(readme, new)


def panels(rows: int, columns: int, width: float = 10.0, height: float = 6.0) -> tuple:
    """A figure and its axes."""
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False)


def plain(value: object) -> object:
    """Arrays as lists, numbers as floats, what is not finite as null."""
    if isinstance(value, dict):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, np.ndarray) or hasattr(value, "__array__"):
        return plain(np.asarray(value).tolist())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def _replace(path: Path, text: str) -> None:
    """Write a file whole or not at all."""
    part = path.with_name(f".{path.name}.part")
    part.write_text(text)
    os.replace(part, path)
