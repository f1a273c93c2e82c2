"""Quantiles of an endless stream in bounded memory."""

from __future__ import annotations


class Histogram:
    """Counts nanoseconds in buckets 1/32 of their power of two wide: quantiles to 3 %, the maximum exact."""

    def __init__(self) -> None:
        self._buckets: dict[int, int] = {}
        self.count = 0
        self.max_ns = 0

    def add(self, value_ns: int) -> None:
        """Count one value; a negative one (clocks aligned to less than it) counts as 0."""
        value_ns = max(value_ns, 0)
        shift = max(value_ns.bit_length() - 6, 0)
        bucket = (shift << 6) + (value_ns >> shift)
        self._buckets[bucket] = self._buckets.get(bucket, 0) + 1
        self.count += 1
        self.max_ns = max(self.max_ns, value_ns)

    def quantile_ns(self, share: float) -> int | None:
        """The value below which `share` of all values lie, None when there are none."""
        if not self.count:
            return None
        left = share * self.count
        for bucket in sorted(self._buckets):
            left -= self._buckets[bucket]
            if left <= 0:
                shift, top = bucket >> 6, bucket & 63
                return min((top << shift) + (1 << shift >> 1), self.max_ns)
        return self.max_ns
