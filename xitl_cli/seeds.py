"""One seed for a run, with an independent random stream for each user."""

from __future__ import annotations

from zlib import crc32

from numpy.random import SeedSequence


class Seeds:
    """Random streams of a run.

    A stream depends only on seed, vessel and name, so a new sensor or vessel changes no other.

    vessel: owner of the streams; empty for the water, and for a single vessel.
    """

    def __init__(self, seed: int, vessel: str = "") -> None:
        self._seed = seed
        self._before = f"{vessel}/" if vessel else ""

    def sequence(self, name: str) -> SeedSequence:
        """Return the stream called `name`."""
        return SeedSequence(self._seed, spawn_key=(crc32(f"{self._before}{name}".encode()),))
