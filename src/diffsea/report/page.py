"""Pages: templates filled with records, each page one file that carries its style and scripts.

Templates hold the sentences, modules of this package the numbers. Text is typeset and escaped
as it enters a page, so that messages and tables are written once, for terminal and page alike.
"""

import dataclasses
from collections.abc import Sequence

import jinja2
import plotly.graph_objects as go
from markupsafe import Markup
from plotly.offline import get_plotlyjs

from diffsea.report.quantities import typeset


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


TEMPLATES = jinja2.Environment(
    loader=jinja2.PackageLoader("diffsea.report"),
    autoescape=True,
    undefined=jinja2.StrictUndefined,
    finalize=typeset_unless_verbatim,
    trim_blocks=True,
    lstrip_blocks=True,
)
TEMPLATES.filters["verbatim"] = Verbatim


def render(template: str, page: object) -> str:
    """A page from its template (`diagnosis.html.j2`) and the record that it shows.

    Arguments:
        page: what the template calls `page`; has at least `title` and `subtitle`.

    Raises:
        jinja2.UndefinedError: the template asks for what the record does not have.
    """
    return TEMPLATES.get_template(template).render(page=page, plotly=Markup(get_plotlyjs()))
