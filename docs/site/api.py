"""Pages of the public names: one for each row of the table in docs/python.md.

Signatures with their shapes, and docstrings with their units, come from the source. The build ends
where a public name is in no row.
"""

import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files

import diffsea


# Where the names of a row stand, by the first word of what they are for.
PAGES = {
    "jobs": ("jobs", "Jobs"),
    "what": ("results", "Results"),
    "vessels": ("vessels", "Vessels"),
    "numbers": ("numbers", "Numbers of a model"),
    "recordings": ("recordings", "Recordings"),
    "pure": ("functions", "Pure functions"),
    "records": ("studies", "Records of a study"),
    "work": ("kept-fits", "Work that goes on"),
    "vocabulary": ("vocabulary", "Vocabulary"),
    "set-up": ("set-up", "Set-up"),
}
_NOTE = (
    "SI units and radians where nothing else is said. A shape is the word in an annotation: "
    '`Float[Array, "time"]` has a number for each row of a run; words that are alike within a '
    "signature are alike in length. A `Series` has the shape `time`, a `Scalar` none. `Array` is "
    "JAX's, `np.ndarray` NumPy's. Symbols are in the [glossary](../glossary.md).\n"
)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the pages."""
    rows = public_names((Path(config.docs_dir) / "python.md").read_text(encoding="utf-8"))
    listed = {name for names in rows.values() for name in names}
    public = set(vars(diffsea)["__all__"])
    if listed != public:
        differing = ", ".join(sorted(listed ^ public))
        raise PluginError(f"docs/python.md lists other names than diffsea has: {differing}")
    for what, names in rows.items():
        page, title = PAGES[re.split(r"[ ,]", what)[0]]
        entries = "\n".join(f"::: diffsea.{name}\n" for name in names)
        content = f"# {title}\n\n{what[0].upper()}{what[1:]}. {_NOTE}\n{entries}"
        files.append(File.generated(config, f"api/{page}.md", content=content))
    return files


def public_names(markdown: str) -> dict[str, list[str]]:
    """The names of each row of the table below the heading `Names`, by what they are for."""
    section = markdown.split("\n## Names\n")[1].split("\n## ")[0]
    rows = (line.strip("| ").split(" | ") for line in section.splitlines() if "`" in line)
    return {what: re.findall(r"`(\w+)`", names) for what, names in rows}
