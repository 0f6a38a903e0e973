"""What a long analysis tells somebody who waits."""

from collections.abc import Callable


Progress = Callable[[str], None]


def counted(number: int, thing: str) -> str:
    """How many there are, in words: `1 recording`, `3 recordings`."""
    return f"{number} {thing}{'s' * (number != 1)}"


class PartialProgress(str):
    """A progress message that tells how far a stage has come; a plain one begins a stage.

    Attributes:
        share: what is done of the stage, 0 to 1.
        stage: its name; the stage that was begun last if empty.
    """

    share: float
    stage: str

    def __new__(cls, message: str, share: float, stage: str = "") -> "PartialProgress":
        """A message for the person who waits, with the share that it stands for."""
        out = super().__new__(cls, message)
        out.share, out.stage = share, stage
        return out


class Remark(str):
    """A progress message that stays as a line of its own, and begins no stage."""


def no_progress(message: str) -> None:
    """Progress that nobody follows."""
