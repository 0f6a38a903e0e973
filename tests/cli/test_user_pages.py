"""The commands of the pages for users are commands, with options that there are."""

import re
import shlex

import pytest
from tests.paths import ROOT

from diffsea.cli import make_parser


NAMES = ("ten-minutes", "for-naval-architects", "for-roboticists", "for-students")
PAGES = {name: (ROOT / "docs" / f"{name}.md").read_text(encoding="utf-8") for name in NAMES}


def commands(page: str) -> list[str]:
    """The commands of the tool in a page, each on one line."""
    return re.findall(r"^    (?:\.venv/bin/)?diffsea (.*)$", page.replace("\\\n", ""), re.MULTILINE)


@pytest.mark.parametrize("name", NAMES[:3])
def test_every_command_of_a_page_can_be_given(name):
    found = commands(PAGES[name])
    assert len(found) >= 4
    for command in found:
        make_parser().parse_args(shlex.split(command, comments=True))


@pytest.mark.parametrize("name", NAMES)
def test_every_file_of_the_examples_that_a_page_names_is_there(name):
    for path in re.findall(r"examples/[\w./*-]*\w", PAGES[name]):
        assert list(ROOT.glob(path)), path
