"""The site's few rules of style, added without a folder of their own in docs/."""

from pathlib import Path

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the style sheet that `extra_css` names."""
    sheet = Path(__file__).with_name("site.css")
    files.append(File.generated(config, "stylesheets/site.css", abs_src_path=str(sheet)))
    return files
