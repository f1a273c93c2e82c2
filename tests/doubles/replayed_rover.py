#!/usr/bin/env python3
"""Takes the command line of ardurover and sends again what a real one sent: outputs frame by frame, and MAVLink.

In lockstep with the same world as when it was captured it is the real one's twin: the world is a function of its
outputs. What is said to it changes nothing. XITL_CAPTURE names the file; XITL_REPLAY_DIES ends it at that frame.
Like the real one it heeds SIGTERM only between two frames, and says "Exitting" then.
"""

from __future__ import annotations

import os
import signal
import socket
import sys
from contextlib import suppress
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))
from tests.doubles.capture import MAVLINK, OUTPUTS, at_frame, read_capture

LOCAL = "127.0.0.1"
told_to_end: list[int] = []


def main() -> None:
    """Until the capture is over, then in silence until it is stopped."""
    signal.signal(signal.SIGTERM, lambda number, frame: told_to_end.append(number))
    arguments = sys.argv[1:]
    world = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    world.connect((LOCAL, int(arguments[arguments.index("--sim-port-out") + 1])))
    world.settimeout(1.0)
    port = int(arguments[arguments.index("--serial0") + 1].rpartition(":")[2])
    server = socket.create_server((LOCAL, port))
    print(f"SERIAL0 on TCP port {port}", flush=True)
    client = server.accept()[0]
    client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    dies = int(os.environ.get("XITL_REPLAY_DIES", "-1"))
    packet, frame = b"", -1
    for record in read_capture(Path(os.environ["XITL_CAPTURE"])):
        while frame < record.frame - 1:
            frame += 1
            _exchange(world, at_frame(packet, frame))
            _forget_what_was_said(client)
            if frame == dies:
                print("Segmentation fault", flush=True)
                os.abort()
        if record.kind == OUTPUTS:
            packet = record.data
        elif record.kind == MAVLINK:
            client.sendall(record.data)
    while True:
        frame += 1
        _exchange(world, at_frame(packet, frame))
        _forget_what_was_said(client)


def _exchange(world: socket.socket, packet: bytes) -> None:
    """One frame: the outputs, then the world's answer; asked again after a second, as the real one does."""
    if told_to_end:
        print("Exitting", flush=True)
        sys.exit(0)
    world.send(packet)
    while True:
        try:
            world.recv(65536)
            return
        except TimeoutError:
            world.send(packet)


def _forget_what_was_said(client: socket.socket) -> None:
    with suppress(BlockingIOError):
        if not client.recv(65536, socket.MSG_DONTWAIT):
            sys.exit(0)


if __name__ == "__main__":
    main()
