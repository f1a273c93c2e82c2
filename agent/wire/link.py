"""MAVLink messages over a transport, with every loss counted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from time import monotonic
from typing import Callable

from agent.wire.codec import (
    Message,
    MessageRefusedError,
    Packer,
    Prepared,
    decode,
    fits_mavlink1,
    frame_sequence,
    prepare,
)
from agent.wire.dialect import XITL_RUN_COMMAND_START, XITL_RUN_COMMAND_STOP, MAVLink_xitl_run_message
from agent.wire.framing import Framer, is_known, is_mavlink1
from agent.wire.priority import WaitingMessages
from agent.wire.signing import Signing
from agent.wire.transport import DATAGRAM_BYTES, SenderStatus, Transport

SENDERS = 64  # more than any link has; limits the cost of forged sender ids
ROUND = 256  # sequence numbers
AHEAD = 128
SHUFFLED = 32  # a late frame is at most this far behind


class _Sender:
    def __init__(self, expected: int) -> None:
        self.expected = expected
        self.missing: set[int] = set()
        self.checks: list[bytes | None] = [None] * 256


class SequenceMonitor:
    """Counts lost, late and repeated frames, by the sequence numbers of each sender (system, component).

    A number up to 127 ahead of the expected one means that the numbers between are lost. A number behind it is late if
    it was counted as lost, and the loss is then cancelled. It is repeated if the last frame with this number has the
    same check value, and of the next round otherwise. So frames sent = frames received - repeated + lost, as long as
    fewer than 256 consecutive frames are lost.

    Numbers wrap after 256. Of longer losses they show only the remainder, so `lost` is a lower bound until the sender
    reports its count (`heard_total`). That determines the rounds if fewer than 128 frames are then in transit or out of
    order. A sender that restarts adds up to 255 frames that were never sent.

    shares_numbers: two threads of a sender may use one number, as those of PX4 do. Another frame with the last number
    then means no loss.
    """

    def __init__(self, shares_numbers: bool = False) -> None:
        self._shares_numbers = shares_numbers
        self.late = self.repeated = 0
        self._numbers_lost = self._rounds = 0
        self._total = self._ahead = 0
        self._senders: dict[int, _Sender] = {}

    @property
    def lost(self) -> int:
        """Number of missing frames."""
        return self._numbers_lost + ROUND * self._rounds

    def note(self, system_id: int, component_id: int, sequence: int, check: bytes = b"") -> None:
        """Note a frame. check: distinguishes frames with the same number, by checksum or signature."""
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
            self._numbers_lost += gap
            for number in range(sender.expected, sender.expected + gap):
                missing.add(number & 0xFF)
                missing.discard((number + AHEAD) & 0xFF)
            missing.discard((sequence + AHEAD) & 0xFF)
            sender.expected = (sequence + 1) & 0xFF
        elif sequence in missing:
            missing.discard(sequence)
            self._numbers_lost -= 1
            self.late += 1
        elif checks[sequence] == check:
            self.repeated += 1
        elif checks[sequence] is None and gap >= ROUND - SHUFFLED:  # from before the first frame
            self.late += 1
        elif gap < ROUND - 1 or not self._shares_numbers:
            self._numbers_lost += gap
            missing.clear()
            missing.update((sequence - back) & 0xFF for back in range(1, SHUFFLED + 1))
            sender.expected = (sequence + 1) & 0xFF
        checks[sequence] = check

    def heard_total(self, sent: int, received: int) -> None:
        """Evaluate the sender's count: `sent` frames when `received` had arrived, each counted from any instant."""
        ahead = sent - (received - self.repeated + self._numbers_lost)
        if not self._total or sent < self._total:  # the first report, or the sender has restarted
            self._ahead = ahead - ROUND * self._rounds
        self._total = sent
        self._rounds = max(round((ahead - self._ahead) / ROUND), 0)

    def reset(self) -> None:
        """Reset all senders and counts."""
        self.late = self.repeated = 0
        self._numbers_lost = self._rounds = 0
        self._total = self._ahead = 0
        self._senders.clear()


__all__ = ["DATAGRAM_BYTES", "Link", "LinkCounters", "Tap"]

Tap = Callable[[str, bytes], None]

_STATUS = {XITL_RUN_COMMAND_START: SenderStatus.STARTS, XITL_RUN_COMMAND_STOP: SenderStatus.LEAVES}


def _status(messages: list[Message]) -> SenderStatus:
    for message in messages:
        if isinstance(message, MAVLink_xitl_run_message):
            return _STATUS.get(message.command, SenderStatus.HEARD)
    return SenderStatus.HEARD


@dataclass(frozen=True)
class LinkCounters:
    """Counts of a link since its creation or the last reset."""

    sent: int
    """Frames handed to the transport."""
    unsent: int
    """Frames that it refused (their sequence numbers are reused), and messages displaced while waiting for a slow line.
    """
    received: int
    """Good frames."""
    lost: int
    """See `SequenceMonitor` for this and the next two."""
    late: int
    repeated: int
    dropped_bad_crc: int
    """See `Framer` for this and the next three."""
    dropped_unknown: int
    dropped_truncated: int
    dropped_noise: int
    bytes_in: int
    """All bytes, valid or not, also in `bytes_out`."""
    bytes_out: int
    refused: int = 0
    """Good frames without an accepted signature, see `Signing`."""
    strangers: int = 0
    """Good frames of senders other than the peer, on a transport open to any sender, and datagrams that it refused
    unread.
    """

    @property
    def dropped(self) -> int:
        """Number of received events that were not good frames of the peer."""
        damaged = self.dropped_bad_crc + self.dropped_unknown + self.dropped_truncated + self.dropped_noise
        return damaged + self.strangers


class Link:
    """One end of a MAVLink 2 connection. The caller closes the transport.

    tap(direction, frame) is called with "tx" for every sent frame and "rx" for every good received frame, raw, in
    order.
    signing: signs frames as from link `link_id`. Frames that it refuses are counted in `refused_signature` and dropped.

    foreign: the other end has messages that the dialect lacks. They are counted in `passed` and dropped, and their
      sequence numbers count.
    mavlink1: the other end may use MAVLink 1. It gets MAVLink 1 until it sends a MAVLink 2 frame.

    wait_for_room: called before each send, to wait for a transport without room. None by default: frames without room
    are unsent, and a run in real time continues.

    On a transport with a capacity, messages that are not urgent wait until the line has room. `WaitingMessages` holds
    them, `receive` sends them, and `wake_s` returns when to call it.
    """

    def __init__(
        self,
        transport: Transport,
        system_id: int,
        component_id: int,
        tap: Tap | None = None,
        signing: Signing | None = None,
        link_id: int = 0,
        foreign: bool = False,
        mavlink1: bool = False,
    ) -> None:
        self.transport = transport
        self.tap = tap
        self.wait_for_room: Callable[[], object] | None = None
        self.refused_signature = 0
        self._signing = signing
        self._link_id = link_id
        self._packer = Packer(system_id, component_id, None if signing is None else signing.outgoing(link_id))
        self._others: dict[tuple[int, int], Packer] = {}
        self._framer = Framer(transport.stream, foreign, mavlink1)
        self._may_be_mavlink1 = mavlink1
        self._asks_sender = transport.learns_peer or transport.serves_one
        self._foreign = foreign
        self.passed = 0
        self._sequence = SequenceMonitor(foreign)
        self._sent = self._unsent = self._received = self._bytes_out = self._refused_before = 0
        self._strangers = self._strangers_before = 0
        self._waiting: WaitingMessages | None = None
        self._receive = transport.receive
        self._until_s = 0.0
        if transport.capacity_bps is not None:
            self._waiting = WaitingMessages(transport, self._hand_on_prepared)
            self._receive = self._flush_and_receive

    def go_through(self, transport: Transport) -> None:
        """Send and receive by another transport that leads to the present one."""
        self.transport = transport
        if self._waiting is None:
            self._receive = transport.receive
        else:
            self._waiting.transport = transport

    @property
    def system_id(self) -> int:
        """System id of this end."""
        return self._packer.system_id

    @property
    def component_id(self) -> int:
        """Component id of this end."""
        return self._packer.component_id

    def send(self, *messages: Message) -> bool:
        """Send messages in order, in as few datagrams as possible. Return False when the transport did not accept all.

        Raises MessageRefusedError when a field does not fit the wire. Then no message of this call is sent. Returns
        True for a message that waits for its turn.
        """
        return self.send_prepared([prepare(message) for message in messages])

    def send_prepared(self, messages: Sequence[Prepared]) -> bool:
        """Send prepared messages in the same way."""
        if self._packer.mavlink1:
            for message, _ in messages:
                if not fits_mavlink1(message):
                    raise MessageRefusedError(f"{message.get_type()}: the other end uses MAVLink 1, which lacks it")
        if self._waiting is not None:
            return self._waiting.send(messages)
        packer = self._packer
        return self._send_frames([packer.pack_prepared(message) for message in messages])

    def pass_on(self, *messages: Message) -> bool:
        """Forward messages of other senders under their ids, with a separate sequence for each. See `send`.

        A line with a capacity sends them under this end's id.
        """
        if self._waiting is not None:
            return self.send(*messages)
        frames = []
        for message in messages:
            sender = (message.get_srcSystem(), message.get_srcComponent())
            packer = self._others.get(sender)
            if packer is None:
                signing = None if self._signing is None else self._signing.outgoing(self._link_id)
                packer = self._others[sender] = Packer(*sender, signing)
            frames.append(packer.pack_prepared(prepare(message)))
        return self._send_frames(frames)

    def _send_frames(self, frames: list[bytes]) -> bool:
        if len(frames) == 1:
            return self._hand_on(frames, frames[0], frame_sequence(frames[0]))
        most = self.transport.datagram_bytes
        while frames:
            size = count = 0
            for frame in frames:
                size += len(frame)
                if count and size > most:
                    break
                count += 1
            if not self._hand_on(frames[:count], b"".join(frames[:count]), frame_sequence(frames[0])):
                self._unsent += len(frames) - count
                return False
            frames = frames[count:]
        return True

    def _hand_on_prepared(self, prepared: Prepared) -> bool:
        frame = self._packer.pack_prepared(prepared)
        taken = self._hand_on([frame], frame, frame_sequence(frame))
        self._unsent -= not taken  # the message may wait, which the caller counts
        return taken

    def _hand_on(self, frames: list[bytes], data: bytes, start: int) -> bool:
        if self.wait_for_room is not None:
            self.wait_for_room()
        if not self.transport.send(data):
            if not self._others:
                self._packer.sequence = start
            self._unsent += len(frames)
            return False
        self._sent += len(frames)
        self._bytes_out += len(data)
        if self.tap is not None:
            for frame in frames:
                self.tap("tx", frame)
        return True

    def receive(self, timeout_s: float = 0.0) -> list[Message]:
        """Return the messages that have arrived, in order. Wait for bytes at most timeout_s.

        Bytes without a good frame end the wait too, except on a slow line, which delivers frames in pieces. No received
        bytes raise. Each message has its sender and sequence number (get_srcSystem(), ...).
        """
        transport, note, tap = self.transport, self._sequence.note, self.tap
        messages: list[Message] = []
        while True:
            for index, chunk in enumerate(self._receive(timeout_s)):
                frames = self._framer.feed(chunk)
                if self._signing is not None:
                    accepted = [frame for frame in frames if self._signing.accepts(frame)]
                    self.refused_signature += len(frames) - len(accepted)
                    frames = accepted
                if self._foreign:
                    heard = [decode(frame) for frame in frames if is_known(frame)]
                    self.passed += len(frames) - len(heard)
                else:
                    heard = list(map(decode, frames))
                if frames and self._asks_sender and not transport.accept_sender(index, _status(heard)):
                    self._strangers += len(frames)
                    continue
                if self._may_be_mavlink1 and frames:
                    self._packer.mavlink1 = self._may_be_mavlink1 = all(map(is_mavlink1, frames))
                for frame in frames:
                    note(frame[5], frame[6], frame[4], frame[-2:])
                    if tap is not None:
                        tap("rx", frame)
                messages += heard
            if self._waiting is None:
                break
            self._waiting.heard(messages)
            timeout_s = self._until_s - monotonic()
            if messages or timeout_s <= 0.0:
                break
        self._received += len(messages)
        return messages

    def _flush_and_receive(self, timeout_s: float = 0.0) -> list[bytes]:
        assert self._waiting is not None
        self._until_s = monotonic() + timeout_s
        while True:
            self._waiting.flush()
            left_s = self._until_s - monotonic()
            wake_s = self._waiting.wake_s()
            chunks = self.transport.receive(left_s if wake_s is None else min(left_s, wake_s))
            if chunks or monotonic() >= self._until_s:
                return chunks

    @property
    def waiting(self) -> int:
        """Number of messages that wait for the line."""
        return 0 if self._waiting is None else len(self._waiting)

    def wake_s(self) -> float | None:
        """Seconds until `receive` should be called even without bytes, None for never."""
        own_s = None if self._waiting is None else self._waiting.wake_s()
        transport_s = self.transport.wake_s()
        if own_s is None or transport_s is None:
            return transport_s if own_s is None else own_s
        return min(own_s, transport_s)

    @property
    def counters(self) -> LinkCounters:
        """Counts so far."""
        framing, sequence = self._framer.counters, self._sequence
        return LinkCounters(
            sent=self._sent,
            unsent=self._unsent + (0 if self._waiting is None else self._waiting.given_up),
            received=self._received,
            lost=sequence.lost,
            late=sequence.late,
            repeated=sequence.repeated,
            dropped_bad_crc=framing.dropped_bad_crc,
            dropped_unknown=framing.dropped_unknown,
            dropped_truncated=framing.dropped_truncated,
            dropped_noise=framing.dropped_noise,
            bytes_in=framing.bytes_in,
            bytes_out=self._bytes_out,
            refused=self.refused_signature - self._refused_before,
            strangers=self.strangers,
        )

    @property
    def strangers(self) -> int:
        """Same count as in `counters`."""
        return self._strangers + self.transport.strangers - self._strangers_before

    def heard_total(self, sent: int, received: int) -> None:
        """Evaluate the number of frames that the other end has sent, see `SequenceMonitor`."""
        self._sequence.heard_total(sent, received)

    def reset_counters(self) -> None:
        """Reset the counts and the senders, as at the start of a run. The own sequence number continues."""
        self._sent = self._unsent = self._received = self._bytes_out = self._strangers = self.passed = 0
        self._strangers_before = self.transport.strangers
        self._refused_before = self.refused_signature
        if self._waiting is not None:
            self._waiting.given_up = 0
        self._framer.reset_counters()
        self._sequence.reset()
