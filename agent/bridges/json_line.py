"""Socket of ArduPilot's JSON simulator interface: servo packets in, frames out, and the count of unanswered frames.

A servo packet is little-endian: magic u16, frame rate u16 (Hz), frame count u32, then the pulse widths u16 (us). There
are 16 pulse widths after magic 18458 and 32 after magic 29569. The answer is a line of JSON between newlines. ArduPilot
searches it for keys as plain text. So nothing may be between a key and its value, and a comma and one space separate
the numbers of a vector (libraries/SITL/SIM_JSON.cpp).
"""

from __future__ import annotations

import socket
import struct
import sys
from collections.abc import Sequence
from time import monotonic
from typing import Callable, NamedTuple
from urllib.parse import urlsplit

from agent.bridges.injector import InjectorCounters
from agent.timing.clock import wait_readable
from agent.wire.transport import BadUrlError
from agent.wire.urls import Address, address_url, resolve, transport_error

SLOWEST_HZ, FASTEST_HZ = 11, 20_000  # ArduPilot skips steps of 0.1 s and more
RANGEFINDERS = 6

_HEAD = struct.Struct("<HHI")
_PULSES = {18458: struct.Struct("<16H"), 29569: struct.Struct("<32H")}
_LENGTHS = {magic: _HEAD.size + pulses.size for magic, pulses in _PULSES.items()}
_IMU = '"gyro":[%.6f, %.6f, %.6f],"accel_body":[%.5f, %.5f, %.5f]'
_FRAME = (
    '\n{"timestamp":%.9f,"imu":{%s},"position":[%.5f, %.5f, %.5f],'
    '"quaternion":[%.7f, %.7f, %.7f, %.7f],"velocity":[%.5f, %.5f, %.5f]%s}'
)


class ServoHead(NamedTuple):
    """Request of a servo packet: the answer to `frame`, simulated at `rate_hz`."""

    rate_hz: int
    frame: int


def parse_servo_head(packet: bytes) -> ServoHead | None:
    """Parse the head of a servo packet. Return None for any other packet."""
    if len(packet) < _HEAD.size:
        return None
    magic, rate_hz, count = _HEAD.unpack_from(packet)
    if _LENGTHS.get(magic) != len(packet) or not SLOWEST_HZ <= rate_hz <= FASTEST_HZ:
        return None
    return ServoHead(rate_hz, count)


def read_pulses_us(packet: bytes) -> tuple[int, ...]:
    """Pulse widths in us, channel 1 first, of a packet with a valid head."""
    magic = packet[0] | packet[1] << 8
    return _PULSES[magic].unpack_from(packet, _HEAD.size)


def imu_text(gyro_frd_radps: Sequence[float], accel_frd_mps2: Sequence[float]) -> str:
    """Content of "imu": angular rate and specific force."""
    return _IMU % (*gyro_frd_radps, *accel_frd_mps2)


def extras_text(ranges_m: Sequence[float | None], wind: tuple[float, float] | None) -> str:
    """Optional keys: distances of rangefinders 1 to 6, and the apparent wind (direction in rad, speed in m/s)."""
    text = "".join(
        f',"rng_{number}":{range_m:.3f}' for number, range_m in enumerate(ranges_m, 1) if range_m is not None
    )
    if wind is not None:
        text += f',"windvane":{{"direction":{wind[0]:.4f},"speed":{wind[1]:.3f}}}'
    return text


def frame_text(time_s: float, imu: str, motion: tuple[float, ...], extras: str) -> str:
    """Return one answer.

    motion: position NED in m, quaternion body to NED (w first), velocity NED in m/s, ten numbers.
    """
    return _FRAME % (time_s, imu, *motion, extras)


def pack_datagrams(texts: Sequence[str]) -> list[bytes]:
    """Return the answers as datagrams of one length, so that one call can send them."""
    if not texts:
        return []
    length = max(map(len, texts))
    return [(text.ljust(length) + "\n").encode() for text in texts]


BATCH = 512
BUFFER_BYTES = 1 << 20
UDP_SEGMENT, SEGMENTS = 103, 64  # linux/udp.h: the option, and the most datagrams per call
ASKED_AGAIN_S = 0.5  # ArduPilot repeats a request after 1 s; an earlier repeat is a duplicate by the network


class JsonLine:
    """Bound socket that serves the autopilot that sent the last request.

    Each accepted answer triggers the next request.

    asked: frame of the current request, None before the first.
    served: first frame without an answer.

    `on_start(sender, anew)` is called when another sender requests frames, or the same sender restarts at frame 0.
    """

    def __init__(self, url: str, on_start: Callable[[str, bool], None]) -> None:
        try:
            parts = urlsplit(url)
            if parts.scheme != "udp":
                raise ValueError("the JSON interface is served over UDP")
        except ValueError as error:
            raise BadUrlError(url, str(error), "write it like udp://127.0.0.1:9002") from None
        family, kind, protocol, _, target = resolve(parts, True, socket.SOCK_DGRAM)
        self._socket = socket.socket(family, kind, protocol)
        try:
            self._socket.setblocking(False)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
            self._socket.bind(target)
        except OSError as error:
            self._socket.close()
            raise transport_error(error, parts, True) from None
        self.address = address_url("udp", self._socket.getsockname())
        self.counts = InjectorCounters()
        self.asked: int | None = None
        self.served = 0
        self.rate_hz = 0
        self._on_start = on_start
        self._peer: Address | None = None
        self._newest = self._expected = b""
        self._unread = False
        self._newest_answer = b""
        self._sent_s = 0.0
        self._at_once = sys.platform == "linux"

    @property
    def behind(self) -> int:
        """Number of answers that the autopilot has not accepted yet."""
        return 0 if self.asked is None else self.served - self.asked

    @property
    def peer(self) -> str:
        """Address of the autopilot, empty while there is none."""
        return "" if self._peer is None else address_url("udp", self._peer)

    def wait(self, behind: int, until_s: float) -> bool:
        """Receive until at most `behind` answers are not accepted. Return False at `until_s` of time.monotonic()."""
        while self.asked is None or self.behind > behind:
            if self.hear(behind):
                break
            left_s = until_s - monotonic()
            if left_s <= 0.0:
                return False
            wait_readable((self._socket.fileno(),), left_s)
        return True

    def hear(self, behind: int = 0) -> bool:
        """Handle the packets that have arrived, until at most `behind` answers are not accepted. Never waits.

        Return whether this is so. The newest packet is then the same, however far the autopilot is by now.
        """
        receive, length = self._socket.recvfrom, len(self._newest)
        for _ in range(BATCH):
            try:
                packet, sender = receive(256)
            except OSError:  # nothing to read, or an error about an undelivered answer
                return False
            if packet[:8] == self._expected and len(packet) == length and sender == self._peer:
                # The usual packet: it requests the frame after the last one, and its head is as expected.
                assert self.asked is not None
                self._accept(packet, self.asked + 1)
            else:
                self._on_packet(packet, sender)
                length = len(self._newest)
            if self.asked is not None and self.served - self.asked <= behind:
                return True
        return False

    def _accept(self, packet: bytes, frame: int) -> None:
        self.asked = frame
        if frame > self.served:  # another program also answered
            self.served = frame
        self._expected = packet[:4] + (frame + 1 & 0xFFFFFFFF).to_bytes(4, "little")
        self.counts.world_in += 1
        self._newest = packet
        self._unread = True

    def _on_packet(self, packet: bytes, sender: Address) -> None:
        head = parse_servo_head(packet)
        if head is None:
            self.counts.junk += len(packet)
            return
        rate_hz, frame = head
        asked = self.asked
        if sender != self._peer or asked is None or (frame == 0 and asked):
            is_first = self._peer is None
            self._peer = sender
            self.asked = self.served = frame
            if not is_first:
                self._on_start(self.peer, frame == 0)
        elif frame == asked:
            # Without an answer yet, the autopilot only waits for the host. Otherwise it missed some. It does not say
            # which, so it gets the newest instead, which never sets its clock back.
            if self.behind and monotonic() - self._sent_s > ASKED_AGAIN_S:
                self.counts.world_resent += 1
                self._send([self._newest_answer] * self.behind)
            return
        elif frame < asked:  # the packet was overtaken on its way
            return
        else:
            self.counts.world_lost += frame - asked - 1
        self.rate_hz = self.counts.world_rate = rate_hz
        self._accept(packet, frame)

    def answer(self, answers: list[bytes]) -> None:
        """Send answers for the next frames, one datagram each."""
        self._newest_answer = answers[-1]
        self.served += len(answers)
        self._send(answers)

    def _send(self, answers: list[bytes]) -> None:
        self._sent_s = monotonic()
        if self._at_once and len(answers) > 1 and self._send_at_once(answers):
            return
        assert self._peer is not None
        send, peer = self._socket.sendto, self._peer
        for answer in answers:
            try:
                send(answer, peer)
            except OSError:  # no room, or the autopilot ended: it repeats its request
                self.counts.unsent += 1

    def _send_at_once(self, answers: list[bytes]) -> bool:
        """Send all answers in one call, which Linux splits into datagrams.

        A call and a wake-up cost more than an answer.
        """
        length = len(answers[0])
        if len(answers) > SEGMENTS or any(len(answer) != length for answer in answers):
            return False
        segment = [(socket.IPPROTO_UDP, UDP_SEGMENT, struct.pack("=H", length))]
        try:
            self._socket.sendmsg([b"".join(answers)], segment, 0, self._peer)
        except BlockingIOError:
            return False
        except OSError:  # unsupported by this system or on this route to the autopilot
            self._at_once = False
            return False
        return True

    def new_pulses(self) -> tuple[int, ...] | None:
        """Pulse widths of the newest packet, None when they were read before."""
        if not self._unread:
            return None
        self._unread = False
        return read_pulses_us(self._newest)

    def fileno(self) -> int:
        """Descriptor that becomes readable when the autopilot sends a request."""
        return self._socket.fileno()

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()
