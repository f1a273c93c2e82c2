"""What a user of logs can put right. `xitl_cli.main` prints it as it prints UserError, and exits with 2.

LogError
└── UnknownNameError    (a KeyError too)
"""


class LogError(Exception):
    """One sentence: the problem, its place, and the fix."""


class UnknownNameError(LogError, KeyError):
    """A log has no such message, or a message no such field; the sentence has the nearest name."""

    def __str__(self) -> str:
        return str(self.args[0])
