"""The public names: documented, loaded when used, and what loading them sets up."""

import importlib.util
import json
import os
import re
import subprocess
import sys
from typing import Any

import pytest
from tests.paths import ROOT

import diffsea


PUBLIC: Any = diffsea  # its names are found as they are used


def python(code: str, **environment: str) -> str:
    """What a fresh interpreter prints."""
    env = {k: v for k, v in os.environ.items() if k not in ("XLA_FLAGS", "JAX_ENABLE_X64")}
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, env=env | environment
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_documented_names_are_the_public_names():
    page = (ROOT / "docs" / "python.md").read_text()
    table = page[page.index("## Names") : page.index("## Commands and their calls")]
    assert sorted(re.findall(r"`(\w+)`", table)) == sorted(PUBLIC.__all__)
    assert 30 <= len(PUBLIC.__all__) <= 70


def test_calls_of_commands_are_there():
    page = (ROOT / "docs" / "python.md").read_text()
    text = page[page.index("## Commands and their calls") : page.index("## JAX's set-up")]
    rows = [line.split(" | ")[1] for line in text.splitlines() if line.startswith("| `")]
    assert len(rows) == 9
    imported = [re.search(r"from (\S+) import (\w+)", row) for row in rows]
    for row, found in zip(rows, imported, strict=True):
        if found:
            assert callable(getattr(importlib.import_module(found[1]), found[2]))
        else:
            assert set(re.findall(r"`(\w+)`", row)) <= set(PUBLIC.__all__)


PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_what_a_page_imports_is_there(page):
    text = page.read_text()
    for block in re.findall(r"```python\n(.*?)```", text, re.DOTALL):
        for module, names in re.findall(
            r"^from (diffsea\S*) import ([\w, ]+)$", block, re.MULTILINE
        ):
            if f"src/{module.replace('.', '/')}.py" in text:
                continue  # a module that the page adds
            found = importlib.import_module(module)
            for name in names.split(","):
                name = name.split(" as ")[0].strip()
                assert hasattr(found, name) or importlib.util.find_spec(f"{module}.{name}"), name


def test_every_name_loads_and_completes():
    for name in PUBLIC.__all__:
        assert getattr(PUBLIC, name) is not None
    assert set(PUBLIC.__all__) <= set(dir(PUBLIC))
    with pytest.raises(AttributeError, match="nothing"):
        PUBLIC.nothing  # noqa: B018


LOADED = (
    "import json, sys; print(json.dumps([m for m in "
    "('jax', 'equinox', 'numpy', 'pandas', 'scipy', 'matplotlib') if m in sys.modules]))"
)


def test_importing_loads_nothing_and_changes_nothing():
    code = "import os; before = dict(os.environ); import diffsea; assert os.environ == before; "
    assert json.loads(python(code + LOADED)) == []


def test_recordings_are_read_and_audited_without_jax(tmp_path):
    rows = "\n".join(f"{k / 10},{k / 10},0,0,1,0,0" for k in range(200))
    (tmp_path / "run.csv").write_text(f"t,x,y,psi,u,v,r\n{rows}\n")
    code = f"import diffsea; print(diffsea.audit({str(tmp_path / 'run.csv')!r}).runs[0]); "
    name, loaded = python(code + LOADED).splitlines()
    assert name == "run.csv"
    assert not {"jax", "equinox", "matplotlib"} & set(json.loads(loaded))


def test_no_name_that_is_said_to_need_no_jax_loads_it():
    code = "import diffsea; [getattr(diffsea, n) for n in diffsea._WITHOUT_JAX]; " + LOADED
    assert not {"jax", "equinox"} & set(json.loads(python(code)))


SETTINGS = "import jax, os; print(jax.config.jax_enable_x64, 'XLA_FLAGS' in os.environ)"


def test_the_first_name_that_needs_jax_sets_it_up():
    code = "import diffsea; diffsea.Vessel; " + SETTINGS
    assert python(code).split() == ["True", "True"]
    assert python(code, DIFFSEA_SETUP="off").split() == ["False", "False"]


def test_a_name_that_needs_no_jax_leaves_it_alone():
    assert python("import diffsea; diffsea.read_recording; " + SETTINGS).split() == ["False"] * 2


def test_jax_imported_before_is_left_and_its_cost_said_once():
    code = (
        "import warnings, jax, diffsea\n"
        "with warnings.catch_warnings(record=True) as told:\n"
        "    warnings.simplefilter('always'); diffsea.Vessel; diffsea.EFFECTS\n"
        "print(len(told), jax.config.jax_enable_x64, '32 bits' in str(told[0].message))"
    )
    assert python(code).split() == ["1", "False", "True"]


def test_flags_of_an_unknown_jaxlib_are_not_set():
    code = (
        "import diffsea.runtime as runtime, diffsea; runtime.MEASURED_WITH = 'none'; "
        "diffsea.Vessel; " + SETTINGS
    )
    assert python(code).split() == ["True", "False"]
