"""The error of this room."""

from __future__ import annotations


class WorldError(Exception):
    """One sentence: what of the world cannot be had, and what to do."""
