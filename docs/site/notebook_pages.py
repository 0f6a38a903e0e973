"""The notebooks as pages, with the results that they have when the site is built."""

import base64
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import nbformat
from kept import KEPT, ROOT, state_of
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from nbclient import NotebookClient


NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add a page for each notebook, and its pictures."""
    with ThreadPoolExecutor(2) as workers:
        executed = list(workers.map(_executed, NOTEBOOKS))
    for path, book in zip(NOTEBOOKS, executed, strict=True):
        content, pictures = as_page(book, path.stem)
        files.append(File.generated(config, f"notebooks/{path.stem}.md", content=content))
        for name, picture in pictures.items():
            files.append(File.generated(config, f"notebooks/{name}", content=picture))
    return files


def as_page(book: nbformat.NotebookNode, name: str) -> tuple[str, dict[str, bytes]]:
    """An executed notebook as Markdown, and its pictures (PNG) by file name."""
    parts, pictures = [], {}
    for cell in book.cells:
        if cell.cell_type != "code":
            parts.append(cell.source)
            continue
        parts.append(f"```python\n{cell.source}\n```")
        for output in cell.outputs:
            data = output.get("data", {})
            if "image/png" in data:
                file = f"{name}-{len(pictures) + 1}.png"
                pictures[file] = base64.b64decode(data["image/png"])
                parts.append(f"![what the cell above draws]({file})")
            elif "text/html" in data:
                html = "\n".join(line for line in data["text/html"].splitlines() if line.strip())
                parts.append(f'<div class="output">\n{html}\n</div>')
            else:
                parts.append(f"```text\n{(output.get('text') or data['text/plain']).rstrip()}\n```")
    parts.append(f"The notebook itself is `docs/notebooks/{name}.ipynb`.")
    return "\n\n".join(parts) + "\n", pictures


def _executed(path: Path) -> nbformat.NotebookNode:
    kept, state = KEPT / path.name, state_of([path])
    if kept.exists():
        book = nbformat.read(kept, 4)
        if book.metadata.get("state") == state:
            return book
    book = nbformat.read(path, 4)
    place = {"metadata": {"path": str(path.parent)}}
    NotebookClient(book, timeout=900, kernel_name="python3", resources=place).execute()
    book.metadata["state"] = state
    kept.parent.mkdir(parents=True, exist_ok=True)
    nbformat.write(book, kept)
    return book
