"""The bar of a long command, on a terminal and in a file."""

import io
import re

import pytest

from diffsea.cli.progress import StagedProgress
from diffsea.identification.estimates import PartialProgress


class Terminal(io.StringIO):
    """A stream that somebody watches."""

    def isatty(self) -> bool:
        return True

    def shown(self) -> str:
        """What has been drawn, without escape codes."""
        return re.sub(r"\x1b\[[?\d;]*[A-Za-z]", "", self.getvalue())


def test_a_file_gets_a_line_for_each_stage_without_escape_codes(monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    stream = io.StringIO()
    with StagedProgress(2, stream) as tell:
        tell("fitting")
        for share in (0.4, 1.0):
            tell(PartialProgress(f"round {share}", share))
        tell("writing")
    lines = stream.getvalue().splitlines()
    assert [line.split("] ")[1] for line in lines] == ["fitting", "writing"]
    assert "\r" not in stream.getvalue() and "\x1b" not in stream.getvalue()


def test_the_bar_is_the_share_of_all_stages():
    shares = []
    with StagedProgress(4, Terminal()) as tell:
        for message in (
            "fitting",
            PartialProgress("the last round", 1.0),
            PartialProgress("1 of 2", 0.5, "locating"),
            "writing",
        ):
            tell(message)
            shares.append(tell.share)
    assert shares == [0.0, 0.25, 0.375, 0.5]


def test_the_bar_never_goes_back_nor_beyond_its_end():
    with StagedProgress(1, Terminal()) as tell:
        tell("fitting")
        for share in (1.0, 0.3, 7.0):
            tell(PartialProgress("", share))
            assert tell.share == 1.0
        tell("one stage too many")
        assert tell.share == 1.0


def test_a_stage_is_told_by_its_place_and_not_by_the_words_of_its_message():
    stream = io.StringIO()
    with StagedProgress(4, stream) as tell:
        for number in range(3):
            tell(PartialProgress(f"trying the {number}. of 7 whatever", number / 7, "trying 7"))
        tell("round 3: a stage of this name")
    assert [line.split("] ")[1] for line in stream.getvalue().splitlines()] == [
        "trying 7", "round 3: a stage of this name",
    ]  # fmt: skip


@pytest.mark.parametrize("columns", [40, 200])
def test_the_line_fits_the_terminal_and_is_taken_away_at_the_end(monkeypatch, columns):
    monkeypatch.setenv("COLUMNS", str(columns))
    monkeypatch.setenv("TERM", "xterm")
    stream = Terminal()
    with pytest.raises(KeyboardInterrupt), StagedProgress(3, stream) as tell:
        tell("a stage with quite a long name, [which] has brackets")
        raise KeyboardInterrupt
    lines = stream.shown().replace("\r", "\n").splitlines()
    assert any("a stage" in line for line in lines)
    assert all(len(line) <= columns for line in lines)
    assert stream.getvalue().endswith("\x1b[2K") and "\x1b[?25h" in stream.getvalue()
