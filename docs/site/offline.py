"""Nothing leaves the site: what the theme would fetch is taken out, and the build ends at the rest.

The theme's script fetches two helpers from a distributor: a diagram library, where a page has
diagrams (none has), and a stand-in for an observer that every browser of today has.
"""

import re
from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError


_DISTRIBUTOR = re.compile(r"https://unpkg\.com/[\w.@/-]+")
_FETCHED = re.compile(
    r"""<(?:script|img|iframe|source|video|audio|embed)\b[^>]*?\bsrc=["']?(?:https?:)?//[^\s"'>]+"""
    r"""|<link\b(?![^>]*\brel=["']?canonical)[^>]*?\bhref=["']?(?:https?:)?//[^\s"'>]+"""
    r"""|(?:@import\s+|url\()["']?(?:https?:)?//[^\s"')]+""",
)


def on_post_build(config: MkDocsConfig) -> None:
    """Take out the theme's addresses and look for any other that a browser would fetch."""
    site = Path(config.site_dir)
    for script in site.glob("assets/javascripts/*.js"):
        text = script.read_text(encoding="utf-8")
        script.write_text(_DISTRIBUTOR.sub("about:blank", text), encoding="utf-8")
    for path in site.rglob("*.map"):
        path.unlink()
    for path in (p for p in site.rglob("*") if p.suffix in (".html", ".css")):
        fetched = _FETCHED.search(path.read_text(encoding="utf-8"))
        if fetched is not None:
            raise PluginError(f"{path.relative_to(site)} would fetch {fetched[0]}")
