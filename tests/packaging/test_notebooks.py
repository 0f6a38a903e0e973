"""The notebooks run from top to bottom, and are kept without what they print."""

import nbformat
import pytest
from nbclient import NotebookClient
from tests.paths import ROOT


NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
QUICKEST = ("fit",)  # the others run by `make proof`
RUN = [
    pytest.param(path, id=path.stem, marks=[] if path.stem in QUICKEST else pytest.mark.proof)
    for path in NOTEBOOKS
]


def rich_results(book: nbformat.NotebookNode) -> set[str]:
    """The kinds of what its cells show, as MIME types."""
    code = [cell for cell in book.cells if cell.cell_type == "code"]
    return {kind for cell in code for out in cell.outputs for kind in out.get("data", {})}


def test_there_are_four_notebooks():
    names = [path.stem for path in NOTEBOOKS]
    assert names == ["diagnosis", "fit", "sweep", "trial-and-gradients"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_kept_without_output(path):
    code = [cell for cell in nbformat.read(path, 4).cells if cell.cell_type == "code"]
    assert code and not any(cell.outputs or cell.execution_count for cell in code)


@pytest.mark.slow
@pytest.mark.parametrize("path", RUN)
def test_a_notebook_runs_and_shows_tables_and_pictures(path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(ROOT / "src"))
    book = nbformat.read(path, 4)
    place = {"metadata": {"path": str(path.parent)}}
    NotebookClient(book, timeout=900, kernel_name="python3", resources=place).execute()
    assert {"text/html", "image/png"} <= rich_results(book)
