"""How results show themselves: a short table in a terminal, the same as HTML in a notebook."""

import abc
import html
from collections.abc import Sequence
from typing import Any

import pandas as pd


_DIGITS = "{:.4g}".format  # of numbers shown


class Tabulated(abc.ABC):
    """A record that prints as a headline, a short table and notes.

    A dataclass that derives from it is declared with `repr=False`, or its own representation
    would come first.
    """

    @abc.abstractmethod
    def headline(self) -> str:
        """What this is, in one line."""

    @abc.abstractmethod
    def rows(self) -> Sequence[dict[str, Any]]:
        """The table's rows, each from heading to cell."""

    def notes(self) -> Sequence[str]:
        """Sentences below the table."""
        return ()

    def to_frame(self) -> pd.DataFrame:
        """The table as a DataFrame."""
        return pd.DataFrame(list(self.rows()))

    def __repr__(self) -> str:
        table = self.to_frame()
        body = (
            [table.to_string(index=False, na_rep="-", float_format=_DIGITS)] if len(table) else []
        )
        return "\n".join([self.headline(), *body, *self.notes()])

    def _repr_html_(self) -> str:
        table = self.to_frame()
        body = (
            table.to_html(index=False, border=0, na_rep="-", float_format=_DIGITS)
            if len(table)
            else ""
        )
        notes = "".join(f"<p>{html.escape(note)}</p>" for note in self.notes())
        return f"<p><b>{html.escape(self.headline())}</b></p>{body}{notes}"
