"""A whole PX4 of a boat with two propellers, as its documentation describes it: simulator interface and MAVLink.

    python -m tests.doubles.px4_rover SIMULATOR_PORT MAVLINK_PORT

It calls the simulator and waits at a UDP port for a ground station, which it answers as system 1. It is disarmed and
silent at the simulator interface until it has had fixes for two seconds and is told to arm; it knows PX4's modes and
whole-number parameters, takes a mission and sails it by bearing and yaw rate alone. It ends when the simulator leaves.
"""

from __future__ import annotations

import math
import select
import socket
import struct
import sys
import time
from collections.abc import Iterator
from typing import Any

from pymavlink.dialects.v20 import common as mavlink

AUTO, LOITER, MISSION = 4, 3, 4
ARMED, CUSTOM = 128, 1
DECLINATION_RAD = math.radians(-14.0)  # near enough at the Madeira
LOOP_US, ACCEPTANCE_M, EARTH_M = 10_000, 3.0, 6_371_000.0
CRUISE, TURN, DAMPING = 0.5, 1.0, 0.6
WHOLE, REAL = mavlink.MAV_PARAM_TYPE_INT32, mavlink.MAV_PARAM_TYPE_REAL32


class Boat:
    """The autopilot; `now_us` is its clock, which HIL_SENSOR sets."""

    def __init__(self, simulator: socket.socket, ground: socket.socket) -> None:
        self.simulator, self.ground = simulator, ground
        self.station: Any = None
        self.mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
        self.mav.robust_parsing = True
        self.now_us = self.looped_us = self.beaten_us = 0
        self.armed = False
        self.mode = (AUTO, LOITER)
        self.fix: Any = None
        self.fixes = 0
        self.origin: Any = None
        self.yaw_rad: float | None = None
        self.rate_radps = 0.0
        self.field: tuple[float, float] | None = None
        self.items: dict[int, Any] = {}
        self.count = self.current = 0
        self.streams: dict[int, list[int]] = {}
        self.parameters = {"RD_TEST": (3.0, WHOLE), "RO_SPEED_LIM": (1.5, REAL)}

    @property
    def ready(self) -> bool:
        return self.fixes >= 10 and self.yaw_rad is not None

    # -- simulator

    def on_simulator(self, message: Any) -> None:
        kind = message.get_type()
        if kind == "HIL_GPS" and message.fix_type == 3:
            self.fix, self.fixes = message, self.fixes + 1
            if self.ready and self.origin is None:
                self.origin = message
        elif kind == "HIL_SENSOR":
            self.on_sensor(message)

    def on_sensor(self, sensor: Any) -> None:
        assert sensor.time_usec > self.now_us, "the clock steps back"
        dt_s = (sensor.time_usec - self.now_us) * 1e-6 if self.now_us else 0.0
        self.now_us, self.rate_radps = sensor.time_usec, sensor.zgyro
        if sensor.fields_updated & 0x1C0:
            self.field = (sensor.xmag, sensor.ymag)
        if self.yaw_rad is not None:
            self.yaw_rad += sensor.zgyro * dt_s
        if self.field is not None:
            told_rad = math.atan2(-self.field[1], self.field[0]) + DECLINATION_RAD
            before = told_rad if self.yaw_rad is None else self.yaw_rad
            self.yaw_rad = before + 0.01 * wrapped(told_rad - before)
        self.report()
        if self.armed and self.now_us - self.looped_us >= LOOP_US:
            self.looped_us = self.now_us
            starboard, port = self.steer()
            controls = [starboard, port, *[0.0] * 14]
            out = self.mav.hil_actuator_controls_encode(self.now_us, controls, ARMED | CUSTOM, 1)
            self.simulator.sendall(out.pack(self.mav))

    def steer(self) -> tuple[float, float]:
        """Starboard and port, from -1 to 1; motor 1 of a differential rover is the right one."""
        if self.mode != (AUTO, MISSION) or self.current >= self.count or self.yaw_rad is None:
            return (0.0, 0.0)
        item = self.items[self.current]
        north_m = math.radians((item.x - self.fix.lat) * 1e-7) * EARTH_M
        east_m = math.radians((item.y - self.fix.lon) * 1e-7) * EARTH_M * math.cos(math.radians(self.fix.lat * 1e-7))
        if math.hypot(north_m, east_m) < ACCEPTANCE_M:
            self.say(self.mav.mission_item_reached_encode(self.current))
            self.current += 1
            if self.current == self.count:
                self.mode = (AUTO, LOITER)
            return (0.0, 0.0)
        error_rad = wrapped(math.atan2(east_m, north_m) - self.yaw_rad)
        turn = max(-0.5, min(0.5, TURN * error_rad - DAMPING * self.rate_radps))
        ahead = CRUISE * max(0.0, math.cos(error_rad))
        return (ahead - turn, ahead + turn)

    # -- MAVLink

    def say(self, message: Any) -> None:
        if self.station is not None:
            self.ground.sendto(message.pack(self.mav), self.station)

    def report(self) -> None:
        if self.now_us - self.beaten_us >= 1_000_000:
            self.beaten_us = self.now_us
            mode = CUSTOM | (ARMED if self.armed else 0)
            custom = self.mode[0] << 16 | self.mode[1] << 24
            self.say(
                self.mav.heartbeat_encode(mavlink.MAV_TYPE_SURFACE_BOAT, mavlink.MAV_AUTOPILOT_PX4, mode, custom, 4)
            )
        for number, stream in self.streams.items():
            if stream[0] and self.now_us - stream[1] >= stream[0]:
                stream[1] = self.now_us
                self.say_stream(number)

    def say_stream(self, number: int) -> None:
        boot_ms = self.now_us // 1000
        if number == mavlink.MAVLINK_MSG_ID_SYS_STATUS:
            bits = mavlink.MAV_SYS_STATUS_PREARM_CHECK
            self.say(self.mav.sys_status_encode(bits, bits, bits * self.ready, 0, 12_000, 0, 90, 0, 0, 0, 0, 0, 0))
        elif number == mavlink.MAVLINK_MSG_ID_ATTITUDE_QUATERNION and self.yaw_rad is not None:
            half = self.yaw_rad / 2
            quat = (math.cos(half), 0.0, 0.0, math.sin(half))
            self.say(self.mav.attitude_quaternion_encode(boot_ms, *quat, 0, 0, self.rate_radps))
        elif number == mavlink.MAVLINK_MSG_ID_GPS_GLOBAL_ORIGIN and self.origin is not None:
            self.say(self.mav.gps_global_origin_encode(self.origin.lat, self.origin.lon, self.origin.alt))
        elif number == mavlink.MAVLINK_MSG_ID_LOCAL_POSITION_NED and self.origin is not None:
            north_m = math.radians((self.fix.lat - self.origin.lat) * 1e-7) * EARTH_M
            scale = math.cos(math.radians(self.origin.lat * 1e-7))
            east_m = math.radians((self.fix.lon - self.origin.lon) * 1e-7) * EARTH_M * scale
            velocity = (self.fix.vn * 0.01, self.fix.ve * 0.01, self.fix.vd * 0.01)
            self.say(self.mav.local_position_ned_encode(boot_ms, north_m, east_m, 0.0, *velocity))

    def on_ground(self, message: Any) -> None:
        kind = message.get_type()
        if kind == "COMMAND_LONG":
            result = self.obey(message)
            self.say(self.mav.command_ack_encode(message.command, result))
        elif kind == "TIMESYNC" and message.tc1 == 0:
            self.say(self.mav.timesync_encode(self.now_us * 1000, message.ts1))
        elif kind == "MISSION_COUNT":
            self.items, self.count, self.current = {}, message.count, 0
            self.ask_item()
        elif kind == "MISSION_ITEM_INT" and message.seq == len(self.items):
            self.items[message.seq] = message
            self.ask_item()
        elif kind == "PARAM_REQUEST_READ":
            self.say_parameter(message.param_id)
        elif kind == "PARAM_SET" and message.param_id in self.parameters:
            _, known = self.parameters[message.param_id]
            if message.param_type == known:  # PX4 refuses another type
                raw = struct.pack("<f", message.param_value)
                value = float(struct.unpack("<i", raw)[0]) if known == WHOLE else message.param_value
                self.parameters[message.param_id] = (value, known)
            self.say_parameter(message.param_id)

    def obey(self, command: Any) -> int:
        if command.command == mavlink.MAV_CMD_COMPONENT_ARM_DISARM:
            if command.param1 and not self.ready:
                return int(mavlink.MAV_RESULT_TEMPORARILY_REJECTED)
            self.armed = bool(command.param1)
        elif command.command == mavlink.MAV_CMD_DO_SET_MODE:
            self.mode = (int(command.param2), int(command.param3))
        elif command.command == mavlink.MAV_CMD_SET_MESSAGE_INTERVAL:
            self.streams[int(command.param1)] = [max(int(command.param2), 0), 0]
        else:
            return int(mavlink.MAV_RESULT_UNSUPPORTED)
        return int(mavlink.MAV_RESULT_ACCEPTED)

    def ask_item(self) -> None:
        if len(self.items) < self.count:
            self.say(self.mav.mission_request_int_encode(255, 190, len(self.items)))
        else:
            self.say(self.mav.mission_ack_encode(255, 190, mavlink.MAV_MISSION_ACCEPTED))

    def say_parameter(self, name: str) -> None:
        if name in self.parameters:
            value, kind = self.parameters[name]
            raw = struct.unpack("<f", struct.pack("<i", int(value)))[0] if kind == WHOLE else value
            self.say(self.mav.param_value_encode(name.encode(), raw, kind, len(self.parameters), 0))


def wrapped(angle_rad: float) -> float:
    return math.remainder(angle_rad, 2 * math.pi)


def parsed(parser: Any, data: bytes) -> Iterator[Any]:
    yield from parser.parse_buffer(data) or ()


def called(port: int, patience_s: float = 60.0) -> socket.socket:
    """PX4 calls again until somebody answers."""
    until_s = time.monotonic() + patience_s
    while True:
        try:
            simulator = socket.create_connection(("127.0.0.1", port))
        except ConnectionRefusedError:
            if time.monotonic() > until_s:
                raise
            time.sleep(0.01)
            continue
        simulator.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return simulator


def main(simulator_port: int, mavlink_port: int) -> None:
    ground = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    ground.bind(("127.0.0.1", mavlink_port))
    simulator = called(simulator_port)
    boat = Boat(simulator, ground)
    parsers = {simulator: mavlink.MAVLink(None), ground: mavlink.MAVLink(None)}
    for parser in parsers.values():
        parser.robust_parsing = True
    hello = boat.mav.heartbeat_encode(mavlink.MAV_TYPE_GENERIC, mavlink.MAV_AUTOPILOT_PX4, 0, 0, 0)
    simulator.sendall(hello.pack(boat.mav))
    while True:
        readable, _, _ = select.select([simulator, ground], (), ())
        if ground in readable:
            data, boat.station = ground.recvfrom(2048)
            for message in parsed(parsers[ground], data):
                boat.on_ground(message)
        if simulator in readable:
            data = simulator.recv(1 << 16)
            if not data:
                return
            for message in parsed(parsers[simulator], data):
                boat.on_simulator(message)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:3]))
