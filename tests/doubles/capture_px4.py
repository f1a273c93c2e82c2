#!/usr/bin/env python3
"""Stands in for px4 on a command line, starts the real one behind it and writes down what both sides send.

XITL_PX4 names the real one, XITL_CAPTURE the file; tests/data/px4/README.md has the commands.
"""

from __future__ import annotations

import os
import selectors
import signal
import socket
import subprocess
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))
from pymavlink.dialects.v20 import common as mavlink

from tests.doubles.capture import COMMANDS, MAVLINK, OUTPUTS, SENSORS, CaptureWriter
from tests.doubles.replayed_px4 import LOCAL, MAVLINK_PORT, SIMULATOR_PORT, called, instance_in

APART = 100  # the real one's instance is so much higher
HEARD = 65536


def main() -> None:
    """Relay until asked to stop, or until the real one ends."""
    real, arguments = Path(os.environ["XITL_PX4"]), sys.argv[1:]
    instance = instance_in(arguments)
    arguments[arguments.index("-i") + 1] = str(instance + APART)
    arguments[arguments.index("-i") + 2] = str(real.resolve().parent.parent / "etc")
    listener = socket.create_server((LOCAL, SIMULATOR_PORT + instance + APART))
    autopilot = subprocess.Popen([str(real), *arguments])
    signal.signal(signal.SIGTERM, lambda number, frame: autopilot.kill())
    simulator = called(SIMULATOR_PORT + instance)
    station = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    station.bind((LOCAL, MAVLINK_PORT + instance))
    vehicle = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    vehicle.bind((LOCAL, 0))
    vehicle_at = (LOCAL, MAVLINK_PORT + instance + APART)
    writer = CaptureWriter(Path(os.environ["XITL_CAPTURE"]))
    try:
        sensed = listener.accept()[0]
        for stream in (simulator, sensed):
            stream.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        _relay(autopilot, simulator, sensed, station, vehicle, vehicle_at, writer)
    finally:
        writer.close()
        autopilot.kill()
        autopilot.wait()


def _relay(
    autopilot: subprocess.Popen[bytes],
    simulator: socket.socket,
    sensed: socket.socket,
    station: socket.socket,
    vehicle: socket.socket,
    vehicle_at: tuple[str, int],
    writer: CaptureWriter,
) -> None:
    frame, station_at = 0, None
    parser = mavlink.MAVLink(None)
    selector = selectors.DefaultSelector()
    for opened in (simulator, sensed, station, vehicle):
        selector.register(opened, selectors.EVENT_READ)
    while autopilot.poll() is None:
        for key, _ in selector.select(0.2):
            ready = key.fileobj
            if ready is simulator:
                if not (data := simulator.recv(HEARD)):
                    return
                for message in parser.parse_buffer(data) or ():
                    frame += message.get_type() == "HIL_SENSOR"
                    writer.write(SENSORS, frame, bytes(message.get_msgbuf()))
                sensed.sendall(data)
            elif ready is sensed:
                data = sensed.recv(HEARD)
                writer.write(OUTPUTS, frame, data)
                simulator.sendall(data)
            elif ready is station:
                data, station_at = station.recvfrom(HEARD)
                writer.write(COMMANDS, frame, data)
                vehicle.sendto(data, vehicle_at)
            elif ready is vehicle:
                data = vehicle.recv(HEARD)
                if station_at is not None:
                    writer.write(MAVLINK, frame, data)
                    station.sendto(data, station_at)


if __name__ == "__main__":
    main()
