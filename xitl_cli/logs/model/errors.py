"""Errors that a user of logs can correct.

`xitl_cli.main` prints them as it prints UserError, and exits with 2.

LogError
└── UnknownNameError    (a KeyError too)
"""


class LogError(Exception):
    """One sentence: the problem, its place, and the fix."""


class UnknownNameError(LogError, KeyError):
    """A log has no message, or a message has no field, of this name. The sentence gives the nearest name."""

    def __str__(self) -> str:
        return str(self.args[0])
