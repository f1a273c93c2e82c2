"""Shipped profiles. Several tests read all of them, which takes seconds."""

from __future__ import annotations

from functools import cache

from xitl_cli.profile import load_with_origins
from xitl_cli.profile.load import LoadedProfile


@cache
def shipped(name: str) -> LoadedProfile:
    """Return a shipped profile, loaded once in a process."""
    return load_with_origins(name)
