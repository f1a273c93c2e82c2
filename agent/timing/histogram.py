"""Times counted by their power of two: cheap to note, small to send, exact enough for a tail.

Bin 0 counts what is below 2 us, bin k from 2^k us to below 2^(k+1) us, the last bin all that is longer.
"""

from __future__ import annotations

from collections.abc import Sequence

BINS = 16
EMPTY = (0,) * BINS


def bin_of(duration_ns: int) -> int:
    """Which bin a time belongs to; below 0 to the first."""
    number = (duration_ns // 1000).bit_length() - 1 if duration_ns >= 2000 else 0
    return number if number < BINS else BINS - 1


def quantile_us(histogram: Sequence[int], share: float, longest_us: int) -> int:
    """The time that `share` of all counted did not exceed, as far as the bins tell: the upper edge of its bin.

    At most `longest_us`, the longest time counted; 0 when nothing was.
    """
    wanted = share * sum(histogram)
    counted = 0
    for number, count in enumerate(histogram):
        counted += count
        if count and counted >= wanted:
            return longest_us if number == BINS - 1 else min(2 << number, longest_us)
    return 0
