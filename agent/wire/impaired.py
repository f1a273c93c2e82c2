"""Link faults: a transport that loses, delays, repeats and reorders its outgoing frames, repeatably by a seed."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from random import Random
from time import monotonic
from typing import Callable

from agent.wire.transport import SenderStatus, Transport

MOST_DELAYED = 4096  # frames: two seconds of the busiest link
OVERTAKEN_S = 0.1  # longest wait of a frame for another one that overtakes it


@dataclass(frozen=True)
class LinkFaults:
    """Faults of one direction of a link. All zeros mean a good link."""

    delay_s: float = 0.0
    """Delay of every frame. Delay and jitter alone never change the order."""
    jitter_s: float = 0.0
    """Largest additional delay, uniformly distributed."""
    loss: float = 0.0
    """Share of lost frames, 0 to 1."""
    duplicate: float = 0.0
    """Share of frames that are sent twice, 0 to 1."""
    reorder: float = 0.0
    """Share of frames that the next one overtakes, 0 to 1.

    Overtaking frames and duplicated frames are not overtaken.
    """
    cut: bool = False
    """No frame passes."""


NO_FAULTS = LinkFaults()


class ImpairedTransport(Transport):
    """Another transport, `inner`, with faults on its outgoing frames. Incoming frames are unchanged.

    Faults act on complete frames, so `datagram_bytes` is 0 while faults are active: a link then sends each frame
    separately. Frames with an `exempt` message number are sent at once.
    clock_s: clock of the delays.

    patience_s: longest wait of a frame for another one that overtakes it; inf if time does not advance by itself.
    lost: frames that never reached `inner`, or that it refused after their delay.
    duplicated, reordered: frames that were sent twice, and overtaken.
    """

    def __init__(
        self,
        inner: Transport,
        exempt: Callable[[int], bool] = lambda message_id: False,
        clock_s: Callable[[], float] = monotonic,
    ) -> None:
        super().__init__(inner.address)
        self.inner = inner
        self.name, self.stream, self.learns_peer = inner.name, inner.stream, inner.learns_peer
        self.serves_one = inner.serves_one
        self.datagram_bytes = inner.datagram_bytes
        self.capacity_bps = inner.capacity_bps
        self.patience_s = OVERTAKEN_S
        self.lost = self.duplicated = self.reordered = 0
        self._exempt = exempt
        self._clock_s = clock_s
        self._in_force = NO_FAULTS, 0
        self._faulty = False
        self._rng = Random(0)
        self._delayed: deque[tuple[float, bytes]] = deque()  # due instants, ascending
        self._overtaken: tuple[float, bytes] | None = None  # instant since which it waits for the next frame

    @property
    def faults(self) -> LinkFaults:
        """Active faults."""
        return self._in_force[0]

    def set(self, faults: LinkFaults, seed: int = 0) -> None:
        """Set the faults. The same faults again change nothing.

        Frames delayed before keep their delay, and later frames remain behind them.
        """
        if (faults, seed) == self._in_force:
            return
        self._in_force = faults, seed
        self._faulty = faults != NO_FAULTS
        self._rng = Random(seed)
        self.datagram_bytes = 0
        self._release_overtaken(self._clock_s())
        self._flush()

    def send(self, data: bytes) -> bool:
        """See Transport. Returns True for a frame that a fault drops, because the sender on a bad link cannot know."""
        if not (self._faulty or self._delayed):
            return self.inner.send(data)
        if len(data) >= 10 and self._exempt(data[7] | data[8] << 8 | data[9] << 16):
            return self.inner.send(data)
        now_s, faults, rng = self._clock_s(), self._in_force[0], self._rng
        lost, jitter, twice, overtaken = rng.random(), rng.random(), rng.random(), rng.random()
        if faults.cut or lost < faults.loss:
            self.lost += 1
            return True
        due_s = now_s + faults.delay_s + jitter * faults.jitter_s
        if twice < faults.duplicate:
            self.duplicated += 1
            self._keep(due_s, data)
        elif overtaken < faults.reorder and self._overtaken is None:
            self.reordered += 1
            self._overtaken = max(due_s, self._last_due_s()), data
            return True
        elif due_s <= now_s and not self._delayed and self._overtaken is None:
            return self.inner.send(data)
        self._keep(due_s, data)
        self._release_overtaken(due_s)
        self._flush()
        return True

    def _last_due_s(self) -> float:
        return self._delayed[-1][0] if self._delayed else 0.0

    def _keep(self, due_s: float, data: bytes) -> None:
        if len(self._delayed) >= MOST_DELAYED:
            self._delayed.popleft()
            self.lost += 1
        self._delayed.append((max(due_s, self._last_due_s()), data))

    def _release_overtaken(self, due_s: float) -> None:
        if self._overtaken is not None:
            own_due_s, data = self._overtaken
            self._overtaken = None
            self._keep(max(own_due_s, due_s), data)

    def _flush(self) -> None:
        if self._overtaken is not None and self._clock_s() - self._overtaken[0] >= self.patience_s:
            self._release_overtaken(0.0)
        delayed = self._delayed
        while delayed and delayed[0][0] <= self._clock_s():
            self.lost += not self.inner.send(delayed.popleft()[1])
        if not (delayed or self._faulty):
            self.datagram_bytes = self.inner.datagram_bytes

    def receive(self, timeout_s: float = 0.0) -> list[bytes]:
        if not (self._delayed or self._overtaken is not None):
            return self.inner.receive(timeout_s)
        until_s = monotonic() + timeout_s
        while True:
            self._flush()
            wake_s = self.wake_s()
            left_s = until_s - monotonic()
            chunks = self.inner.receive(left_s if wake_s is None else min(left_s, wake_s))
            if chunks or monotonic() >= until_s:
                self._flush()
                return chunks

    def wake_s(self) -> float | None:
        waits = [self.inner.wake_s()]
        if self._delayed:
            waits.append(max(self._delayed[0][0] - self._clock_s(), 0.0))
        if self._overtaken is not None:
            waits.append(max(self._overtaken[0] + self.patience_s - self._clock_s(), 0.0))
        return min((wait for wait in waits if wait is not None), default=None)

    def counts(self) -> dict[str, int]:
        own = {"impaired": self.lost, "duplicated": self.duplicated, "reordered": self.reordered}
        return {**self.inner.counts(), **own}

    def wait_for_room(self, timeout_s: float) -> bool:
        return self.inner.wait_for_room(timeout_s)

    def backlog_s(self) -> float:
        return self.inner.backlog_s()

    @property
    def peer(self) -> str:
        return self.inner.peer

    @property
    def strangers(self) -> int:  # type: ignore[override]
        return self.inner.strangers

    @property
    def stranger(self) -> str:  # type: ignore[override]
        return self.inner.stranger

    def accept_sender(self, index: int, standing: SenderStatus) -> bool:
        return self.inner.accept_sender(index, standing)

    def fileno(self) -> int | None:
        return self.inner.fileno()

    def close(self) -> None:
        """Close `inner`. Delayed frames are lost."""
        self.lost += len(self._delayed) + (self._overtaken is not None)
        self._delayed.clear()
        self._overtaken = None
        self.inner.close()
