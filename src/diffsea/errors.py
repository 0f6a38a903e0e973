"""The error that is meant for the person at the keyboard."""


class UserError(Exception):
    """Input that cannot be used: the message says what is wrong, where, and what to do.

    Raised for files, options and data that come from outside. The command line prints the
    message alone and ends with status 1; a traceback would only hide it.
    """
