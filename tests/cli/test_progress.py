"""The bar of a long command, on a terminal and in a file."""

import io

import pytest

from diffsea.cli.progress import Stages


class Terminal(io.StringIO):
    """A stream that somebody watches."""

    def isatty(self) -> bool:
        return True

    def shown(self) -> str:
        """What the line says last."""
        return self.getvalue().rsplit("\x1b[K", 1)[-1]


def test_a_file_gets_a_line_for_each_stage():
    stream = io.StringIO()
    stages = Stages(2, stream)
    for share in (0.0, 0.4, 1.0):
        stages.tell("fitting", share)
    stages.tell("writing")
    stages.done()
    lines = stream.getvalue().splitlines()
    assert [line.split("] ")[1] for line in lines] == ["fitting", "writing"]
    assert "\r" not in stream.getvalue() and "\x1b" not in stream.getvalue()


def test_the_bar_is_the_share_of_all_stages():
    stream = Terminal()
    stages = Stages(4, stream)
    shown = []
    for stage, share in (("fitting", 0.0), ("fitting", 1.0), ("locating", 0.0), ("locating", 1.0)):
        stages.tell(stage, share)
        shown.append(stream.shown())
    assert [line.count("#") for line in shown] == [0, 6, 6, 12]
    assert [line.split("]")[1].split("%")[0].strip() for line in shown] == ["0", "25", "25", "50"]
    assert "\n" not in stream.getvalue() and shown[-1].endswith("locating")
    stages.done()
    assert stream.shown() == ""


def test_the_bar_never_goes_back_nor_beyond_its_end(monkeypatch):
    monkeypatch.setattr("diffsea.cli.progress._PAUSE", 0.0)
    stream = Terminal()
    stages = Stages(1, stream)
    for share, filled in ((1.0, 24), (0.3, 24), (7.0, 24)):
        stages.tell("fitting", share)
        assert stream.shown().count("#") == filled
    stages.tell("one stage too many", 1.0)
    assert stream.shown().count("#") == 24


def test_many_small_steps_are_few_drawings():
    stream = Terminal()
    stages = Stages(1, stream)
    for k in range(1000):
        stages.tell("fitting", k / 1001)
    assert stream.getvalue().count("\r") < 50


@pytest.mark.parametrize("columns", [20, 200])
def test_the_line_fits_the_terminal(monkeypatch, columns):
    monkeypatch.setenv("COLUMNS", str(columns))
    stream = Terminal()
    Stages(3, stream).tell("a stage with quite a long name", 0.0)
    assert len(stream.shown()) <= columns - 1
