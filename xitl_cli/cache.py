"""The folder where xitl keeps what it fetched or made once."""

from __future__ import annotations

import os
from pathlib import Path


def cache_root() -> Path:
    """XITL_CACHE, else XDG_CACHE_HOME/xitl, else ~/.cache/xitl: an absolute path, which need not exist."""
    own = os.environ.get("XITL_CACHE")
    if own:
        return Path(own).expanduser().absolute()
    base = os.environ.get("XDG_CACHE_HOME")
    return (Path(base).absolute() if base else Path.home() / ".cache") / "xitl"
