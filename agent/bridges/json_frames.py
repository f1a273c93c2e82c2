"""The datagrams of ArduPilot's JSON simulator interface, as bytes.

A servo packet is little-endian: magic u16, frame rate u16 (Hz), frame count u32, then 16 pulse widths u16 (us) behind
magic 18458 or 32 behind magic 29569. The answer is a line of JSON between newlines; the other side searches it for keys
as plain text, so nothing may stand between a key and its value, and the numbers of a vector are parted by a comma and
one space (libraries/SITL/SIM_JSON.cpp).
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import NamedTuple

SLOWEST_HZ, FASTEST_HZ = 11, 20_000  # ArduPilot passes over steps of 0.1 s and more
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
    """What a servo packet asks for: the answer to `frame`, of a world at `rate_hz`."""

    rate_hz: int
    frame: int


def head_of(packet: bytes) -> ServoHead | None:
    """None for what is no servo packet."""
    if len(packet) < _HEAD.size:
        return None
    magic, rate_hz, count = _HEAD.unpack_from(packet)
    if _LENGTHS.get(magic) != len(packet) or not SLOWEST_HZ <= rate_hz <= FASTEST_HZ:
        return None
    return ServoHead(rate_hz, count)


def pulses_of(packet: bytes) -> tuple[int, ...]:
    """Pulse widths in us, channel 1 first, of a packet that has a head."""
    magic = packet[0] | packet[1] << 8
    return _PULSES[magic].unpack_from(packet, _HEAD.size)


def imu_text(gyro_frd_radps: Sequence[float], accel_frd_mps2: Sequence[float]) -> str:
    """The inside of "imu": angular rate and specific force."""
    return _IMU % (*gyro_frd_radps, *accel_frd_mps2)


def extras_text(ranges_m: Sequence[float | None], wind: tuple[float, float] | None) -> str:
    """What may follow: distances of rangefinders 1 to 6, and the apparent wind (direction in rad, speed in m/s)."""
    text = "".join(
        f',"rng_{number}":{range_m:.3f}' for number, range_m in enumerate(ranges_m, 1) if range_m is not None
    )
    if wind is not None:
        text += f',"windvane":{{"direction":{wind[0]:.4f},"speed":{wind[1]:.3f}}}'
    return text


def frame_text(time_s: float, imu: str, motion: tuple[float, ...], extras: str) -> str:
    """One answer. motion: position NED in m, quaternion body to NED (w first), velocity NED in m/s, ten numbers."""
    return _FRAME % (time_s, imu, *motion, extras)


def datagrams(texts: Sequence[str]) -> list[bytes]:
    """The answers as they are sent: all of one length, so that one call can send them."""
    if not texts:
        return []
    length = max(map(len, texts))
    return [(text.ljust(length) + "\n").encode() for text in texts]
