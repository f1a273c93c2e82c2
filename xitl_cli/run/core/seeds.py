"""One seed for a run, an independent stream for each thing that draws from it."""

from __future__ import annotations

from zlib import crc32

from numpy.random import SeedSequence


class Seeds:
    """`of(name)` depends on seed and name alone, so that a new sensor leaves the others' noise as it was."""

    def __init__(self, seed: int) -> None:
        self._seed = seed

    def sequence(self, name: str) -> SeedSequence:
        """The stream called `name`."""
        return SeedSequence(self._seed, spawn_key=(crc32(name.encode()),))
