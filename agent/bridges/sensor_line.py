"""The line on which a bridge plays a sensor: frames out in their order, commands in, and nothing ever waited for."""

from __future__ import annotations

from collections import Counter, deque

from agent.wire.transport import DATAGRAM_BYTES, Standing, Transport, open_transport

WAITING_FRAMES = 32  # 0.1 s of inertial frames at 200 Hz with those between them: older ones would only mislead
DATAGRAM_NS = 15_000_000  # between two datagrams: in lockstep it is every other tick of 10 ms
BACKLOG_S = 0.02  # what may lie in the system's buffer of a line before frames wait here, where they can be dropped
LISTEN = "?listen"


def open_line(url: str) -> SensorLine:
    """Open the URL of a sensor's line; with `?listen` at its end we wait there to be called. Raises TransportError.

    tcp://127.0.0.1:5765 calls an autopilot that serves its port, udp://127.0.0.1:14800?listen waits for one that is a
    client, serial:///dev/ttyUSB0?baud=921600 is the same for both.
    """
    listen = url.endswith(LISTEN)
    return SensorLine(open_transport(url[: -len(LISTEN)] if listen else url, listen))


class SensorLine:
    """Frames go out at once on a stream, and bundled on datagrams: an ArduPilot reads one datagram in 10 ms, on Linux
    and in software in the loop, and more than that would pile up in front of it without an end.

    Frames that the line does not take wait, a few of them; when too many do, the oldest is dropped and counted.
    unsent: frames dropped so, or sent while nobody was there. sent: those that the line took, by kind.
    """

    def __init__(self, transport: Transport) -> None:
        self.unsent = 0
        self.sent: Counter[str] = Counter()
        self._transport = transport
        self._waiting: deque[tuple[bytes, str]] = deque()
        self._sent_ns: int | None = None

    @property
    def connected(self) -> bool:
        """Whether somebody is there, as far as the line can know."""
        return bool(self._transport.peer)

    @property
    def address(self) -> str:
        """Where it is, for people."""
        return self._transport.address

    def send(self, frame: bytes, kind: str = "") -> None:
        """Give a frame to the line; `flush` sends it on."""
        self._waiting.append((frame, kind))
        if len(self._waiting) > WAITING_FRAMES:
            self._waiting.popleft()
            self.unsent += 1

    def flush(self, now_ns: int) -> None:
        """Send on what waits, as far as the line takes it and it is time to; `now_ns` on the clock of the run."""
        waiting, transport = self._waiting, self._transport
        if not waiting:
            return
        if not transport.peer:
            self.unsent += len(waiting)
            waiting.clear()
        elif transport.stream:
            while waiting and transport.backlog_s() < BACKLOG_S and transport.send(waiting[0][0]):
                self.sent[waiting.popleft()[1]] += 1
        elif self._sent_ns is None or not 0 <= now_ns - self._sent_ns < DATAGRAM_NS:
            self._sent_ns = now_ns
            self._send_bundled()

    def _send_bundled(self) -> None:
        waiting = self._waiting
        bundle, count = b"", 0
        for frame, _ in waiting:
            if count and len(bundle) + len(frame) > DATAGRAM_BYTES:
                break
            bundle += frame
            count += 1
        if not self._transport.send(bundle):
            return
        for _ in range(count):
            self.sent[waiting.popleft()[1]] += 1

    def receive(self) -> list[bytes]:
        """What has come in. Looks for the other end too, where one has to be found."""
        return self._transport.receive(0.0)

    def heard(self, index: int) -> bool:
        """Chunk `index` of the last `receive` made sense: its sender is the other end. False when it is not."""
        return self._transport.credit(index, Standing.HEARD)

    def clear(self) -> None:
        """Forget what waits, and the counts."""
        self._waiting.clear()
        self._sent_ns = None
        self.unsent = 0
        self.sent.clear()

    def descriptors(self) -> tuple[int, ...]:
        """What becomes readable with bytes from the other end."""
        descriptor = self._transport.fileno()
        return () if descriptor is None else (descriptor,)

    def close(self) -> None:
        """Give the line back."""
        self._transport.close()
