"""One seed for a run, an independent stream for each thing that draws from it."""

from __future__ import annotations

from zlib import crc32

from numpy.random import SeedSequence


class Seeds:
    """A stream depends on seed, vessel and name alone: a new sensor, or a new vessel, leaves the others' as they were.

    vessel: whose streams they are; empty for what belongs to the water, and for one vessel alone.
    """

    def __init__(self, seed: int, vessel: str = "") -> None:
        self._seed = seed
        self._before = f"{vessel}/" if vessel else ""

    def sequence(self, name: str) -> SeedSequence:
        """The stream called `name`."""
        return SeedSequence(self._seed, spawn_key=(crc32(f"{self._before}{name}".encode()),))
