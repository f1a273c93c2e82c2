"""The folder for downloaded and generated files of xitl."""

from __future__ import annotations

import os
from pathlib import Path

from xitl_cli.paths import user_path


def cache_root() -> Path:
    """Return XITL_CACHE, otherwise XDG_CACHE_HOME/xitl, otherwise ~/.cache/xitl.

    It is an absolute path, which need not exist.
    """
    own = os.environ.get("XITL_CACHE")
    if own:
        return user_path(own).absolute()
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base).absolute() if base else Path.home() / ".cache") / "xitl"
