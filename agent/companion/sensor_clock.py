"""Which instant of this machine's clock a stamp of the sensors' clock is."""

from __future__ import annotations

WINDOW_NS = 20_000_000_000


class SensorClock:
    """The shortest way a cloud has taken of late is taken for none: what came faster than all others came at once.

    In lockstep both clocks are one.
    """

    def __init__(self, lockstep: bool) -> None:
        self._lockstep = lockstep
        self._since_ns: int | None = None
        self._least_ns: int | None = None
        self._before_ns: int | None = None

    def arrived(self, stamp_ns: int, now_ns: int) -> None:
        """Something that was whole at `stamp_ns` came at `now_ns`."""
        took_ns = now_ns - stamp_ns
        if self._since_ns is None or now_ns - self._since_ns > WINDOW_NS:
            self._since_ns, self._before_ns, self._least_ns = now_ns, self._least_ns, took_ns
        elif self._least_ns is None or took_ns < self._least_ns:
            self._least_ns = took_ns

    def own_ns(self, stamp_ns: int) -> int:
        """On this machine's clock."""
        if self._lockstep or self._least_ns is None:
            return stamp_ns
        least_ns = self._least_ns if self._before_ns is None else min(self._least_ns, self._before_ns)
        return stamp_ns + least_ns
