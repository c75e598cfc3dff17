"""Errors that a user can mend: each message is one sentence with the value, the limit and the remedy."""


class LabError(Exception):
    """An expected failure; shown as one line, without a traceback."""


class InputError(LabError, ValueError):
    """A value that the lab cannot work with."""
