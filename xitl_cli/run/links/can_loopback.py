"""A CAN bus without hardware: two slcan adapters on pseudo-terminals, arbitration, the pace of the bit rates."""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

from agent.wire.can_transfer import FD_LENGTHS, CanLine
from xitl_cli.run.links.pty_pair import PtyPair

MOST_FRAMES = 256  # that an adapter keeps; the computer keeps the rest
SHORTEST_LINE, LONGEST_LINE = 6, 140
_IDENTIFIERS = {b"t": 3, b"T": 8, b"d": 3, b"D": 8, b"b": 3, b"B": 8}  # digits; capital letters: 29 bits
_END = b"\r"


class _Frame(NamedTuple):
    line: bytes
    identifier: int
    took_s: float


class CanLoopback(PtyPair):
    """Two nodes of a bus, each opened by its URL; `line` says how fast the bus is.

    Of the frames that wait at the two nodes the one with the lower identifier goes first, each node's own in order.
    Commands to the adapters (bit rates, open, close) are heard and change nothing. Raises UserError where there are no
    pseudo-terminals.
    """

    def __init__(self, line: CanLine) -> None:
        self._line = line
        self._text = [b"", b""]
        self._waiting: tuple[deque[_Frame], deque[_Frame]] = deque(), deque()
        self._on_bus: tuple[int, _Frame] | None = None
        self._free_at_s = 0.0
        super().__init__("can://slcan/pty")
        rates = f"bitrate={line.bitrate}" + (f"&fd=true&data_bitrate={line.data_bitrate}" if line.fd else "")
        self.host_url, self.agent_url = (f"can://slcan{device}?{rates}&sleep_after_open=0" for device in self.devices)

    def _room(self, end: int) -> int:
        return max(MOST_FRAMES - len(self._waiting[end]), 0) * SHORTEST_LINE

    def _take(self, end: int, data: bytes, now_s: float) -> None:
        if not self._busy():
            self._free_at_s = max(self._free_at_s, now_s)
        *lines, rest = (self._text[end] + data).split(_END)
        self._text[end] = rest[-LONGEST_LINE:]
        self._waiting[end].extend(frame for frame in map(self._frame, lines) if frame is not None)

    def _frame(self, text: bytes) -> _Frame | None:
        digits = _IDENTIFIERS.get(text[:1])
        if digits is None:
            return None
        try:
            identifier = int(text[1 : 1 + digits], 16)
            length = FD_LENGTHS[int(text[1 + digits : 2 + digits], 16)]
        except ValueError:
            return None
        if len(text) != 2 + digits + 2 * length:
            return None
        rank = identifier if digits == 8 else identifier << 18
        return _Frame(text + _END, rank, self._line.frame_s(min(length, self._line.part_bytes)))

    def _due(self, now_s: float) -> list[tuple[int, bytes]]:
        arrived: list[tuple[int, bytes]] = []
        while True:
            if self._on_bus is None:
                ready = [end for end in (0, 1) if self._waiting[end]]
                if not ready:
                    return arrived
                end = min(ready, key=lambda end: self._waiting[end][0].identifier)
                self._on_bus = end, self._waiting[end].popleft()
                self._free_at_s += self._on_bus[1].took_s
            if now_s < self._free_at_s:
                return arrived
            end, frame = self._on_bus
            arrived.append((1 - end, frame.line))
            self._on_bus = None

    def _busy(self) -> bool:
        return self._on_bus is not None or any(self._waiting)
