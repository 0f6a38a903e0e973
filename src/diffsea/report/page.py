"""Pages: templates filled with records, each page one file that carries its style and scripts.

Templates hold the sentences, modules of this package the numbers. Text is typeset and escaped
as it enters a page, so that messages and tables are written once, for terminal and page alike.
Every page ends with what was fitted and where the results come from.
"""

import dataclasses
import importlib.metadata
import importlib.resources
import math
import platform
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Literal

import jinja2
import plotly.graph_objects as go
from markupsafe import Markup, escape

from diffsea.report.quantities import (
    CERTAIN,
    is_known,
    odds,
    probability,
    round_to_error,
    typeset,
    with_error,
)
from diffsea.report.wording.words import Record, as_words
from diffsea.trajectory import Trajectory


SHOWN_OTHERWISE = ("recordings", "versions", "python")  # as a table, and as one line
PACKAGES = ("diffsea", "jax", "optimistix")  # whose versions may move a result


class Verbatim(str):
    """Text that is escaped but not typeset: names of files, messages of programs."""


Cell = str | Sequence[str]  # of a table; several texts stand on lines of their own


@dataclasses.dataclass(frozen=True)
class Table:
    """A table of a page; `numeric` columns align right."""

    columns: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    caption: str = ""
    numeric: Sequence[int] = ()


@dataclasses.dataclass(frozen=True)
class Plot:
    """An interactive figure of a page.

    Attributes:
        alternative: what it shows, for those who do not see it.
        height: pixels; the width is that of the place.
        classes: of CSS.
    """

    figure: go.Figure
    alternative: str
    height: int
    caption: str = ""
    classes: str = ""

    @property
    def json(self) -> Markup:
        """The figure for the script that draws it; Plotly escapes every `<` within."""
        return Markup(self.figure.update_layout(height=self.height).to_json())


@dataclasses.dataclass(frozen=True)
class RunPlots:
    """The plots of one run, which share a time cursor: its track, and what it did over time."""

    name: str
    plots: Sequence[Plot]


def typeset_unless_verbatim(value: object) -> object:
    """What a template prints for a value: plain text with the signs of print."""
    if isinstance(value, str) and not isinstance(value, Markup | Verbatim):
        return typeset(value)
    return value


def odds_cell(log10: float | None) -> str:
    """Odds in words once nobody would doubt them, with the number on pointing at it."""
    if not is_known(log10) or abs(log10) < CERTAIN:
        return odds(log10)
    return _with_tooltip("certain" if log10 > 0 else "excluded", f"odds of {odds(log10)}")


def probability_cell(p: float | None) -> str:
    """A p-value, by its bound once it is tiny, with the number on pointing at it."""
    if not is_known(p) or p >= 10**-CERTAIN:
        return probability(p)
    return _with_tooltip("< 1e-6", f"p = {probability(p)}".replace("= <", "<"))


def _with_tooltip(shown: str, meant: str) -> Markup:
    return Markup('<abbr title="{}">{}</abbr>').format(typeset(meant), typeset(shown))


def with_commands(text: str) -> Markup:
    """A message for the terminal, verbatim: what stands there in backticks is set as code."""
    parts = text.split("`")
    if len(parts) % 2 == 0:  # one of them is no bracket
        return escape(text)
    return Markup().join(
        Markup("<code>{}</code>").format(part) if number % 2 else part
        for number, part in enumerate(parts)
    )


TEMPLATES = jinja2.Environment(
    loader=jinja2.PackageLoader("diffsea.report"),
    autoescape=True,
    undefined=jinja2.StrictUndefined,
    finalize=typeset_unless_verbatim,
    trim_blocks=True,
    lstrip_blocks=True,
)
_SECTION = re.compile(r'<section id="([^"]+)">\s*<h2>(.*?)</h2>', re.DOTALL)
_FEWEST_SECTIONS = 3  # of which a list helps


def contents_of(main: Markup) -> list[tuple[str, Markup]]:
    """Places and titles of the sections of a page's own markup, none where there are few."""
    found = [(place, Markup(title)) for place, title in _SECTION.findall(str(main))]
    return found if len(found) >= _FEWEST_SECTIONS else []


TEMPLATES.filters["contents"] = contents_of
TEMPLATES.filters["verbatim"] = Verbatim
TEMPLATES.filters["commands"] = with_commands


ASSETS = importlib.resources.files("diffsea.report") / "assets"
Bundle = Literal["basic", "cartesian"]


def render(template: str, bundle: Bundle = "basic", **page: object) -> str:
    """A page from its template (`diagnosis.html.j2`) and what it shows.

    Arguments:
        bundle: of Plotly's script: lines and bars alone, or heat maps as well.
        page: what the template finds in `page`; has at least `title` and `subtitle`.

    Raises:
        jinja2.UndefinedError: the template asks for what is not given.
    """
    script = (ASSETS / f"plotly-{bundle}.min.js").read_text(encoding="utf-8")
    return TEMPLATES.get_template(template).render(page=page, plotly=Markup(script))


@dataclasses.dataclass(frozen=True)
class Section:
    """A part of a page under a title of its own: sentences, plots side by side, tables."""

    title: str
    sentences: Sequence[str] = ()
    plots: Sequence[Plot] = ()
    tables: Sequence[Table] = ()


# -- what every page ends with


@dataclasses.dataclass(frozen=True)
class Provenance:
    """Versions, settings, files, and what was done to each recording."""

    terms: Mapping[str, Cell]
    recordings: Table


def provenance(source: Record, runs: Iterable[tuple[Trajectory, str]]) -> Provenance:
    """Where results come from.

    Arguments:
        source: what was run on what: file names, hashes, settings; shown as it is, one line for
            each entry of a dictionary.
        runs: recordings, and what each was used for.
    """

    def plain(value: object) -> str:
        if isinstance(value, list | tuple):
            return ", ".join(str(part) for part in value)
        if isinstance(value, Mapping):
            return ", ".join(f"{key} {part}" for key, part in value.items())
        return str(value)

    terms: dict[str, Cell] = {}
    for key, value in source.items():
        if isinstance(value, Mapping):
            terms[as_words(key)] = [
                Verbatim(f"{name}: {plain(one)}") for name, one in value.items()
            ]
        else:
            terms[as_words(key)] = Verbatim(plain(value))
    for key in SHOWN_OTHERWISE:
        terms.pop(key, None)
    versions = source.get("versions") or {n: importlib.metadata.version(n) for n in PACKAGES}
    software = [f"{name} {version}" for name, version in versions.items()]
    software.append(f"Python {source.get('python', platform.python_version())}")
    terms["software"] = Verbatim(", ".join(software))
    rows = []
    for run, use in runs:
        t, notes = run.counted().t, [Verbatim(note) for note in run.provenance]
        length = f"{t[-1] - t[0]:.0f} s, {len(t)} samples"
        rows.append([Verbatim(run.name), use, length, notes])
    return Provenance(terms, Table(["recording", "use", "length", "notes"], rows))


def parameter_table(rows: Sequence[Record]) -> Table:
    """Fitted parameters with standard errors, 90 % intervals, and what they rest on.

    Arguments:
        rows: those of `ParameterEstimate.as_dict`: `value`, `std` and `interval` in the `unit`;
            `determined` is 0 where an estimate rests on the prior, 1 where on the data.
    """

    def end(value: float, std: float) -> str:
        return round_to_error(value, 0.3 * std) if math.isfinite(value) else "open"

    cells = []
    for row in rows:
        low, high = (end(value, row["std"]) for value in row["interval"])
        estimate = with_error(row["value"], row["std"])
        name, start = Verbatim(row["name"]), round_to_error(row["start"])
        percent = f"{100 * row['determined']:.0f} %"
        rests_on = f"mostly the vessel file ({percent} data)"
        if row["determined"] > 0.9:
            rests_on = f"the data ({percent})"
        elif row["determined"] > 0.5:
            rests_on = f"data and vessel file ({percent} data)"
        bounds = f"{low} to {high}"
        cells.append([name, row["meaning"], start, estimate, bounds, row["unit"], rests_on])
    columns = ["symbol", "name", "start", "estimate", "90 % interval", "unit", "determined by"]
    title = "Fitted with everything else in the model; +- is one standard error"
    return Table(columns, cells, title, numeric=(2, 3, 4))
