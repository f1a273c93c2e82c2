"""xitl's own plug-ins. Each registers by entry points in `pyproject.toml`, as those of other packages do.

A plug-in imports the core (the rest of `xitl_cli`, and `xitl_cli.logs`) and no other plug-in. The core imports none.
"""
