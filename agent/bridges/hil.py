"""HIL messages over the autopilot's own MAVLink link.

A script on the autopilot converts them to navigation-unit frames.

`firmware_params/lua/xitl_hil.lua` runs on the autopilot and emulates a VectorNav there. So one cable to stock ArduPilot
is enough. Once a second, NAMED_VALUE_FLOAT reports how many messages the script received and how many frames it
forwarded. The messages have no handshake: messages that the line has no room for are lost and counted.
"""

from __future__ import annotations

import time
from math import isfinite
from typing import Callable

from agent.bridges import hil_messages as hil
from agent.bridges.injector import Injector, InjectorCounters, InjectorError
from agent.bridges.readings import ReceiverFix, SampleDecimator, SensorReadings
from agent.bridges.vehicle_link import VehicleLink
from agent.navigation.measurements import ImuMeasurement
from agent.timing.clock import Clock, MonotonicClock
from agent.wire import dialect as mav
from agent.wire.codec import Message

SOLUTION_NS = 50_000_000
SILENT_NS = 3_000_000_000
ABSENT_NS = 1_000_000_000  # a sensor without a sample this long after the start of the run is absent
STANDARD_PRESSURE_PA, STANDARD_TEMPERATURE_DEGC = 101_325.0, 15.0
_WARNING, _NOTICE = mav.MAV_SEVERITY_WARNING, mav.MAV_SEVERITY_NOTICE
_PREFIX = "xitl_"
_COUNTERS = {"in": "script_in", "out": "script_out", "drop": "script_dropped"}


class HilMessages(Injector):
    """Injector that sends every IMU sample and every fix at once, and our own solution at 20 Hz once the position is
    known.
    """

    title = "HIL messages"

    def __init__(self, vehicle: VehicleLink, unix_s: Callable[[], float] = time.time) -> None:
        self.counts = InjectorCounters()
        self._vehicle = vehicle
        self._unix_s = unix_s
        self._script: dict[str, float] = {}  # last values from the script, counted since its own start
        vehicle.add_tap(self._on_vehicle)
        self.reset(MonotonicClock(), False, lambda severity, text: None)

    @classmethod
    def open(cls, url: str, vehicle: VehicleLink) -> HilMessages:
        """Open the injector over the autopilot's link, so that `url` is empty. Raises InjectorError."""
        if url:
            raise InjectorError("sensor-link: HIL messages go over the autopilot's own link; leave it out")
        return cls(vehicle)

    # -- called by the role

    def reset(self, clock: Clock, lockstep: bool, say: Callable[[int, str], None]) -> None:
        self.counts = InjectorCounters()
        self._clock = clock
        self._say = say
        self._readings = SensorReadings(lockstep, self._unix_s)
        self._updated = 0
        self._first_ns: int | None = None
        self._pace = SampleDecimator(SOLUTION_NS)
        self._heard_ns: int | None = None
        self._waiting_since_ns: int | None = None
        self._silent = False

    def handle(self, message: Message, now_ns: int) -> None:
        sample = self._readings.handle(message)
        if isinstance(sample, ImuMeasurement):
            self._on_imu(sample)
        elif isinstance(sample, ReceiverFix):
            self.counts.gnss_out += self._send(hil.gps_message(sample))
            self._readings.solve(sample)
        else:
            self._updated |= hil.updated_fields(sample)
        self.counts.refused = self._readings.refused

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
                "the script on the autopilot does not answer; set SCR_ENABLE 1 and install it: "
                "xitl params push PROFILE VEHICLE --with-script --reboot",
            )
        elif self._silent and not silent:
            self._say(_NOTICE, "the script on the autopilot answers")
        self._silent = silent
        self.counts.script_answers = self._heard_ns is not None and not silent
        self.counts.taken = self.counts.script_answers and self._script.get("hs") == 1.0

    # -- samples

    def _on_imu(self, imu: ImuMeasurement) -> None:
        readings, stamp_ns = self._readings, imu.stamp_ns
        if self._first_ns is None:
            self._first_ns = stamp_ns
        complete = readings.field is not None and readings.pressure is not None
        if complete or stamp_ns - self._first_ns > ABSENT_NS:
            sample = readings.inertial_sample(imu, STANDARD_PRESSURE_PA, STANDARD_TEMPERATURE_DEGC)
            updated, self._updated = self._updated | hil.ACCEL | hil.GYRO, 0
            self.counts.imu_out += self._send(hil.sensor_message(sample, updated))
        readings.solve(imu)
        if self._pace.is_due(stamp_ns):
            navigation = readings.solution()
            if navigation is not None:
                self.counts.solution_out += self._send(hil.state_message(navigation, imu.gyro_frd_radps))

    def _send(self, message: Message) -> bool:
        taken = self._vehicle.send_sample(message)
        self.counts.unsent += not taken
        return taken

    # -- the script

    def _on_vehicle(self, message: Message) -> None:
        if not isinstance(message, mav.MAVLink_named_value_float_message):
            return
        raw: object = message.name
        name = (raw.decode("ascii", "replace") if isinstance(raw, bytes) else str(raw)).partition("\0")[0]
        if not name.startswith(_PREFIX):
            return
        key, value = name[len(_PREFIX) :], float(message.value)
        if not isfinite(value):
            return
        self._heard_ns = self._clock.now_ns()
        script, counts = self._script, self.counts
        if key == "in":
            sent = counts.imu_out + counts.solution_out + counts.gnss_out
            started_in_run = key not in script and value <= sent
            restarted = key in script and value < script[key]
            counts.restarts += restarted
            if started_in_run or restarted:
                script.update(dict.fromkeys(_COUNTERS, 0.0))
        before, script[key] = script.get(key, value), value
        counter = _COUNTERS.get(key)
        if counter is not None:
            setattr(counts, counter, getattr(counts, counter) + max(round(value - before), 0))
