"""The other end of a simulated navigation unit: doubles that read as ArduPilot's drivers do, and the real ones."""

from __future__ import annotations

import contextlib
import math
import socket
import struct
import threading
from binascii import crc_hqx
from dataclasses import dataclass
from functools import reduce
from operator import xor
from pathlib import Path
from typing import Any

from pymavlink import mavutil  # type: ignore[import-untyped]

from tests.ardupilot import Rover, find_ardurover
from tests.free_ports import free_port
from xitl_cli.firmware.process import FirmwareProcess

ROOT = Path(__file__).parents[2]
CAPTURE = ROOT / "tests" / "data" / "captures" / "vectornav-handshake.bin"
GRAVITY_MPS2 = 9.80665


@dataclass
class Seen:
    """What an autopilot makes of the frames: the units of its telemetry, which are not ours."""

    euler_deg: tuple[float, ...] | None = None
    accel_mg: tuple[float, ...] | None = None
    field_mgauss: tuple[float, ...] | None = None
    pressure_hpa: float | None = None
    lat_deg: float | None = None
    lon_deg: float | None = None
    alt_m: float | None = None
    speed_mps: float | None = None
    course_deg: float | None = None
    satellites: int | None = None
    fix_type: int | None = None
    solution_vel_ned_mps: tuple[float, ...] | None = None

    @property
    def whole(self) -> bool:
        return all(value is not None for value in vars(self).values())


def parameters(*names: str) -> dict[str, float]:
    """Of the files as they are shipped."""
    found = {}
    for name in names:
        for line in (ROOT / "firmware_params" / name).read_text().splitlines():
            words = line.partition("#")[0].split()
            if words:
                found[words[0]] = float(words[1])
    return found


class Double:
    """Serves a port as ArduPilot does; `frames` counts what was read by kind, `bad` bytes that were no part of one."""

    def __init__(self) -> None:
        self.seen = Seen()
        self.frames = {"inertial": 0, "solution": 0, "fix": 0}
        self.bad = 0
        self.answers: list[bytes] = []
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._listener.settimeout(0.02)
        self.url = f"tcp://127.0.0.1:{self._listener.getsockname()[1]}"
        self.greeted = threading.Event()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._buffer = b""

    def start(self) -> None:
        self._thread.start()

    def stop(self) -> None:
        self._stop.set()
        self._thread.join()
        self._listener.close()

    def look(self, now_s: float) -> Seen:
        return self.seen

    def _serve(self) -> None:
        while not self._stop.is_set():
            with contextlib.suppress(TimeoutError):
                peer, _ = self._listener.accept()
                with peer:
                    peer.settimeout(0.02)
                    self.greet(peer)
                    self.greeted.set()
                    while not self._stop.is_set():
                        with contextlib.suppress(TimeoutError):
                            data = peer.recv(4096)
                            if not data:
                                return
                            self._buffer = self.read(self._buffer + data)

    def greet(self, peer: socket.socket) -> None:
        """What the driver does before it reads frames."""

    def read(self, data: bytes) -> bytes:
        """Take whole frames off the front; returns the rest."""
        raise NotImplementedError

    def on_fix(self, place: tuple[float, ...], vel: tuple[float, ...], satellites: int, fix_type: int) -> None:
        seen = self.seen
        seen.lat_deg, seen.lon_deg, seen.alt_m = place
        seen.speed_mps = math.hypot(vel[0], vel[1])
        seen.course_deg = math.degrees(math.atan2(vel[1], vel[0])) % 360.0
        seen.satellites, seen.fix_type = satellites, fix_type
        self.frames["fix"] += 1

    def on_solution(self, quat: tuple[float, ...], vel: tuple[float, ...]) -> None:
        w, x, y, z = quat
        roll = math.atan2(2 * (w * x + y * z), 1 - 2 * (x * x + y * y))
        pitch = math.asin(2 * (w * y - z * x))
        yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
        self.seen.euler_deg = tuple(math.degrees(angle) for angle in (roll, pitch, yaw))
        self.seen.solution_vel_ned_mps = vel
        self.frames["solution"] += 1

    def on_inertial(self, accel: tuple[float, ...], field: tuple[float, ...], pressure_hpa: float) -> None:
        self.seen.accel_mg = tuple(value / GRAVITY_MPS2 * 1000.0 for value in accel)
        self.seen.field_mgauss = tuple(value * 1000.0 for value in field)
        self.seen.pressure_hpa = pressure_hpa
        self.frames["inertial"] += 1


class VectorNavDouble(Double):
    """Says what a real Rover said, each command once the one before is answered as the driver wants it."""

    HEADS: tuple[tuple[bytes, int], ...] = (
        (bytes.fromhex("fa012107"), 82),
        (bytes.fromhex("fa31010006011306"), 104),
        (bytes.fromhex("fa490300b8261800"), 110),
    )

    def greet(self, peer: socket.socket) -> None:
        for command in CAPTURE.read_bytes().splitlines(keepends=True):
            peer.sendall(command)
            wanted = command[1:9].rstrip(b"*")
            while not self._answered(peer, wanted):
                if self._stop.is_set():
                    return

    def _answered(self, peer: socket.socket, wanted: bytes) -> bool:
        with contextlib.suppress(TimeoutError):
            self._buffer += peer.recv(4096)
        start = self._buffer.find(b"$")
        end = self._buffer.find(b"\r\n", start)
        if start < 0 or end < 0:
            return False
        body, _, checksum = self._buffer[start + 1 : end].partition(b"*")
        self._buffer = self._buffer[end + 2 :]
        assert int(checksum, 16) == reduce(xor, body, 0)
        self.answers.append(body)
        return body[: len(wanted)] == wanted

    def read(self, data: bytes) -> bytes:
        while data:
            head, length = next(((h, n) for h, n in self.HEADS if data.startswith(h[: len(data)])), (b"", 0))
            if not head:
                self.bad += 1
                data = data[1:]
            elif len(data) < length:
                break
            else:
                assert crc_hqx(data[1:length], 0) == 0
                self._take(head, data[len(head) : length - 2])
                data = data[length:]
        return data

    def _take(self, head: bytes, values: bytes) -> None:
        if len(values) == 76:
            v = struct.unpack("<Q17f", values)
            self.on_inertial(v[4:7], v[13:16], v[17] * 10.0)
        elif head[1] == 0x31:
            v = struct.unpack("<Q10fH3d5f", values)
            self.on_solution((v[7], *v[4:7]), v[15:18])
        else:
            v = struct.unpack("<QQBB3d3f3ff7fBB", values)
            self.on_fix(v[4:7], v[7:10], v[2], v[3])


class MicroStrainDouble(Double):
    """Says nothing, reads packets."""

    def read(self, data: bytes) -> bytes:
        while len(data) >= 6:
            if data[:2] != b"\x75\x65":
                self.bad += 1
                data = data[1:]
                continue
            length = data[3] + 6
            if len(data) < length:
                break
            self._take(data[2], data[:length])
            data = data[length:]
        return data

    def _take(self, kind: int, packet: bytes) -> None:
        first = second = 0
        for byte in packet[:-2]:
            first = (first + byte) % 256
            second = (second + first) % 256
        assert packet[-2:] == bytes((first, second))
        f, rest = {}, packet[4:-2]
        while rest:
            f[rest[1]], rest = rest[2 : rest[0]], rest[rest[0] :]
        if kind == 0x80:
            accel = tuple(value * GRAVITY_MPS2 for value in struct.unpack(">3f", f[0x04]))
            self.on_inertial(accel, struct.unpack(">3f", f[0x06]), struct.unpack(">f", f[0x17])[0])
        elif kind == 0x82:
            assert struct.unpack(">3H", f[0x10])[0] == 4
            self.on_solution(struct.unpack_from(">4f", f[0x03]), struct.unpack_from(">3f", f[0x02]))
        elif kind == 0x91:
            lat, lon, _, alt = struct.unpack_from(">4d", f[0x03])
            self.on_fix((lat, lon, alt), struct.unpack_from(">3f", f[0x05]), f[0x0B][1], 3 if f[0x0B][0] == 0 else 0)


class Watcher:
    """What a real autopilot tells over its MAVLink at `address`. texts: what it said in words."""

    _WANTED = (24, 27, 29, 30, 32)  # GPS_RAW_INT, RAW_IMU, SCALED_PRESSURE, ATTITUDE, LOCAL_POSITION_NED

    def __init__(self, address: str) -> None:
        self.seen = Seen()
        self.texts: list[str] = []
        self._address = address
        self._mavlink: Any = None
        self._asked_s = 0.0

    def close(self) -> None:
        if self._mavlink is not None:
            self._mavlink.close()

    def look(self, now_s: float) -> Seen:
        """What has been seen by now; call it often."""
        if self._mavlink is None:
            with contextlib.suppress(OSError):
                self._mavlink = mavutil.mavlink_connection(self._address.replace("://", ":"), retries=0)
            return self.seen
        if now_s - self._asked_s > 1.0:
            self._asked_s = now_s
            for kind in self._WANTED:
                self._mavlink.mav.command_long_send(1, 1, 511, 0, kind, 200_000, 0, 0, 0, 0, 0)
        while (message := self._mavlink.recv_match()) is not None:
            self._take(message)
        return self.seen

    def _take(self, m: Any) -> None:
        seen, kind = self.seen, m.get_type()
        if kind == "ATTITUDE":
            seen.euler_deg = tuple(math.degrees(angle) for angle in (m.roll, m.pitch, m.yaw))
        elif kind == "RAW_IMU":
            seen.accel_mg = (m.xacc, m.yacc, m.zacc)
            seen.field_mgauss = (m.xmag, m.ymag, m.zmag)
        elif kind == "SCALED_PRESSURE":
            seen.pressure_hpa = m.press_abs
        elif kind == "LOCAL_POSITION_NED":
            seen.solution_vel_ned_mps = (m.vx, m.vy, m.vz)
        elif kind == "GPS_RAW_INT":
            seen.lat_deg, seen.lon_deg, seen.alt_m = m.lat * 1e-7, m.lon * 1e-7, m.alt * 1e-3
            seen.speed_mps, seen.course_deg = m.vel * 0.01, m.cog * 0.01
            seen.satellites, seen.fix_type = m.satellites_visible, m.fix_type
        elif kind == "STATUSTEXT":
            self.texts.append(m.text)


class Real:
    """A real Rover that takes the solution of the unit over (AHRS_EKF_TYPE 11), so that telemetry tells it."""

    def __init__(self, directory: Path, values: dict[str, float], build: str) -> None:
        self._values = {**values, "AHRS_EKF_TYPE": 11}
        self._directory = directory
        self._build = build
        port = free_port()
        self.url = f"tcp://127.0.0.1:{port}"
        self._serial = f"tcp:{port}:wait" if build == "sitl" else f"tcp:127.0.0.1:{port}:wait"
        self._program = find_ardurover(build)

    def start(self) -> None:
        if self._build == "sitl":
            rover = Rover(self._directory, self._values, serial={3: self._serial})
            self._process = rover.start()
            self._watcher = Watcher(rover.mavlink)
            return
        port = free_port()
        lines = [f"{name} {value:g}\n" for name, value in {**self._values, "FRAME_CLASS": 2}.items()]
        (self._directory / "p.parm").write_text("".join(lines))
        words = ["--serial0", f"tcp:127.0.0.1:{port}", "--serial3", self._serial, "--defaults", "p.parm"]
        for option in ("--log-directory", "--storage-directory", "--terrain-directory"):
            words += [option, "."]
        self._process = FirmwareProcess(self._program, words, self._directory)
        self._watcher = Watcher(f"tcp://127.0.0.1:{port}")

    def stop(self) -> None:
        self._watcher.close()
        self._process.stop()

    @property
    def seen(self) -> Seen:
        return self._watcher.seen

    def look(self, now_s: float) -> Seen:
        return self._watcher.look(now_s)
