"""The plug-ins of xitl. Each registers by entry points in `pyproject.toml`, like the plug-ins of other packages.

A plug-in imports the core (the rest of `xitl_cli`, and `xitl_cli.logs`) and no other plug-in. The core imports none.
"""
