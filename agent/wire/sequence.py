"""Which frames are missing, from the sequence numbers that each sender counts modulo 256."""

from __future__ import annotations

SENDERS = 64  # more than any link has; bounds what invented sender ids can cost
AHEAD = 128
SHUFFLED = 32  # a frame that comes late is not further behind than this


class _Sender:
    def __init__(self, expected: int) -> None:
        self.expected = expected
        self.missing: set[int] = set()
        self.checks: list[bytes | None] = [None] * 256


class SequenceMonitor:
    """Counts frames lost, late and repeated, per sender (system, component).

    A number up to 127 ahead of the expected one means that those between are lost. A number behind it is late when it
    was counted as lost (the loss is then taken back), and repeated when the frame that had it last has the same check
    value. So frames sent = frames received - repeated + lost, as long as fewer than 128 are lost in a row. When more
    are, the numbers cannot tell how many: lost is then too low, but nothing is taken for repeated that was not.
    """

    def __init__(self) -> None:
        self.lost = 0
        self.late = 0
        self.repeated = 0
        self._senders: dict[int, _Sender] = {}

    def note(self, system_id: int, component_id: int, sequence: int, check: bytes = b"") -> None:
        """A frame arrived; `check` is what differs between frames of one number: checksum or signature."""
        key = system_id << 8 | component_id
        sender = self._senders.get(key)
        if sender is None:
            if len(self._senders) >= SENDERS:
                del self._senders[next(iter(self._senders))]
            self._senders[key] = sender = _Sender((sequence + 1) & 0xFF)
            sender.checks[sequence] = check
            return
        missing, checks = sender.missing, sender.checks
        if sequence == sender.expected:
            sender.expected = (sequence + 1) & 0xFF
            checks[sequence] = check
            if missing:
                missing.discard((sequence + AHEAD) & 0xFF)
            return
        gap = (sequence - sender.expected) & 0xFF
        if gap < AHEAD:
            self.lost += gap
            for number in range(sender.expected, sender.expected + gap):
                missing.add(number & 0xFF)
                missing.discard((number + AHEAD) & 0xFF)
            missing.discard((sequence + AHEAD) & 0xFF)
            sender.expected = (sequence + 1) & 0xFF
        elif sequence in missing:
            missing.discard(sequence)
            self.lost -= 1
            self.late += 1
        elif checks[sequence] == check:
            self.repeated += 1
        elif gap >= 256 - SHUFFLED:  # from before the first, or more were lost than the numbers can tell
            self.late += 1
        else:
            self.lost += gap
            missing.clear()
            sender.expected = (sequence + 1) & 0xFF
        checks[sequence] = check

    def reset(self) -> None:
        """Forget all senders and counts."""
        self.lost = self.late = self.repeated = 0
        self._senders.clear()
