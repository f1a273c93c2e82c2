"""HIL messages over the autopilot's own MAVLink link, where a script makes them frames of a navigation unit.

`firmware_params/lua/xitl_hil.lua` runs on the autopilot and plays a VectorNav there, so that one cable to stock
ArduPilot is enough. Once a second it says by NAMED_VALUE_FLOAT how many messages it took and how many frames it handed
on. The messages go by no handshake: what the line does not take is lost and counted.
"""

from __future__ import annotations

import time
from typing import Callable

from agent.bridges import hil_messages as hil
from agent.bridges.gps_time import fixed, of_unix_time
from agent.bridges.injector import Injection, Injector
from agent.bridges.navigation_solution import NavigationSolution
from agent.bridges.pace import Pace
from agent.bridges.samples import InertialSample, ReceiverFix
from agent.bridges.vehicle_link import VehicleLink
from agent.fcu.samples import BarometerSample, ImuSample, MagnetometerSample, Vector3
from agent.options import Options, OptionsError
from agent.timing.clock import Clock, MonotonicClock
from agent.wire import dialect as mav
from agent.wire.codec import Message

SOLUTION_NS = 50_000_000
SILENT_NS = 3_000_000_000
ABSENT_NS = 1_000_000_000  # a sensor that has not come since the run began will not
STANDARD_PRESSURE_PA, STANDARD_TEMPERATURE_DEGC = 101_325.0, 15.0
_WARNING, _NOTICE = 4, 5  # MAV_SEVERITY
_NO_FIELD: Vector3 = (0.0, 0.0, 0.0)
_PREFIX = "xitl_"


class HilMessages(Injector):
    """Every IMU sample and every fix as it comes, our own solution at 20 Hz once a place is known."""

    title = "HIL messages"

    def __init__(self, vehicle: VehicleLink, unix_s: Callable[[], float] = time.time) -> None:
        self.counts = Injection()
        self._vehicle = vehicle
        self._unix_s = unix_s
        self._told: dict[str, float] = {}  # by the script, of its own life and not of a run
        vehicle.add_tap(self._hear)
        self.reset(MonotonicClock(), False, lambda severity, text: None)

    @classmethod
    def make(cls, options: Options, vehicle: VehicleLink) -> HilMessages:
        """Over the autopilot's link. Raises OptionsError."""
        if options.sensor_link:
            raise OptionsError("sensor-link: HIL messages go over the autopilot's own link; leave it out")
        return cls(vehicle)

    # -- the role's side

    def reset(self, clock: Clock, lockstep: bool, say: Callable[[int, str], None]) -> None:
        self.counts = Injection()
        self._clock = clock
        self._say = say
        self._lockstep = lockstep
        self._time = fixed()
        self._solver: NavigationSolution | None = None
        self._field: MagnetometerSample | None = None
        self._pressure: BarometerSample | None = None
        self._updated = 0
        self._first_ns: int | None = None
        self._pace = Pace(SOLUTION_NS)
        self._before = dict(self._told)
        self._heard_ns: int | None = None
        self._waiting_since_ns: int | None = None
        self._silent = False

    def take(self, message: Message, now_ns: int) -> None:
        if isinstance(message, mav.MAVLink_xitl_imu_message):
            self._on_imu(message)
        elif isinstance(message, mav.MAVLink_xitl_gnss_message):
            self._on_gnss(message)
        elif isinstance(message, mav.MAVLink_xitl_magnetometer_message):
            x, y, z = message.field
            self._field = MagnetometerSample(message.time_usec * 1000, (x, y, z))
            self._updated |= hil.FIELD
            if self._solver is not None:
                self._solver.on_magnetometer(self._field)
        elif isinstance(message, mav.MAVLink_xitl_barometer_message):
            self._pressure = BarometerSample(message.time_usec * 1000, message.pressure, message.temperature)
            self._updated |= hil.PRESSURE | hil.TEMPERATURE
            if self._solver is not None:
                self._solver.on_barometer(self._pressure)

    def serve(self, now_ns: int) -> None:
        if not self._vehicle.connected or self._first_ns is None:
            self._waiting_since_ns = None
            return
        if self._waiting_since_ns is None:
            self._waiting_since_ns = now_ns
        heard_ns = max(self._waiting_since_ns, self._heard_ns or 0)
        silent = now_ns - heard_ns > SILENT_NS
        if silent and not self._silent:
            self._say(
                _WARNING,
                "the script on the autopilot says nothing; set SCR_ENABLE 1 and bring it there: "
                "xitl params push rover-hil VEHICLE --with-script --reboot",
            )
        elif self._silent and not silent:
            self._say(_NOTICE, "the script on the autopilot is heard")
        self._silent = silent
        self.counts.script_answers = self._heard_ns is not None and not silent
        self.counts.taken = self.counts.script_answers and self._told.get("hs") == 1.0

    # -- samples

    def _on_imu(self, message: Message) -> None:
        stamp_ns = message.time_usec * 1000
        gx, gy, gz = message.gyro
        fx, fy, fz = message.accel
        imu = ImuSample(stamp_ns, (gx, gy, gz), (fx, fy, fz), message.temperature)
        if self._first_ns is None or self._solver is None:
            self._first_ns = stamp_ns
            self._time = fixed() if self._lockstep else of_unix_time(self._unix_s(), stamp_ns)
            self._solver = NavigationSolution(self._time)
        field, pressure = self._field, self._pressure
        complete = field is not None and pressure is not None
        if complete or stamp_ns - self._first_ns > ABSENT_NS:
            sample = InertialSample(
                stamp_ns,
                imu.gyro_frd_radps,
                imu.accel_frd_mps2,
                _NO_FIELD if field is None else field.field_frd_gauss,
                STANDARD_PRESSURE_PA if pressure is None else pressure.pressure_pa,
                STANDARD_TEMPERATURE_DEGC if pressure is None else pressure.temperature_degc,
            )
            updated, self._updated = self._updated | hil.ACCEL | hil.GYRO, 0
            self.counts.imu_out += self._send(hil.sensor_message(sample, updated))
        self._solver.on_imu(imu)
        if self._pace.due(stamp_ns):
            navigation = self._solver.newest()
            if navigation is not None:
                self.counts.solution_out += self._send(hil.state_message(navigation, imu.gyro_frd_radps))

    def _on_gnss(self, message: Message) -> None:
        stamp_ns = message.time_usec * 1000
        vn, ve, vd = message.velocity
        fix = ReceiverFix(
            stamp_ns,
            self._time.at(stamp_ns),
            message.lat * 1e-7,
            message.lon * 1e-7,
            message.alt * 1e-3,
            (vn, ve, vd),
            message.h_acc,
            message.v_acc,
            message.s_acc,
            message.fix_type,
            message.satellites,
        )
        self.counts.gnss_out += self._send(hil.gps_message(fix))
        if self._solver is not None:
            self._solver.on_fix(fix)

    def _send(self, message: Message) -> int:
        taken = self._vehicle.send(message)
        self.counts.unsent += not taken
        return int(taken)

    # -- the script

    def _hear(self, message: Message) -> None:
        if not isinstance(message, mav.MAVLink_named_value_float_message):
            return
        raw: object = message.name
        name = (raw.decode("ascii", "replace") if isinstance(raw, bytes) else str(raw)).partition("\0")[0]
        if not name.startswith(_PREFIX):
            return
        self._heard_ns = self._clock.now_ns()
        key, value = name[len(_PREFIX) :], float(message.value)
        if key == "in" and value < self._told.get("in", 0.0):
            self._before.clear()
            self.counts.restarts += 1
        self._told[key] = value
        self._before.setdefault(key, 0.0 if self.counts.restarts else value)
        since = max(round(value - self._before[key]), 0)
        if key == "in":
            self.counts.script_in = since
        elif key == "out":
            self.counts.script_out = since
        elif key == "drop":
            self.counts.script_dropped = since
