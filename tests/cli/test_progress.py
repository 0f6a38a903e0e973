"""The bar of a long command, on a terminal and in a file."""

import io
import math
import re
import subprocess
import sys

import pytest

from diffsea.cli import options
from diffsea.cli.progress import compiling, staged
from diffsea.cli.progress.bar import time_left
from diffsea.cli.progress.compiling import Compiling
from diffsea.cli.progress.staged import StagedProgress
from diffsea.progress import PartialProgress


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


@pytest.fixture
def clock(monkeypatch):
    """The time since the beginning, s, as its one item."""
    now = [0.0]
    monkeypatch.setattr(staged.time, "monotonic", lambda: now[0])
    return now


def test_a_long_stage_is_heard_of_in_a_file(clock):
    stream = io.StringIO()
    with StagedProgress(2, stream) as tell:
        tell("fitting")
        for clock[0] in (5.0, 16.0, 20.0, 40.0):
            tell(PartialProgress(f"round {clock[0]:g}", clock[0] / 50))
    lines = [line.split("] ")[1] for line in stream.getvalue().splitlines()]
    assert lines == ["fitting", "fitting: round 16", "fitting: round 40"]


def test_what_is_told_by_a_line_is_not_told_again(clock):
    stream = io.StringIO()
    with StagedProgress(2, stream) as tell:
        tell("the boats")
        clock[0] = 20.0
        tell.line("one: done")
        tell(PartialProgress("one: done", 0.5))
    assert stream.getvalue().count("one: done") == 1


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


def test_stages_of_usual_seconds_are_known_by_how_they_begin_and_may_be_left_out():
    with StagedProgress({"reading": 1.0, "fitting": 6.0, "trying": 2.0, "writing": 1.0}) as tell:
        shares = []
        for message in (
            "reading 3 logs",
            PartialProgress("", 0.5),
            PartialProgress("step 1", 0.5, "fitting the boat"),
            "an aside, which is part of it",
            "writing",
            "fitting once more",
            PartialProgress("", 1.0),
        ):
            tell(message)
            shares.append(tell.share)
    assert shares == pytest.approx([0.0, 0.05, 0.4, 0.4, 0.9, 0.95, 1.0])


def test_a_stage_that_comes_again_has_half_of_what_is_left():
    with StagedProgress({"trying": 8.0, "writing": 8.0}) as tell:
        shares = []
        for cause in ("first", "second", "third"):
            tell(f"trying the {cause}")
            shares.append(tell.share)
        tell(PartialProgress("", 1.0))
        assert shares == pytest.approx([0.0, 0.25, 0.375]) and tell.share == pytest.approx(0.5)


def test_the_time_left_begins_with_the_usual_seconds_and_follows_the_pace(clock):
    clock[0] = 100.0
    with StagedProgress({"reading": 10.0, "fitting": 90.0}, Terminal()) as tell:
        tell("reading")
        assert tell.seconds_left == pytest.approx(100.0)
        clock[0] += 25.0  # twice as slow as usual, once the first seconds are believed
        tell("fitting")
        assert tell.seconds_left == pytest.approx(90.0 * 30 / 15)
    with StagedProgress(4) as tell:
        tell("one of four")
        assert math.isnan(tell.seconds_left)
        clock[0] += 7.0
        tell("two of four")
        assert tell.seconds_left == pytest.approx(21.0)


def test_a_stage_that_tells_nothing_moves_on_but_not_to_its_end(clock):
    with StagedProgress({"reading": 10.0, "fitting": 10.0}) as tell:
        tell("reading")
        shares = []
        for seconds in (0.0, 5.0, 5.0, 1000.0):
            clock[0] += seconds
            shares.append(tell.standing().share)
        assert shares == sorted(shares) and shares[1] > 0.1
        assert shares[-1] == pytest.approx(0.45)


@pytest.mark.parametrize(
    ("seconds", "words"),
    [
        (math.nan, ""),
        (3.0, "a few s left"),
        (11.0, "20 s left"),
        (59.0, "1 min left"),
        (61.0, "2 min left"),
        (700.0, "15 min left"),
    ],
)
def test_the_time_left_is_told_as_people_do(seconds, words):
    assert time_left(seconds) == words


def test_lines_stand_above_the_bar_and_where_they_stood_without_one(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("TERM", "xterm")
    stream = Terminal()
    with StagedProgress(1, stream) as tell:
        tell("fitting")
        options.progress("a log was read as [this]")
    assert "a log was read as [this]\n" in stream.shown().replace("\r", "")
    assert capsys.readouterr().err == ""
    options.progress("afterwards")
    assert capsys.readouterr().err == "afterwards\n"


def test_what_is_compiled_is_told_and_what_the_cache_holds_is_not(tmp_path, monkeypatch):
    """Two processes with one cache: the first compiles, the second reads."""
    code = """
import io, sys
from diffsea.runtime import prepare_jax
prepare_jax()
import jax, jax.numpy as jnp
from diffsea.cli.progress.compiling import COMPILING
from diffsea.cli.progress.staged import StagedProgress
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
stream = io.StringIO()
with StagedProgress(1, stream) as tell:
    tell("running")
    jax.jit(lambda x: jnp.linalg.svd(jnp.sin(x) @ x)[0].sum())(jnp.ones((5, 5)))
print(COMPILING.programs, COMPILING.seconds, COMPILING.is_running)
"""
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    run = lambda: subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    first, second = run(), run()
    programs, seconds, is_running = first.stdout.split()
    assert int(programs) >= 1 and float(seconds) > 0 and is_running == "False", first.stderr
    assert second.stdout.split() == ["0", "0.0", "False"], second.stderr


def test_the_line_says_that_a_program_is_being_compiled(clock, monkeypatch):
    told = Compiling()
    monkeypatch.setattr(staged, "COMPILING", told)
    stream = io.StringIO()
    with StagedProgress({"fitting": 9.0}, stream) as tell:
        tell("fitting")
        told.on_duration(compiling.LOWERED, 0.1)
        clock[0] += 2.5
        assert tell.standing().words == "fitting: compiling"
        told.on_duration(compiling.COMPILED, 2.5)
        assert tell.standing().words == "fitting"
        told.on_duration(compiling.LOWERED, 0.1)
        told.on_event(compiling.CACHED)
        clock[0] += 2.5
        told.on_duration(compiling.COMPILED, 2.5)
        assert tell.standing().words == "fitting"
    assert "2 s of this went into compiling one program: kept" in stream.getvalue()
