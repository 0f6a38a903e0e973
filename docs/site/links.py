"""Links that leave docs/: pages of the repository become pages of the site, other files plain text.

Markdown of docs/ links to its neighbours as it does where a repository is browsed,
`../experiments/NAME/README.md`. Those pages and their pictures are added to the site below
`repository/`, and links are turned accordingly. A link to any other file of the repository becomes
its text and its path; a link to a file that is not there ends the build.
"""

import posixpath
import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page


ROOT = Path(__file__).resolve().parents[2]
PAGES = (
    "README.md",
    "CHANGELOG.md",
    "CONTRIBUTING.md",
    "benchmarks/README.md",
    "examples/blueboat/README.md",
    "examples/demo/README.md",
    "experiments/README.md",
)
_LINK = re.compile(r"(?P<picture>!?)\[(?P<text>[^\]]*)\]\((?P<target>[^)\s]+)\)")
_CODE = re.compile(r"^(```.*?^```|(?: {4}|\t).*?$|`[^`\n]+`)", re.MULTILINE | re.DOTALL)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the repository's pages and their pictures."""
    pages = [*PAGES, *(_inside(path) for path in sorted(ROOT.glob("experiments/*/README.md")))]
    for page in pages:
        files.append(_added(page, config))
        for link in _LINK.finditer((ROOT / page).read_text(encoding="utf-8")):
            if link["picture"]:
                picture = posixpath.normpath(
                    posixpath.join(posixpath.dirname(page), link["target"])
                )
                files.append(_added(picture, config))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Turn the links of a page so that they hold in the site."""
    uri = page.file.src_uri
    if uri.startswith("repository/"):
        # Tables begin right below the comments that mark them.
        markdown = re.sub(r"^(<!-- .* -->)$", r"\n\1\n", markdown, flags=re.MULTILINE)
    parts = _CODE.split(markdown)
    parts[::2] = [_LINK.sub(lambda link: _turned(link, uri, files), part) for part in parts[::2]]
    return "".join(parts)


def in_site(path: str) -> str:
    """Where a file of the repository stands in the site."""
    return path.removeprefix("docs/") if path.startswith("docs/") else f"repository/{path}"


def _inside(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def _added(path: str, config: MkDocsConfig) -> File:
    return File.generated(config, in_site(path), abs_src_path=str(ROOT / path))


def _turned(link: re.Match[str], uri: str, files: Files) -> str:
    target, _, anchor = link["target"].partition("#")
    if not target or "://" in target or target.startswith("mailto:"):
        return link[0]
    page = uri.removeprefix("repository/") if uri.startswith("repository/") else f"docs/{uri}"
    path = posixpath.normpath(posixpath.join(posixpath.dirname(page), target))
    path = re.sub(r"\.ipynb$", ".md", path)  # as the site shows it
    if files.get_file_from_path(in_site(path)) is not None:
        relative = posixpath.relpath(in_site(path), posixpath.dirname(uri) or ".")
        return f"{link['picture']}[{link['text']}]({relative}{'#' + anchor if anchor else ''})"
    if not (ROOT / path).exists():
        raise PluginError(f"{page} links to {path}, which is not there")
    if link["text"].strip("`") == posixpath.basename(path):
        return f"`{path}`"
    return f"{link['text']} (`{path}`)"
