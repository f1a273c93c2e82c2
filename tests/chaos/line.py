"""The cables between a host and its boards: a UDP proxy whose paths can be cut and exchanged, and that counts."""

from __future__ import annotations

import selectors
import socket
import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field

from agent.wire import dialect

LONGEST_BYTES = 65535
BUFFER_BYTES = 1 << 22
TALKS_S = 0.3
_HEAD, _TAIL, _SIGNATURE = 10, 2, 13


@dataclass
class Cable:
    """One path. board_port: of the program at its far end. Counts are of MAVLink frames of the present run."""

    host_side: socket.socket
    board_port: int
    board_side: socket.socket = field(default_factory=lambda: _udp())
    host: tuple[str, int] | None = None
    heard_s: float = 0.0
    """When the board was last heard, on the monotonic clock."""
    withheld_to_agent: int = 0
    withheld_from_agent: int = 0


class Line(threading.Thread):
    """Forwards datagrams of several cables, by name. sim_s: simulation time of the newest sample of the IMU.

    cut: names of the cables that pass nothing. swapped: whether the far ends of all cables are exchanged.
    """

    def __init__(self, board_ports: Mapping[str, int]) -> None:
        super().__init__(name="line", daemon=True)
        self.cut: frozenset[str] = frozenset()
        self.swapped = False
        self.sim_s = 0.0
        self.cables = {name: Cable(_udp(0), port) for name, port in board_ports.items()}
        self._lock = threading.Lock()
        self._stopped = threading.Event()
        self._selector = selectors.DefaultSelector()
        for name, cable in self.cables.items():
            self._selector.register(cable.host_side, selectors.EVENT_READ, (name, True))
            self._selector.register(cable.board_side, selectors.EVENT_READ, (name, False))

    def host_url(self, name: str) -> str:
        """Address that the host gets as that of the board."""
        return f"udp://127.0.0.1:{self.cables[name].host_side.getsockname()[1]}"

    def begin_run(self) -> None:
        """Plug all cables in anew: the boards see another sender, as of a program that was started again."""
        with self._lock:
            self.cut, self.swapped, self.sim_s = frozenset(), False, 0.0
            for name, cable in self.cables.items():
                self._selector.unregister(cable.board_side)
                cable.board_side.close()
                cable.board_side = _udp()
                cable.host = None
                cable.withheld_to_agent = cable.withheld_from_agent = 0
                self._selector.register(cable.board_side, selectors.EVENT_READ, (name, False))

    def talks(self, name: str) -> bool:
        """Whether the board of a cable was heard just now."""
        return time.monotonic() - self.cables[name].heard_s < TALKS_S

    def run(self) -> None:
        while not self._stopped.is_set():
            ready = self._selector.select(0.1)
            with self._lock:
                for key, _ in ready:
                    name, of_host = key.data
                    with suppress(BlockingIOError, ConnectionRefusedError, ValueError, OSError):
                        while True:
                            self._forward(name, of_host)

    def stop(self) -> None:
        """End the thread and close all sockets."""
        self._stopped.set()
        self.join()
        for cable in self.cables.values():
            cable.host_side.close()
            cable.board_side.close()

    def _forward(self, name: str, of_host: bool) -> None:
        cable = self.cables[name]
        data, source = (cable.host_side if of_host else cable.board_side).recvfrom(LONGEST_BYTES)
        passes = name not in self.cut
        withheld = not passes or self.swapped
        far = next(cable for name_of, cable in self.cables.items() if (name_of != name) == self.swapped)
        if of_host:
            cable.host = source
            for frame in frames(data):
                cable.withheld_to_agent += withheld
                if frame[7] | frame[8] << 8 | frame[9] << 16 == dialect.MAVLINK_MSG_ID_XITL_IMU:
                    self.sim_s = int.from_bytes(frame[_HEAD : _HEAD + 8], "little") * 1e-6
            if passes:
                cable.board_side.sendto(data, ("127.0.0.1", far.board_port))
            return
        cable.heard_s = time.monotonic()
        if source[1] == cable.board_port:  # another board, which has no run, may answer on a swapped cable
            cable.withheld_from_agent += withheld * sum(1 for _ in frames(data))
        if passes and far.host is not None:
            far.host_side.sendto(data, far.host)


def frames(data: bytes) -> Iterator[bytes]:
    """Yield the MAVLink 2 frames of a datagram."""
    at = 0
    while at + _HEAD <= len(data) and data[at] == 0xFD:
        size = _HEAD + data[at + 1] + _TAIL + _SIGNATURE * (data[at + 2] & 1)
        yield data[at : at + size]
        at += size


def _udp(port: int = 0) -> socket.socket:
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.bind(("127.0.0.1", port))
    sock.setblocking(False)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
    return sock
