"""VectorNav VN-300, for ArduPilot with EAHRS_TYPE 1: boards with ChibiOS and software in the loop.

The driver first sets up the unit over its command port; no data flows before. The driver reopens its port before every
read, which empties the buffer on ArduPilot's Linux builds: use the MicroStrain there.

Layout and units: VN-300 User Manual and ICD (VectorNav Technologies), sections on binary output messages, on the
communication interface and on configuration registers. A binary frame is the sync byte, the groups and their fields,
the values in little-endian order, and a CRC16-CCITT. The CRC covers all bytes except the sync byte and is big-endian.
Quaternions are (x, y, z, w).

    $VNWRG,06,0,1*xx        write a register          the answer repeats the command
    $VNRRG,01*xx            read a register           $VNRRG,01,VN-300*xx
    $VNASY,0*xx             outputs off, or on (1)
    $VNERR,03*xx            the answer to an error

A command's checksum is two hexadecimal digits (exclusive or of all bytes between `$` and `*`), four digits
(CRC16-CCITT), or XX for none.
"""

from __future__ import annotations

import math
import struct
import time
from binascii import crc_hqx
from functools import reduce
from operator import xor
from typing import Callable

from agent.bridges.ahrs import Ahrs, SensorLine, open_line
from agent.bridges.injector import InjectorError
from agent.bridges.readings import InertialSample, Navigation, ReceiverFix
from agent.bridges.vehicle_link import VehicleLink
from agent.timing.clock import Clock

SYNC = b"\xfa"
INERTIAL_HEADER = bytes.fromhex("01 2107")  # common: time of startup, rate, acceleration, IMU, field and pressure
SOLUTION_HEADER = bytes.fromhex("31 0100 0601 1306")  # common: time; attitude: angles, quaternion, its uncertainty; INS
RECEIVER_HEADER = bytes.fromhex("49 0300 B826 1800")  # common: time, GPS time; receiver 1; receiver 2: satellites, fix

_INERTIAL = struct.Struct("<Q17f")
_SOLUTION = struct.Struct("<Q3f4f3fH3d3f2f")
_RECEIVER = struct.Struct("<QQBB3d3f3ff7fBB")

TRACKING = 2  # mode of INS status: GNSS and attitude within specification
HAS_FIX = 1 << 2
INERTIAL_FAULT, FIELD_FAULT, RECEIVER_FAULT = 1 << 5, 1 << 6, 1 << 7


def framed(content: bytes) -> bytes:
    """Return a frame: sync byte, groups, fields and values, checksum."""
    return SYNC + content + crc_hqx(content, 0).to_bytes(2, "big")


def pack_inertial_frame(sample: InertialSample) -> bytes:
    """Rate (rad/s), specific force (m/s²), field (gauss) in FRD, temperature (degC), pressure (kPa).

    Compensated and uncompensated values are the same, because the unit's compensation is not simulated.
    """
    gyro, accel = sample.gyro_frd_radps, sample.accel_frd_mps2
    temperature_degc, pressure_kpa = sample.temperature_degc, sample.pressure_pa * 1e-3
    values = _INERTIAL.pack(
        sample.stamp_ns, *gyro, *accel, *accel, *gyro, *sample.field_frd_gauss, temperature_degc, pressure_kpa
    )
    return framed(INERTIAL_HEADER + values)


def pack_solution_frame(navigation: Navigation, faults: int = 0) -> bytes:
    """Attitude (deg, and as a quaternion), position (deg, m), velocity (m/s), and uncertainties (deg, m, m/s)."""
    n = navigation
    w, x, y, z = n.quat_ned_frd
    tilt_deg, heading_deg = n.tilt_accuracy_deg, n.heading_accuracy_deg
    values = _SOLUTION.pack(
        n.stamp_ns,
        *(math.degrees(angle) for angle in reversed(n.euler_rad)),
        x, y, z, w,
        heading_deg, tilt_deg, tilt_deg,
        TRACKING | HAS_FIX | faults,
        n.lat_deg, n.lon_deg, n.alt_m,
        *n.vel_ned_mps,
        n.horizontal_accuracy_m, n.speed_accuracy_mps,
    )  # fmt: skip
    return framed(SOLUTION_HEADER + values)


def pack_receiver_frame(fix: ReceiverFix) -> bytes:
    """A fix of the receiver: position (deg, m), velocity (m/s), one sigma of both, dilutions of precision.

    The second antenna of the unit has the same satellites and the same fix type.
    """
    d = fix.dilution
    horizontal_m = fix.horizontal_accuracy_m * math.sqrt(0.5)  # per axis
    values = _RECEIVER.pack(
        fix.stamp_ns, fix.gps_ns, fix.satellites, fix.fix_type,
        fix.lat_deg, fix.lon_deg, fix.alt_m,
        *fix.vel_ned_mps,
        horizontal_m, horizontal_m, fix.vertical_accuracy_m, fix.speed_accuracy_mps,
        d.geometric, d.position, d.time, d.vertical, d.horizontal, d.north, d.east,
        fix.satellites, fix.fix_type,
    )  # fmt: skip
    return framed(RECEIVER_HEADER + values)


MODEL = "VN-300"
RATE_HZ = 400  # of the unit's inertial sensors; the outputs divide it
LONGEST_LINE = 256

BAD_CHECKSUM, BAD_COMMAND, TOO_FEW, TOO_MANY, BAD_VALUE, BAD_REGISTER, NOT_PERMITTED = 3, 4, 5, 6, 7, 8, 9

INERTIAL, SOLUTION, RECEIVER = 75, 76, 77
_OUTPUTS = {
    INERTIAL: (0x01, 0x0721),
    SOLUTION: (0x31, 0x0001, 0x0106, 0x0613),
    RECEIVER: (0x49, 0x0003, 0x26B8, 0x0018),
}
_ASYNC_TYPE, _ASYNC_RATE = 6, 7
_READABLE = {1: MODEL, 2: "7", 3: "0100000001", 4: "0.5.0.0"}  # model, hardware, serial number, firmware


class CommandError(Exception):
    """Raised for a refused command. `number` is the error code of the unit."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number


class CommandPort:
    """Command port of the unit. `feed` takes received bytes and returns the answers.

    on: whether outputs are enabled.
    divisors: rate divisors of the requested outputs, by register.
    commands: number of answered lines, including refused ones.
    restarts: number of set-ups that began after a complete one.
    junk: number of bytes outside of commands.
    """

    def __init__(self) -> None:
        self.commands = 0
        self.refused = 0
        self.restarts = 0
        self.junk = 0
        self._line = bytearray()
        self._begin()

    def _begin(self) -> None:
        self.on = True
        self.divisors: dict[int, int] = {}
        self._ascii: dict[int, dict[int, int]] = {_ASYNC_TYPE: {1: 0, 2: 0}, _ASYNC_RATE: {1: 40, 2: 40}}

    @property
    def set_up(self) -> bool:
        """Whether all three outputs were requested and are on."""
        return self.on and len(self.divisors) == len(_OUTPUTS)

    def feed(self, data: bytes) -> list[bytes]:
        """Return the answers, in the order of the commands."""
        answers = []
        for byte in data:
            if byte == 0x24:  # $
                self.junk += len(self._line)
                self._line = bytearray(b"$")
            elif not self._line:
                self.junk += byte not in b"\r\n"
            elif byte in b"\r\n":
                self.commands += 1
                try:
                    answers.append(sentence(self._execute(_words(bytes(self._line)))))
                except CommandError as error:
                    self.refused += 1
                    answers.append(sentence(f"VNERR,{error.number:02X}"))
                self._line.clear()
            else:
                self._line.append(byte)
                if len(self._line) > LONGEST_LINE:
                    self.junk += len(self._line)
                    self._line.clear()
        return answers

    def _execute(self, words: list[str]) -> str:
        """Execute a command and return the body of the answer. Raises CommandError."""
        name, values = words[0], words[1:]
        if name == "VNRRG":
            return ",".join((name, values[0] if values else "", *self._read(values)))
        if name == "VNWRG":
            self._write(values)
        elif name == "VNASY":
            _exactly(values, 1)
            on = _number(values[0], 10)
            if on not in (0, 1):
                raise CommandError(BAD_VALUE)
            if not on and self.set_up:
                self.restarts += 1
            self.on = bool(on)
        elif name in ("VNRST", "VNRFS"):
            _exactly(values, 0)
            self._begin()
        elif name == "VNWNV":
            _exactly(values, 0)
        else:
            raise CommandError(BAD_COMMAND)
        return ",".join(words)

    def _read(self, values: list[str]) -> list[str]:
        if not values:
            raise CommandError(TOO_FEW)
        register = _number(values[0], 10)
        if register in self._ascii:
            port = _number(values[1], 10) if len(values) > 1 else 1
            return [str(self._ascii[register][_port(port)])]
        _exactly(values, 1)
        if register in _READABLE:
            return [_READABLE[register]]
        if register in _OUTPUTS:
            fields = _OUTPUTS[register]
            divisor = self.divisors.get(register)
            if divisor is None:
                return ["0", "1", "00"]
            return ["3", str(divisor), f"{fields[0]:02X}", *(f"{field:04X}" for field in fields[1:])]
        raise CommandError(BAD_REGISTER)

    def _write(self, values: list[str]) -> None:
        if len(values) < 2:
            raise CommandError(TOO_FEW)
        register = _number(values[0], 10)
        if register in self._ascii:
            if len(values) > 3:
                raise CommandError(TOO_MANY)
            ports = (_port(_number(values[2], 10)),) if len(values) == 3 else (1, 2)
            for port in ports:
                self._ascii[register][port] = _number(values[1], 10)
        elif register in _OUTPUTS:
            self._set_output(register, values[1:])
        else:
            raise CommandError(NOT_PERMITTED if register in _READABLE else BAD_REGISTER)

    def _set_output(self, register: int, values: list[str]) -> None:
        """Set an output: port, divisor of the rate, groups, and the fields of each group.

        Only the fields that ArduPilot requests are accepted.
        """
        port = _number(values[0], 10)
        if port == 0:
            self.divisors.pop(register, None)
            return
        fields = _OUTPUTS[register]
        if len(values) < 2 + len(fields):
            raise CommandError(TOO_FEW)
        if len(values) > 2 + len(fields):
            raise CommandError(TOO_MANY)
        divisor = _number(values[1], 10)
        asked = tuple(_number(word, 16) for word in values[2:])
        if port > 3 or divisor < 1 or asked != fields:
            raise CommandError(BAD_VALUE)
        self.divisors[register] = divisor


def sentence(body: str) -> bytes:
    """Return a line: `$`, body, checksum, end of line."""
    content = body.encode("ascii")
    return b"$%s*%02X\r\n" % (content, reduce(xor, content, 0))


def _words(line: bytes) -> list[str]:
    """Return the words of a line with a valid checksum. Raises CommandError."""
    body, star, checksum = line[1:].rpartition(b"*")
    valid = (b"%02X" % reduce(xor, body, 0), b"%04X" % crc_hqx(body, 0), b"XX")
    if not star or checksum.strip().upper() not in valid:
        raise CommandError(BAD_CHECKSUM)
    if not body.isascii():
        raise CommandError(BAD_COMMAND)
    return body.decode("ascii").split(",")


def _number(word: str, base: int) -> int:
    try:
        number = int(word, base)
    except ValueError:
        raise CommandError(BAD_VALUE) from None
    if not 0 <= number <= 0xFFFFFF:
        raise CommandError(BAD_VALUE)
    return number


def _port(number: int) -> int:
    if number not in (1, 2):
        raise CommandError(BAD_VALUE)
    return number


def _exactly(values: list[str], count: int) -> None:
    if len(values) != count:
        raise CommandError(TOO_FEW if len(values) < count else TOO_MANY)


_STALE_NS = 500_000_000


class VectorNav(Ahrs):
    """VectorNav unit. It keeps its set-up between runs, like a unit that stays powered."""

    title = "VectorNav"

    def __init__(self, line: SensorLine, unix_s: Callable[[], float] = time.time) -> None:
        self._port = CommandPort()
        super().__init__(line, unix_s)

    @classmethod
    def open(cls, url: str, vehicle: VehicleLink) -> VectorNav:
        """Open the line at `url`. Raises InjectorError and TransportError."""
        if not url:
            raise InjectorError("sensor-link: vectornav needs the port of the autopilot, as tcp://127.0.0.1:5765")
        return cls(open_line(url))

    def reset(self, clock: Clock, lockstep: bool, say: Callable[[int, str], None]) -> None:
        super().reset(clock, lockstep, say)
        self._restarts_before = self._port.restarts
        self._commands_before = self._port.commands
        self._junk_before = self._port.junk

    def handle_bytes(self, chunk: bytes) -> bool:
        port = self._port
        refused_before = port.refused
        answers = port.feed(chunk)
        for answer in answers:
            self._line.send(answer)
        counts = self.counts
        counts.commands_in = port.commands - self._commands_before
        counts.restarts = port.restarts - self._restarts_before
        counts.junk = port.junk - self._junk_before
        return len(answers) > port.refused - refused_before

    def is_accepted(self) -> bool:
        return self._port.set_up and self._line.connected

    def requested_hz(self) -> float:
        divisor = self._port.divisors.get(INERTIAL)
        return 0.0 if divisor is None else RATE_HZ / divisor

    def hint(self) -> str:
        return "check EAHRS_TYPE 1, SERIALn_PROTOCOL 36, and that this is port n"

    def inertial_frame(self, sample: InertialSample) -> bytes | None:
        return pack_inertial_frame(sample) if self._flows(INERTIAL) else None

    def solution_frame(self, navigation: Navigation) -> bytes | None:
        if not self._flows(SOLUTION):
            return None
        oldest_ns = navigation.stamp_ns - _STALE_NS
        samples = (self._readings.field, self._readings.pressure)
        is_fresh = all(sample is not None and sample.stamp_ns >= oldest_ns for sample in samples)
        return pack_solution_frame(navigation, 0 if is_fresh else FIELD_FAULT)

    def receiver_frame(self, fix: ReceiverFix) -> bytes | None:
        return pack_receiver_frame(fix) if self._flows(RECEIVER) else None

    def _flows(self, output: int) -> bool:
        return self._port.on and output in self._port.divisors
