"""What a user of logs can put right. `xitl_cli.main` prints it as it prints UserError, and exits with 2."""


class LogError(Exception):
    """One sentence: what is wrong, where, and how to put it right."""
