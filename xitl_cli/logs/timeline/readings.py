"""Two clocks, read at the same events."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

Instants = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Readings:
    """(N,) instants on two clocks.

    key: stable name for machines. first, second: what the clocks are. at_ns: (N,) on the log's own time.
    late: the second was read after what the first stands for, by a delay that has a floor and no ceiling; else the
    errors have no preferred sign. floor_ns: of an exchange, the least offset that each one leaves possible, as second
    less first is the greatest; None else. resolution_s: the coarser clock's step. slack_s: by how
    much a reading may be of the event before or after. message, fields: where they are from.
    """

    key: str
    first: str
    second: str
    at_ns: Instants
    first_ns: Instants
    second_ns: Instants
    message: str
    fields: str
    late: bool = False
    floor_ns: Instants | None = None
    resolution_s: float = 0.0
    slack_s: float = 0.0

    def __len__(self) -> int:
        return len(self.first_ns)

    def __getitem__(self, rows: slice | NDArray[np.bool_] | NDArray[np.intp]) -> Readings:
        return replace(
            self,
            at_ns=self.at_ns[rows],
            first_ns=self.first_ns[rows],
            second_ns=self.second_ns[rows],
            floor_ns=None if self.floor_ns is None else self.floor_ns[rows],
        )

    @property
    def offset_ns(self) -> Instants:
        """(N,) second less first; of an exchange the greatest possible."""
        return self.second_ns - self.first_ns

    @property
    def level_ns(self) -> Instants:
        """(N,) the likeliest offset: of an exchange half way between the bounds."""
        offset_ns = self.offset_ns
        return offset_ns if self.floor_ns is None else self.floor_ns + (offset_ns - self.floor_ns) // 2

    def within(self, farthest_ns: int) -> Readings:
        """Without what is farther from the zero of its clock, which no clock shows."""
        clocks = [self.first_ns, self.second_ns] if self.floor_ns is None else [
            self.first_ns, self.second_ns, self.floor_ns,
        ]  # fmt: skip
        good = np.ones(len(self), dtype=np.bool_)
        for clock_ns in clocks:
            good &= (clock_ns > -farthest_ns) & (clock_ns < farthest_ns)
        return self if good.all() else self[good]

    def in_order(self) -> Readings:
        """Without what the first clock shows twice, or out of order: what comes after it went back is left out."""
        newest = np.maximum.accumulate(self.first_ns)
        ahead = np.ones(len(self), dtype=np.bool_)
        ahead[1:] = self.first_ns[1:] > newest[:-1]
        return self if ahead.all() else self[ahead]

    def thinned(self, most: int) -> Readings:
        """The best of each of `most` groups of equal size: the least delayed, else the one in the middle."""
        if len(self) <= most:
            return self
        group = np.arange(len(self)) * most // len(self)
        offset_ns = self.offset_ns
        if self.floor_ns is not None:
            badness = offset_ns - self.floor_ns
        elif self.late:
            badness = offset_ns
        else:
            badness = np.zeros(len(self), dtype=np.int64)
        order = np.lexsort((badness, group))
        starts = np.searchsorted(group[order], np.arange(most))
        if self.floor_ns is None and not self.late:
            order = np.lexsort((offset_ns, group))
            ends = np.append(starts[1:], len(self))
            starts = (starts + ends) // 2
        return self[np.sort(order[starts])]
