"""Telemetry logs made with pymavlink: every message of its dialect, with values drawn at random."""

from __future__ import annotations

import random
import struct
from collections import defaultdict
from pathlib import Path
from typing import Any

from pymavlink import mavutil
from pymavlink.dialects.v20 import ardupilotmega as dialect

START_US = 1_700_000_000_000_000
_LIMITS = {"uint8_t": (0, 255), "int8_t": (-128, 127), "char": (0, 255)}
_LIMITS |= {f"uint{bits}_t": (0, 2**bits - 1) for bits in (16, 32, 64)}
_LIMITS |= {f"int{bits}_t": (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1) for bits in (16, 32, 64)}
_TEXT = b"Throttle armed; EKF3 IMU0 origin set 0123456789 abcdefghijklmnopqrstuvwxyz \xff\x80 and so on up to a hundred"


def message(draw: random.Random, number: int) -> Any:
    """Of the dialect. Some fields are 0, so that MAVLink 2 has something to cut off."""
    made = dialect.mavlink_map[number]
    return made(*(_field(draw, made, name, kind) for name, kind in zip(made.fieldnames, made.fieldtypes, strict=True)))


def frame(
    draw: random.Random, number: int, *, first: bool = False, signed: bool = False, sequence: int | None = None
) -> bytes:
    """With a sender of its own; `first` is MAVLink 1."""
    sender = dialect.MAVLink(None, srcSystem=draw.randrange(1, 256), srcComponent=draw.randrange(256))
    sender.seq = draw.randrange(256) if sequence is None else sequence
    if signed:
        sender.signing.secret_key = bytes(32)
        sender.signing.sign_outgoing = True
    return bytes(message(draw, number).pack(sender, force_mavlink1=first))


def record(at_us: int, framed: bytes) -> bytes:
    return struct.pack(">Q", at_us) + framed


def theirs(path: Path) -> tuple[dict[str, list[tuple[float, Any]]], int]:
    """What pymavlink reads by message, each with its stamp, and how much it calls bad."""
    reader = mavutil.mavlogfile(str(path))
    found: dict[str, list[tuple[float, Any]]] = defaultdict(list)
    bad = 0
    while (one := reader.recv_msg()) is not None:
        if one.get_type() == "BAD_DATA":
            bad += 1
        else:
            found[one.get_type()].append((one._timestamp, one))
    reader.close()
    return dict(found), bad


def _field(draw: random.Random, made: Any, name: str, kind: str) -> Any:
    count = made.array_lengths[made.ordered_fieldnames.index(name)]
    if kind == "char":
        return _TEXT[: draw.randrange(count + 1)]
    values = [_number(draw, kind) for _ in range(max(count, 1))]
    return values if count else values[0]


def _number(draw: random.Random, kind: str) -> int | float:
    if draw.random() < 0.3:
        return 0
    if kind in ("float", "double"):
        return draw.choice([draw.uniform(-1e6, 1e6), float("nan"), 1e-30, -0.0])
    return draw.randint(*_LIMITS[kind.removesuffix("_mavlink_version")])
