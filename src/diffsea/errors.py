"""The error that is meant for the person at the keyboard."""

import difflib
from collections.abc import Iterable


class UserError(Exception):
    """Input that cannot be used: the message says what is wrong, where, and what to do.

    Raised for files, options and data that come from outside. The command line prints the
    message alone and ends with status 1; a traceback would only hide it.
    """


_MOST_LISTED = 8


def nearest(name: str, known: Iterable[str]) -> str:
    """A hint such as `; did you mean 'X_u'?`, empty where nothing known is close."""
    close = difflib.get_close_matches(name, list(known), n=1)
    return f"; did you mean {close[0]!r}?" if close else ""


def nearest_of(name: str, known: Iterable[str], all_listed_by: str) -> str:
    """The nearest name as a hint, and what else there is: all if few, else the nearest eight.

    `all_listed_by` says what lists all of them, as in `diffsea show VESSEL --json`.
    """
    every = list(known)
    hint = nearest(name, every).removesuffix("?")
    lead = f"{hint}? " if hint else "; "
    if len(every) <= _MOST_LISTED:
        return f"{lead}{'There' if hint else 'there'} is {', '.join(every)}"
    close = difflib.get_close_matches(name, every, n=_MOST_LISTED, cutoff=0.0)
    listed = f"{', '.join(close)}; {all_listed_by} lists all"
    return f"{lead}{'Nearest' if hint else 'nearest'} are {listed}"
