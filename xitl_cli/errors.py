"""Errors that a user can fix.

    UserError
    └── ProfileError    (xitl_cli.profile.files.entry: every problem of one profile)
    LogError            (xitl_cli.logs.model.errors: the logs import nothing of xitl_cli)

Libraries raise these with one sentence: the problem, its place and the fix. `xitl_cli.main` prints it and exits 2.
"""


class UserError(Exception):
    """One line for the user: the problem, its place, and the fix. No traceback is shown."""
