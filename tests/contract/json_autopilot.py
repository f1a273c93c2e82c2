"""The other end of the JSON interface: a double that replays what a real Rover sent, and the real one."""

from __future__ import annotations

import contextlib
import gzip
import json
import re
import socket
import struct
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.ardupilot import Rover

MAGIC_16, MAGIC_32 = 18458, 29569
RESENDS_S = 1.0
_VECTOR = r"\[(-?[\d.]+), (-?[\d.]+), (-?[\d.]+)\]"


@dataclass
class Told:
    """One answer, found as ArduPilot finds it: by the text of the keys."""

    frame: int
    timestamp_s: float
    gyro: tuple[float, ...]
    accel_body: tuple[float, ...]
    position: tuple[float, ...]
    quaternion: tuple[float, ...]
    velocity: tuple[float, ...]
    whole: dict[str, Any]


def read_answer(frame: int, datagram: bytes) -> Told:
    """Raises when a key is not followed at once by a value of the form that ArduPilot scans for."""
    assert datagram[:1] == datagram[-1:] == b"\n"
    text = datagram.decode("ascii")

    def vector(key: str, section: str = "") -> tuple[float, ...]:
        start = text.index(section) + len(section) + 1 if section else 1
        at = text.index(key, start) + len(key) + 2
        form = _VECTOR if key != "quaternion" else _VECTOR.replace(r"\]", r", (-?[\d.]+)\]")
        found = re.match(form, text[at:])
        assert found is not None, (key, text)
        return tuple(map(float, found.groups()))

    at = text.index("timestamp", 1) + len("timestamp") + 2
    found = re.match(r"-?[\d.]+", text[at:])
    assert found is not None
    return Told(
        frame,
        float(found[0]),
        vector("gyro", "imu"),
        vector("accel_body", "imu"),
        vector("position"),
        vector("quaternion"),
        vector("velocity"),
        json.loads(text),
    )


def replayed_pulses(capture: Path) -> dict[int, tuple[int, ...]]:
    """Pulses by frame, of packets with 16 channels one behind the other."""
    found = {}
    for magic, rate_hz, frame, *pulses in struct.iter_unpack("<HHI16H", gzip.decompress(capture.read_bytes())):
        assert (magic, rate_hz) == (MAGIC_16, 1200)
        found[frame] = tuple(pulses)
    return found


class Double:
    """Asks for a frame, takes the answer, asks for the next; asks again after a second, as the real one does.

    `deaf` are frames whose first answer it does not get. told: the answers it took.
    """

    kind = "double"
    resends_s = RESENDS_S

    def __init__(self, pulses: dict[int, tuple[int, ...]] | None = None, channels: int = 16) -> None:
        self.told: list[Told] = []
        self.rate_hz = 1200
        self.deaf: set[int] = set()
        self.frame = 0
        self.asked_again = 0
        self.paused = threading.Event()
        self.rests = threading.Event()
        """It has noticed that it is paused."""
        self._pulses = pulses or {}
        self._newest: tuple[int, ...] = (1500,) * channels
        self._port = 0
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    def packet(self) -> bytes:
        """What asks for the frame."""
        self._newest = self._pulses.get(self.frame, self._newest)
        channels = len(self._newest)
        magic = MAGIC_16 if channels == 16 else MAGIC_32
        return struct.pack(f"<HHI{channels}H", magic, self.rate_hz, self.frame, *self._newest)

    def start(self, world: str) -> None:
        """Begin asking, from the frame on where it is."""
        self._port = int(world.rpartition(":")[2])
        self._stop.clear()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            sock.settimeout(0.02)
            while not self._stop.is_set():
                if self.paused.is_set():
                    self.rests.set()
                    self._stop.wait(0.005)
                    continue
                self.rests.clear()
                sock.sendto(self.packet(), ("127.0.0.1", self._port))
                sent_s = time.monotonic()
                while not self._stop.is_set():
                    with contextlib.suppress(TimeoutError):
                        datagram = sock.recv(65000)
                        if self.frame in self.deaf:
                            self.deaf.remove(self.frame)
                            continue
                        self.told.append(read_answer(self.frame, datagram))
                        self.frame += 1
                        break
                    if time.monotonic() - sent_s > self.resends_s:
                        self.asked_again += 1
                        break

    def stop(self) -> None:
        """It is gone, in the middle of whatever it does."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()

    def restart(self, world: str) -> None:
        """It starts anew."""
        self.stop()
        self.frame = 0
        self.start(world)


class Real:
    """A Rover, on the same terms as the double."""

    kind = "real"

    def __init__(self, directory: Path) -> None:
        self._directory = directory
        self._rover: Rover | None = None

    def start(self, world: str) -> None:
        self._rover = Rover(self._directory, world=world)
        self._rover.start()

    def stop(self) -> None:
        if self._rover is not None:
            self._rover.stop()

    def restart(self, world: str) -> None:
        assert self._rover is not None
        self._rover.stop()
        self._rover.start()

    @property
    def rover(self) -> Rover:
        assert self._rover is not None
        return self._rover
