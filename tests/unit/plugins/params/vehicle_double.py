"""A vehicle that speaks the parameter protocol as ArduRover does, on pymavlink's own codec."""

from __future__ import annotations

import socket
import struct
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as mav

INT8, REAL32 = mav.MAV_PARAM_TYPE_INT8, mav.MAV_PARAM_TYPE_REAL32


class _Wire:
    def __init__(self, send: Callable[[bytes], object]) -> None:
        self._send = send

    def write(self, data: bytes) -> None:
        self._send(bytes(data))


class VehicleDouble:
    """Answers on one connection. Loses every `lose`-th PARAM_VALUE of a list; keeps parameters named in `stubborn`."""

    def __init__(self, values: dict[str, float], lose: int = 0, stubborn: tuple[str, ...] = (), autopilot: int = 3):
        self.values = dict(values)
        self.types = {name: INT8 if name == "FRAME_CLASS" else REAL32 for name in values}
        self.sets: list[tuple[str, float, int]] = []
        self._lose = lose
        self._stubborn = stubborn
        self._autopilot = autopilot
        self._listed = 0
        self._codec = mav.MAVLink(None, 1, 1)
        self._codec.robust_parsing = True

    def serve(self, read: Callable[[], bytes | None], send: Callable[[bytes], object], stop: threading.Event) -> None:
        self._codec.file = _Wire(send)
        beats = 0
        while not stop.is_set():
            if beats % 10 == 0:
                self._heartbeat()
            beats += 1
            data = read()
            if data is None:
                return
            for message in self._codec.parse_buffer(bytearray(data)) or []:
                self.answer(message)

    def _heartbeat(self) -> None:
        self._codec.heartbeat_send(mav.MAV_TYPE_SURFACE_BOAT, self._autopilot, 1, 0, 3)
        # What a ground station hears besides, known to the project's dialect and not.
        self._codec.vfr_hud_send(0, 0, 0, 0, 0, 0)
        self._codec.hwstatus_send(5000, 0)
        self._codec.heartbeat_send(mav.MAV_TYPE_GCS, mav.MAV_AUTOPILOT_INVALID, 0, 0, 3)

    def answer(self, message: Any) -> None:
        kind, names = message.get_type(), list(self.values)
        if kind == "PARAM_REQUEST_LIST":
            for name in names:
                self._listed += 1
                if not self._lose or self._listed % self._lose:
                    self._value(name)
        elif kind == "PARAM_REQUEST_READ":
            name = message.param_id
            if message.param_index >= 0:
                name = names[message.param_index] if message.param_index < len(names) else ""
            if name in self.values:
                self._listed += 1
                if not self._lose or self._listed % self._lose:
                    self._value(name)
        elif kind == "PARAM_SET" and message.param_id in self.values:
            name = message.param_id
            self.sets.append((name, message.param_value, message.param_type))
            if name in self._stubborn:
                text = f"{name}: set denied because the vessel is armed and under way right now"
                self._codec.statustext_send(4, text[:50].encode(), 7, 0)
                self._codec.statustext_send(4, text[50:].encode(), 7, 1)
            else:
                value = self._told(message)
                self.values[name] = float(int(value)) if self.types[name] == INT8 else value
            self._value(name)

    def _value(self, name: str) -> None:
        value = self.field(name)
        index = list(self.values).index(name)
        self._codec.param_value_send(name.encode(), value, self.types[name], len(self.values), index)

    def field(self, name: str) -> float:
        return float(struct.unpack("<f", struct.pack("<f", self.values[name]))[0])

    def _told(self, message: Any) -> float:
        return float(message.param_value)


class Px4Vehicle(VehicleDouble):
    """The same with PX4's way for the INT32 parameters named in `whole`; a set of another type is refused."""

    def __init__(self, values: dict[str, float], whole: tuple[str, ...]) -> None:
        super().__init__(values, autopilot=mav.MAV_AUTOPILOT_PX4)
        self.types = {name: mav.MAV_PARAM_TYPE_INT32 if name in whole else REAL32 for name in values}

    def field(self, name: str) -> float:
        if self.types[name] == REAL32:
            return super().field(name)
        return float(struct.unpack("<f", struct.pack("<i", int(self.values[name])))[0])

    def _told(self, message: Any) -> float:
        name = message.param_id
        if message.param_type != self.types[name]:
            return self.values[name]
        if self.types[name] == REAL32:
            return float(message.param_value)
        return float(struct.unpack("<i", struct.pack("<f", message.param_value))[0])


@contextmanager
def over_tcp(double: VehicleDouble) -> Iterator[str]:
    """Listens, as a simulated vehicle does."""
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        listener.settimeout(0.02)
        stop = threading.Event()

        def serve() -> None:
            while not stop.is_set():
                try:
                    peer, _ = listener.accept()
                except TimeoutError:
                    continue
                with peer, suppress(ConnectionError):
                    peer.settimeout(0.004)
                    double.serve(lambda peer=peer: _read(peer), peer.sendall, stop)  # type: ignore[misc]

        with _thread(serve, stop):
            yield f"tcp://127.0.0.1:{listener.getsockname()[1]}"


@contextmanager
def over_udp(double: VehicleDouble, port: int) -> Iterator[str]:
    """Sends to a ground station's port, and hears only who answers from there."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.connect(("127.0.0.1", port))
        sock.settimeout(0.02)
        stop = threading.Event()

        def send(data: bytes) -> None:
            with suppress(ConnectionRefusedError):
                sock.send(data)

        with _thread(lambda: double.serve(lambda: _read(sock) or b"", send, stop), stop):
            yield f"udp://127.0.0.1:{port}"


@contextmanager
def _thread(work: Callable[[], None], stop: threading.Event) -> Iterator[None]:
    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield
    finally:
        stop.set()
        thread.join()


def _read(sock: socket.socket) -> bytes | None:
    """What came, b"" when nothing did, None when the other end has left."""
    try:
        return sock.recv(65536) or None
    except TimeoutError:
        return b""
    except OSError:
        return None
