"""The shell of a report: one HTML file with its style inside, and tables that fit a phone.

Everything that is not already `Html` is escaped, so that names from files can be shown.
"""

import html
from collections.abc import Iterable, Sequence

from diffsea.report.quantities import typeset


_WIDE = 4  # columns from which a table is too wide for a phone


class Html(str):
    """Text that is markup already."""


Content = str | Html


def markup(content: Content) -> Html:
    """Markup of a content: plain text is typeset and escaped."""
    if isinstance(content, Html):
        return content
    return Html(html.escape(typeset(str(content))))


def verbatim(text: str) -> Html:
    """Text as it is, escaped but not typeset: names of files, hashes."""
    return Html(html.escape(str(text)))


def joined(parts: Iterable[Content]) -> Html:
    """Contents one after the other."""
    return Html("\n".join(markup(part) for part in parts))


def element(tag: str, content: Content, classes: str = "") -> Html:
    """A content in a tag."""
    attribute = f' class="{classes}"' if classes else ""
    return Html(f"<{tag}{attribute}>{markup(content)}</{tag}>")


def paragraph(content: Content, classes: str = "") -> Html:
    """A paragraph, or nothing where there is no text."""
    return element("p", content, classes) if content else Html("")


def section(name: str, heading: str, *parts: Content) -> Html:
    """A section that can be linked to as `#name`."""
    body = joined([element("h2", heading), *parts])
    return Html(f'<section id="{html.escape(name, quote=True)}">\n{body}\n</section>')


def bullets(items: Iterable[Content]) -> Html:
    """A list."""
    return element("ul", joined(element("li", item) for item in items))


def table(
    columns: Sequence[Content],
    rows: Sequence[Sequence[Content]],
    caption: str = "",
    numeric: Sequence[int] = (),
) -> Html:
    """A table; `numeric` columns align right.

    On a phone a wide one shows each row as a list of its cells under their column's name.
    """

    def classes(k: int) -> str:
        return ' class="number"' if k in numeric else ""

    def cell(k: int, content: Content) -> str:
        label = html.escape(markup(columns[k]), quote=True)
        return f'<td{classes(k)} data-label="{label}"><div>{markup(content)}</div></td>'

    head = "".join(f'<th scope="col"{classes(k)}>{markup(c)}</th>' for k, c in enumerate(columns))
    body = "\n".join(
        "<tr>" + "".join(cell(k, content) for k, content in enumerate(row)) + "</tr>"
        for row in rows
    )
    title = f"<caption>{markup(caption)}</caption>" if caption else ""
    wide = ' class="wide"' if len(columns) >= _WIDE else ""
    return Html(
        f'<div class="scroll"><table{wide}>{title}<thead><tr>{head}</tr></thead><tbody>\n{body}\n'
        "</tbody></table></div>"
    )


def pairs(rows: Iterable[tuple[str, Content]]) -> Html:
    """Terms and what they are."""
    parts = (f"<dt>{markup(term)}</dt><dd>{markup(what)}</dd>" for term, what in rows)
    return Html("<dl>" + "\n".join(parts) + "</dl>")


def folded(summary: str, content: Content) -> Html:
    """Detail that opens on demand."""
    return Html(f"<details><summary>{markup(summary)}</summary>{markup(content)}</details>")


def grid(figures: Iterable[Html]) -> Html:
    """Figures side by side where there is room."""
    return element("div", joined(figures), "grid")


def page(
    title: str, subtitle: str, sections: Sequence[Html], head: str = "", scripts: str = ""
) -> str:
    """The whole file, with further markup for its head and scripts for its end."""
    header = joined([element("h1", verbatim(title)), paragraph(verbatim(subtitle), "subtitle")])
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"{head}<title>{verbatim(title)}</title>\n<style>\n{_STYLE}</style>\n</head>\n<body>\n"
        f"<header>\n{header}\n</header>\n<main>\n{joined(sections)}\n</main>\n{scripts}</body>\n"
        "</html>\n"
    )


_STYLE = """\
:root { color-scheme: light; --ink: #1d2733; --soft: #5a6775; --line: #d9dfe5; --paper: #fff; }
* { box-sizing: border-box; }
body { margin: 0; background: #f4f6f8; color: var(--ink);
  font: 16px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", sans-serif; }
header, main { max-width: 1120px; margin: 0 auto; padding: 0 20px; }
header { padding-top: 28px; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: 0; overflow-wrap: anywhere; }
h2 { font-size: 1.2rem; margin: 0 0 10px; }
h3 { font-size: 1rem; margin: 22px 0 6px; }
p { margin: 0 0 10px; max-width: 75ch; overflow-wrap: anywhere; }
.warning { border-left: 4px solid #c2571a; padding-left: .8rem; }
.subtitle, .note, figcaption, caption { color: var(--soft); font-size: .9rem; }
section { background: var(--paper); border: 1px solid var(--line); border-radius: 8px;
  padding: 20px 22px; margin: 16px 0; }
.verdict { border-left: 8px solid var(--tone); }
.verdict .word { color: var(--tone); font-weight: 700; text-transform: uppercase;
  letter-spacing: .06em; font-size: .85rem; margin: 0 0 4px; }
.verdict .lead { font-size: 1.25rem; line-height: 1.4; margin: 0 0 6px; max-width: 60ch; }
.consistent { --tone: #2c7a3f; } .explained { --tone: #1f5fa8; }
.ambiguous { --tone: #9a6200; } .unexplained { --tone: #b3261e; } .fit { --tone: #1f5fa8; }
.grid { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 440px), 1fr));
  gap: 14px 20px; margin: 10px 0; align-items: start; }
figure { margin: 0; min-width: 0; max-width: 560px; }
figure img { width: 100%; height: auto; display: block; }
figcaption { margin-top: 2px; }
figure.interactive { max-width: none; }
.run { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(100%, 440px), 1fr));
  gap: 4px 20px; margin: 6px 0 18px; align-items: start; }
.key { display: flex; flex-wrap: wrap; gap: 4px 16px; align-items: center; margin: 8px 0;
  font-size: .9rem; color: var(--soft); }
.key i { display: inline-block; height: 14px; width: 180px; vertical-align: -2px; margin: 0 6px;
  border: 1px solid var(--line); } .key i.small { width: 22px; }
select { font: inherit; max-width: 100%; padding: 3px 6px; }
.scroll { overflow-x: auto; margin: 8px 0 12px; }
table { border-collapse: collapse; font-size: .92rem; font-variant-numeric: tabular-nums; }
caption { text-align: left; padding-bottom: 4px; }
th, td { text-align: left; vertical-align: top; padding: 5px 14px 5px 0;
  border-bottom: 1px solid var(--line); }
th { font-weight: 600; border-bottom: 2px solid var(--line); }
.number { text-align: right; white-space: nowrap; }
td strong { white-space: nowrap; }
dl { display: grid; grid-template-columns: max-content 1fr; gap: 4px 18px; margin: 8px 0; }
dt { color: var(--soft); } dd { margin: 0; overflow-wrap: anywhere; }
ul { margin: 0 0 10px; padding-left: 1.2em; }
details { margin: 8px 0; } summary { cursor: pointer; color: #1f5fa8; }
@media (max-width: 600px) {
  header, main { padding: 0 10px; } header { padding-top: 16px; }
  section { padding: 14px 12px; margin: 10px 0; border-radius: 6px; }
  .verdict .lead { font-size: 1.1rem; }
  table { font-size: .84rem; } th, td { padding-right: 10px; }
  .wide thead { position: absolute; left: -999em; }
  .wide, .wide tbody, .wide tr, .wide caption { display: block; width: 100%; }
  .wide tr { border-bottom: 2px solid var(--line); padding: 4px 0; }
  .wide td { display: flex; justify-content: space-between; gap: 14px; border: 0;
    padding: 2px 0; text-align: right; white-space: normal; }
  .wide td::before { content: attr(data-label); color: var(--soft); text-align: left;
    flex: 0 0 auto; }
  .wide td:first-child div { font-weight: 600; color: var(--ink); }
  .wide td > div { overflow-wrap: anywhere; min-width: 0; }
  .wide td:has(> div:empty) { display: none; }
  dl { grid-template-columns: 1fr; gap: 0; } dd { margin-bottom: 6px; }
}
@media print { body { background: #fff; } section { border: 0; padding: 0; }
  figure, tr { break-inside: avoid; } .modebar, .colouring { display: none; } }
"""
