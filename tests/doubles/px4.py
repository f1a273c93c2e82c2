"""A program that behaves at its simulator interface as PX4's documentation says, by pymavlink.

It calls the simulator, says HEARTBEAT and asks for HIL_STATE_QUATERNION, takes its time from HIL_SENSOR alone, and
sends HIL_ACTUATOR_CONTROLS when its control loop has put out something new.
"""

from __future__ import annotations

import select
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

ARMED, CUSTOM = 128, 1


@dataclass
class Px4Double:
    """How it behaves, and what it has seen.

    loop_us: period of its control loop on its own clock, 0 for every sample. quiet_us: no outputs in these spans of its
    clock, counted from its first sample. armed, lockstep: what its outputs say. delay_s: real time that its control
    loop takes. clock_us: its time. steps_back: samples that were not newer.
    """

    loop_us: int = 0
    quiet_us: list[tuple[int, int]] = field(default_factory=list)
    armed: bool = True
    lockstep: bool = True
    delay_s: float = 0.0
    clock_us: int = 0
    first_us: int = 0
    steps_back: int = 0
    sensors: list[Any] = field(default_factory=list)
    fixes: list[Any] = field(default_factory=list)
    leave: threading.Event = field(default_factory=threading.Event)

    def outputs(self) -> list[float]:
        """What it puts out for the newest sample: forward acceleration and yaw rate, as they are."""
        newest = self.sensors[-1]
        return [newest.xacc, newest.zgyro, *[0.0] * 14]


@contextmanager
def calling(double: Px4Double, port: int) -> Iterator[Px4Double]:
    """The double, connected to a simulator on this machine."""
    sock = socket.create_connection(("127.0.0.1", port), 5.0)
    sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    thread = threading.Thread(target=_serve, args=(double, sock))
    thread.start()
    try:
        yield double
    finally:
        double.leave.set()
        thread.join()
        sock.close()


def _serve(double: Px4Double, sock: socket.socket) -> None:
    mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
    mav.robust_parsing = True
    sock.sendall(mav.heartbeat_encode(mavlink.MAV_TYPE_GENERIC, mavlink.MAV_AUTOPILOT_PX4, 0, 0, 0).pack(mav))
    wish = mavlink.MAV_CMD_SET_MESSAGE_INTERVAL
    sock.sendall(mav.command_long_encode(0, 0, wish, 0, 115, 5000, 0, 0, 0, 0, 0).pack(mav))
    put_out_us = 0
    while not double.leave.is_set():
        if not select.select([sock], (), (), 0.01)[0]:
            continue
        data = sock.recv(65536)
        if not data:
            return
        for message in mav.parse_buffer(data) or []:
            if message.get_type() == "HIL_GPS":
                double.fixes.append(message)
            if message.get_type() != "HIL_SENSOR":
                continue
            double.steps_back += message.time_usec <= double.clock_us
            double.clock_us = message.time_usec
            double.first_us = double.first_us or message.time_usec
            double.sensors.append(message)
            since_us = message.time_usec - double.first_us
            if any(start <= since_us < end for start, end in double.quiet_us):
                continue
            if double.loop_us and message.time_usec < put_out_us + double.loop_us:
                continue
            put_out_us = message.time_usec
            double.leave.wait(double.delay_s)
            mode = CUSTOM | (ARMED if double.armed else 0)
            controls = double.outputs() if double.armed else [0.0] * 16
            out = mav.hil_actuator_controls_encode(message.time_usec, controls, mode, int(double.lockstep))
            sock.sendall(out.pack(mav))
