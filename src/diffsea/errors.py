"""The error that is meant for the person at the keyboard."""

import difflib
from collections.abc import Iterable


class UserError(Exception):
    """Input that cannot be used: the message says what is wrong, where, and what to do.

    Raised for files, options and data that come from outside. The command line prints the
    message alone and ends with status 1; a traceback would only hide it.
    """


def nearest(name: str, known: Iterable[str]) -> str:
    """A hint such as `; did you mean 'X_u'?`, empty where nothing known is close."""
    close = difflib.get_close_matches(name, list(known), n=1)
    return f"; did you mean {close[0]!r}?" if close else ""
