#!/usr/bin/env python3
"""Stands in for ardurover on a command line, starts the real one behind it and writes down all that it sends.

export XITL_ARDUROVER=path/to/ardurover XITL_CAPTURE=tests/data/captures/sitl-ardupilot.xz
xitl sim -p sitl-ardupilot --firmware tests/doubles/capture_rover.py
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
from tests.doubles.capture import CaptureWriter, frame_of

LOCAL = "127.0.0.1"
WORLD, VEHICLE = "world", "vehicle"  # until the real one's ports are known


def main() -> None:
    """Relay until asked to stop, or until the real one ends."""
    arguments = sys.argv[1:]
    world_port = int(_replaced(arguments, "--sim-port-out", WORLD))
    serial = _replaced(arguments, "--serial0", VEHICLE)
    upstream = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)  # where the real one sends
    upstream.bind((LOCAL, 0))
    host = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    host.connect((LOCAL, world_port))
    server = socket.create_server((LOCAL, int(serial.rpartition(":")[2])))
    free = socket.create_server((LOCAL, 0))
    vehicle_port = free.getsockname()[1]
    free.close()
    arguments[arguments.index(WORLD)] = str(upstream.getsockname()[1])
    arguments[arguments.index(VEHICLE)] = f"tcp:{vehicle_port}"
    rover = subprocess.Popen([os.environ["XITL_ARDUROVER"], *arguments])
    signal.signal(signal.SIGTERM, lambda number, frame: rover.kill())  # it would wait for a world that has ended
    writer = CaptureWriter(Path(os.environ["XITL_CAPTURE"]))
    try:
        _relay(rover, upstream, host, server, vehicle_port, writer)
    finally:
        writer.close()
        rover.wait()


def _replaced(arguments: list[str], option: str, by: str) -> str:
    at = arguments.index(option) + 1
    given, arguments[at] = arguments[at], by
    return given


def _relay(
    rover: subprocess.Popen[bytes],
    upstream: socket.socket,
    host: socket.socket,
    server: socket.socket,
    vehicle_port: int,
    writer: CaptureWriter,
) -> None:
    frame = 0
    rover_address = None
    client: socket.socket | None = None
    vehicle: socket.socket | None = None
    selector = selectors.DefaultSelector()
    for listened in (upstream, host, server):
        selector.register(listened, selectors.EVENT_READ)
    while rover.poll() is None:
        for key, _ in selector.select(0.2):
            ready = key.fileobj
            if ready is upstream:
                packet, rover_address = upstream.recvfrom(2048)
                frame = frame_of(packet)
                writer.outputs(frame, packet)
                host.send(packet)
            elif ready is host and rover_address is not None:
                upstream.sendto(host.recv(65536), rover_address)
            elif ready is server:
                client = server.accept()[0]
                vehicle = socket.create_connection((LOCAL, vehicle_port))
                selector.register(client, selectors.EVENT_READ)
                selector.register(vehicle, selectors.EVENT_READ)
            elif ready is client and vehicle is not None:
                data = client.recv(65536)
                if not data:
                    return
                vehicle.sendall(data)
            elif ready is vehicle and client is not None:
                data = vehicle.recv(65536)
                if not data:
                    return
                writer.mavlink(frame, data)
                client.sendall(data)


if __name__ == "__main__":
    main()
