"""A serial line without hardware, at the pace of a baud rate."""

from __future__ import annotations

from agent.wire.serial_line import BITS_PER_BYTE
from xitl_cli.run.links.pty_pair import PtyPair

BUFFER_BYTES = 4096  # as of a UART's driver; what comes when it is full stays with the sender


class SerialLoopback(PtyPair):
    """Two ends, each opened by its URL. Carries `baud` / 10 bytes a second each way, as a line with start and stop bit.

    Bytes come out when a real line would have brought them, to about a millisecond. Raises UserError where there are
    no pseudo-terminals.
    """

    def __init__(self, baud: int) -> None:
        if baud <= 0:
            raise ValueError(f"serial loopback: baud = {baud}; use more than 0")
        self._byte_s = BITS_PER_BYTE / baud
        self._held = [b"", b""]
        self._through_s = [0.0, 0.0]  # until then the bytes that came out have occupied the line
        super().__init__("serial://pty")
        self.host_url, self.agent_url = (f"serial://{device}?baud={baud}" for device in self.devices)

    def _room(self, end: int) -> int:
        return BUFFER_BYTES - len(self._held[end])

    def _take(self, end: int, data: bytes, now_s: float) -> None:
        if not self._held[end]:
            self._through_s[end] = max(self._through_s[end], now_s)
        self._held[end] += data

    def _due(self, now_s: float) -> list[tuple[int, bytes]]:
        arrived = []
        for end, held in enumerate(self._held):
            count = min(int((now_s - self._through_s[end]) / self._byte_s), len(held))
            if count > 0:
                self._through_s[end] += count * self._byte_s
                self._held[end] = held[count:]
                arrived.append((1 - end, held[:count]))
        return arrived

    def _busy(self) -> bool:
        return any(self._held)
