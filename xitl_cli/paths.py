"""Paths as a user writes them."""

from __future__ import annotations

import os
from pathlib import Path


def user_path(name: str) -> Path:
    """Return the path of `name` with `~` and `~user` replaced by home folders. An unknown user's stays as it is."""
    return Path(os.path.expanduser(name))  # noqa: PTH111 - Path.expanduser() raises for an unknown user
