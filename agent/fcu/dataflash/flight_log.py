"""Content of the autopilot's log: ArduRover's messages, from each measurement and from each control cycle.

Every measurement is logged. Attitude and motor outputs are logged at the loop's rate, the rest in turn at a fifth of
it. TimeUS is the agent's clock. A cycle also logs changes of mode, arming, parameters, mission, home and failsafes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Callable, NamedTuple

import agent
from agent.fcu.control.heading_speed import ground_speed_mps
from agent.fcu.dataflash import records
from agent.fcu.dataflash.format import FORMATS, FORMATS_IN_LOCKSTEP, header
from agent.fcu.dataflash.writer import LogWriter, Opener
from agent.fcu.mission import MissionItem, MissionSequence
from agent.fcu.parameters import TABLE
from agent.fcu.vehicle import modes
from agent.fcu.vehicle.autopilot import LOOP_HZ, Autopilot
from agent.fcu.vehicle_state import INFO, WARNING, Actuators
from agent.navigation.geodetic import Home, LocalProjection
from agent.navigation.gps_time import GpsTime
from agent.navigation.measurements import (
    BarometerMeasurement,
    GnssMeasurement,
    ImuMeasurement,
    MagnetometerMeasurement,
    Vector3,
)
from agent.timing.tasks import TaskMiss, TaskStats

ARMED, DISARMED, HOME_SET, FENCE_ON, FENCE_OFF = 10, 11, 25, 41, 42  # EV
EKF_CHECK, EKF_BAD = 16, 2  # ERR subsystem and its code
FAILSAFES = {"GCS": 8, "Fence": 9, "EKF": 17, "IMU": 26}  # ERR subsystems
RESOLVED, OCCURRED = 0, 1  # ERR codes
WINDOW_NS = 10_000_000_000
_CALL_NS = 1_000_000_000  # between calls of `LoopWindow.finish`; the window ends at the nearest call
_ITEMS_A_CYCLE = 8  # limits the log of a mission with hundreds of items per cycle
_TEXT_BYTES = 64
_DEFAULTS = {row.name: float(row.default) for row in TABLE}
_CLOSE_S, _CLOSE_IN_LOCKSTEP_S = 2.0, 60.0


class LoopTimes(NamedTuple):
    """Timing of the loop."""

    long_loops: int
    loops: int
    longest_us: int
    """Longest interval between the starts of two loops."""
    load: int
    """The tasks' share of the time, in 0.1 %."""


class LoopWindow:
    """Regularity of the loop and load of the tasks over ten seconds, as ArduPilot's PM reports them.

    A loop is long at 1.2 times its period.
    """

    def __init__(self, now_ns: int, loop_hz: int) -> None:
        self._long_ns = 1_200_000_000 // loop_hz
        self._last_ns: int | None = None
        self._start(now_ns, 0.0)

    def _start(self, now_ns: int, busy_ns: float) -> None:
        self._start_ns = now_ns
        self._busy_ns = busy_ns
        self._loops = 0
        self._long_loops = 0
        self._longest_ns = 0

    def add_loop(self, now_ns: int) -> None:
        """Note the start of a loop."""
        if self._last_ns is not None:
            interval_ns = now_ns - self._last_ns
            self._loops += 1
            self._long_loops += interval_ns > self._long_ns
            if interval_ns > self._longest_ns:
                self._longest_ns = interval_ns
        self._last_ns = now_ns

    def finish(self, now_ns: int, stats: Sequence[TaskStats]) -> LoopTimes | None:
        """Return the window when it is complete, and start a new one. Call it about once a second.

        `stats` count since the executor's start.
        """
        duration_ns = now_ns - self._start_ns
        if duration_ns < WINDOW_NS - _CALL_NS // 2:
            return None
        busy_ns = sum(task.run_mean_ns * task.cycles for task in stats)
        load = round(1000.0 * max(0.0, busy_ns - self._busy_ns) / duration_ns)
        times = LoopTimes(self._long_loops, self._loops, self._longest_ns // 1000, load)
        self._start(now_ns, busy_ns)
        return times


class _Snapshot(NamedTuple):
    """State of a cycle, for comparison with the next one."""

    mode: int = -1
    armed: bool = False
    failsafes: tuple[str, ...] = ()
    parameters_version: int = -1
    position_valid: bool = False
    home: Home | None = None
    frame: LocalProjection | None = None
    mission: MissionSequence = MissionSequence()
    current: int = 0


class ChangeLog:
    """Logs occasional changes by `put`: mode, arming, parameters, mission, home, failsafes."""

    def __init__(self, put: Callable[[bytes], None]) -> None:
        self._put = put
        self._snapshot = _Snapshot()
        self._mode = -1
        self._armed = False
        self._ekf_bad = False
        self._fence_on = False
        self._values: dict[str, float] = {}
        self.offset_mgauss: Vector3 = (0.0, 0.0, 0.0)
        """COMPASS_OFS of the parameters last logged."""
        self._items: Iterator[tuple[int, MissionItem]] = iter(())
        self._items_total = 0

    def update(self, now_ns: int, autopilot: Autopilot) -> None:
        """Compare with the last cycle, and log the changes."""
        state, navigator = autopilot.state, autopilot.navigator
        old = self._snapshot
        new = self._snapshot = _Snapshot(
            state.mode,
            state.armed,
            autopilot.failsafes.active,
            autopilot.parameters.version,
            state.estimate.position_valid,
            navigator.home,
            autopilot.estimator.frame,
            navigator.mission,
            navigator.progress.current if state.armed and state.mode == modes.AUTO else 0,
        )
        if new != old:
            self._log_changes(now_ns // 1000, autopilot, old, new)

    def _log_changes(self, now_us: int, autopilot: Autopilot, old: _Snapshot, new: _Snapshot) -> None:
        if new.parameters_version != old.parameters_version:
            # The parameters that changed; all of them in the first call
            pack, values = FORMATS["PARM"].pack, self._values
            for name in autopilot.parameters:
                value = autopilot.parameters[name]
                if values.get(name) != value:
                    values[name] = value
                    self._put(pack(now_us, name.encode(), value, _DEFAULTS.get(name, math.nan)))
            x, y, z = (values.get(f"COMPASS_OFS_{axis}", 0.0) for axis in "XYZ")
            self.offset_mgauss = (x, y, z)
            if autopilot.fence.enabled != self._fence_on:
                self._fence_on = autopilot.fence.enabled
                self._put(FORMATS["EV"].pack(now_us, FENCE_ON if self._fence_on else FENCE_OFF))
        if new.mode != self._mode:
            self._mode = new.mode
            self._put(FORMATS["MODE"].pack(now_us, new.mode, new.mode, 0))
        self.set_armed(now_us, new.armed)
        frame, home = new.frame, new.home
        if frame is not None and frame is not old.frame:
            self._put(records.position_mark(now_us, records.ORIGIN, frame.lat_deg, frame.lon_deg, frame.alt_m))
        if home is not None and home != old.home:
            self._put(records.position_mark(now_us, records.HOME, *home))
            self._put(FORMATS["EV"].pack(now_us, HOME_SET))
        if old.position_valid and not new.position_valid:
            self._ekf_bad = True
            self._log_error(now_us, EKF_CHECK, EKF_BAD)
        elif self._ekf_bad and new.position_valid:
            self._ekf_bad = False
            self._log_error(now_us, EKF_CHECK, RESOLVED)
        if new.failsafes != old.failsafes:
            for name, subsystem in FAILSAFES.items():
                if (name in old.failsafes) == (name in new.failsafes):
                    continue
                # The code of a fence is the breached bits of FENCE_TYPE. Two breached areas are not distinguished.
                fence_type = int(autopilot.parameters["FENCE_TYPE"]) & 0xFF
                occurred = fence_type if name == "Fence" else OCCURRED
                self._log_error(now_us, subsystem, occurred if name in new.failsafes else RESOLVED)
        items = new.mission.items
        if new.mission != old.mission:
            self._items_total = len(items)
            self._items = iter(enumerate(items))
        if new.current != old.current and 0 < new.current < len(items):
            self._put(records.mission_item("MISE", now_us, new.current, len(items), items[new.current]))

    def log_mission_items(self, now_us: int) -> None:
        """Log some items of a new mission each cycle, until all are logged."""
        for _ in range(_ITEMS_A_CYCLE if self._items_total else 0):
            following = next(self._items, None)
            if following is None:
                self._items_total = 0
                return
            seq, item = following
            self._put(records.mission_item("CMD", now_us, seq, max(self._items_total, seq + 1), item))

    def set_armed(self, now_us: int, armed: bool) -> None:
        """Log arming or disarming at its own instant."""
        if armed != self._armed:
            self._armed = armed
            self._put(FORMATS["ARM"].pack(now_us, int(armed), int(self._values.get("ARMING_CHECK", 0))))
            self._put(FORMATS["EV"].pack(now_us, ARMED if armed else DISARMED))

    def _log_error(self, now_us: int, subsystem: int, code: int) -> None:
        self._put(FORMATS["ERR"].pack(now_us, subsystem, code))


class FlightLog:
    """Logs to the file that `opener` opens, each run to a new log.

    now_ns: the agent's clock, for measurements.

    Nothing here waits for the disk, except in lockstep. There the clock stops meanwhile, and the log must be the same
    every time.
    """

    def __init__(self, opener: Opener, now_ns: Callable[[], int]) -> None:
        self._opener = opener
        self._now_ns = now_ns
        self._writer: LogWriter | None = None
        self._closed: LogWriter | None = None
        self._put: Callable[[bytes], bool] = lambda _: False
        self._turns = (
            self._log_position,
            self._log_solution,
            self._log_health,
            self._log_navigation,
            self._log_inputs,
        )
        self._reset(0, False)

    def _reset(self, now_ns: int, lockstep: bool) -> None:
        self._lockstep = lockstep
        self._formats = FORMATS_IN_LOCKSTEP if lockstep else FORMATS
        self._cycles = 0
        self._changes = ChangeLog(self._put_important)
        self._gnss_us: int | None = None
        self._reported_problem = ""
        self._reported_drops = False
        self._window = LoopWindow(now_ns, LOOP_HZ)

    # -- the log file

    @property
    def path(self) -> Path | None:
        """Path of the newest log, None before its file is open."""
        writer = self._writer or self._closed
        return None if writer is None else writer.path

    @property
    def problem(self) -> str:
        """Reason why the newest log is incomplete, empty when it is complete."""
        writer = self._writer or self._closed
        if writer is None:
            return ""
        if writer.problem:
            return writer.problem
        if self._writer is None and writer.unwritten_bytes:
            return f"{writer.unwritten_bytes} bytes not written: the disk hangs"
        if writer.dropped:
            return f"{writer.dropped} records dropped: the disk is too slow"
        return ""

    @property
    def dropped(self) -> int:
        """Number of records of the newest log that were dropped."""
        writer = self._writer or self._closed
        return 0 if writer is None else writer.dropped

    def start(self, now_ns: int, lockstep: bool = False) -> None:
        """Start a new log. Close an open one."""
        self.close()
        self._reset(now_ns, lockstep)
        self._writer = LogWriter(self._opener, lossless=lockstep)
        self._put = self._writer.put
        self._writer.put(header(self._formats, now_ns // 1000), True)
        # Readers derive the vehicle type of the mode numbers from the name.
        self.log_event(now_ns, INFO, f"xitl {agent.__version__}, messages and modes as ArduRover V4")
        if lockstep:
            self.log_event(now_ns, INFO, "Lockstep: loop times are the clock's own; no CPU load")

    def close(self) -> None:
        """End the log. Waits for the disk for a limited time."""
        writer, self._writer = self._writer, None
        if writer is not None:
            self._closed = writer
            timeout_s = _CLOSE_IN_LOCKSTEP_S if self._lockstep else _CLOSE_S
            writer.close(_drops(self._now_ns() // 1000, writer), timeout_s)

    # -- measurements

    def log_imu(self, sample: ImuMeasurement) -> None:
        """Log a measurement that was just accepted, as do the next three methods."""
        if self._writer is not None:
            self._put(records.imu(self._now_ns() // 1000, sample))

    def log_gnss(self, sample: GnssMeasurement, gps_time: GpsTime | None) -> None:
        if self._writer is not None:
            now_us = self._now_ns() // 1000
            self._put(records.gnss(now_us, sample, now_us if self._gnss_us is None else self._gnss_us, gps_time))
            self._gnss_us = now_us

    def log_magnetometer(self, sample: MagnetometerMeasurement) -> None:
        if self._writer is not None:
            self._put(records.magnetometer(self._now_ns() // 1000, sample, self._changes.offset_mgauss))

    def log_barometer(self, sample: BarometerMeasurement) -> None:
        if self._writer is not None:
            self._put(records.barometer(self._now_ns() // 1000, sample))

    # -- the loop

    def log_cycle(self, now_ns: int, autopilot: Autopilot, actuators: Actuators) -> None:
        """Log a control cycle. Call it after each `Autopilot.control`."""
        if self._writer is None:
            return
        self._window.add_loop(now_ns)
        self._changes.update(now_ns, autopilot)
        now_us = now_ns // 1000
        output = autopilot.navigator.output if autopilot.state.armed else None
        desired_rad = math.nan if output is None else output.heading_rad
        self._put(records.attitude(now_us, autopilot.state.estimate, desired_rad))
        self._put(records.outputs(now_us, actuators, autopilot.allocator.mixer.outputs))
        self._turns[self._cycles % len(self._turns)](now_us, autopilot)
        self._changes.log_mission_items(now_us)
        if self._cycles % LOOP_HZ == 0:
            self._check_writer(now_us, autopilot, self._writer)
        self._cycles += 1

    def _log_position(self, now_us: int, autopilot: Autopilot) -> None:
        frame = autopilot.estimator.frame
        if frame is not None:
            self._put(records.position(now_us, autopilot.state.estimate, frame, autopilot.navigator.home))

    def _log_solution(self, now_us: int, autopilot: Autopilot) -> None:
        estimator = autopilot.estimator
        bias = estimator.gyro_bias_frd_radps
        self._put(records.solution(now_us, autopilot.state.estimate, bias, estimator.frame))

    def _log_health(self, now_us: int, autopilot: Autopilot) -> None:
        self._put(records.health(now_us, autopilot.state.estimate, autopilot.estimator.ratios))
        variances = autopilot.estimator.variances()
        if variances is not None:
            self._put(records.variances(now_us, variances, autopilot.state.estimate.yaw_rad))

    def _log_navigation(self, now_us: int, autopilot: Autopilot) -> None:
        output, state = autopilot.navigator.output, autopilot.state
        if output is not None and state.armed:
            self._put(records.navigation(now_us, output, state.estimate.yaw_rad))

    def _log_inputs(self, now_us: int, autopilot: Autopilot) -> None:
        state, manual = autopilot.state, autopilot.manual
        self._put(records.inputs(now_us, manual.widths_us(state.now_ns)))
        (vn, ve, _), desired_mps = state.estimate.vel_ned_mps, math.nan
        speed_mps = ground_speed_mps(state.estimate.yaw_rad, vn, ve)
        if state.armed and state.mode not in (modes.MANUAL, modes.HOLD):
            desired_mps = speed_mps + state.speed_error_mps
        sticks = manual.sticks(now_us * 1000)
        self._put(records.control(now_us, sticks, speed_mps, desired_mps, state.estimate.gyro_frd_radps[2]))

    def _check_writer(self, now_us: int, autopilot: Autopilot, writer: LogWriter) -> None:
        """Log the number of dropped records, and report trouble to the ground station. Called once a second."""
        self._put_important(_drops(now_us, writer))
        problem = writer.problem
        if problem != self._reported_problem:
            autopilot.events.add(WARNING, f"Log: {problem}" if problem else "Log: writing again")
            self._reported_problem = problem
        if writer.dropped and not self._reported_drops:
            autopilot.events.add(WARNING, "Log: the disk is too slow, records are dropped")
            self._reported_drops = True

    def _put_important(self, record: bytes) -> None:
        """Log a record that must not be dropped for lack of room."""
        if self._writer is not None:
            self._writer.put(record, True)

    # -- events and deadlines

    def log_event(self, now_ns: int, severity: int, text: str) -> None:
        """Log a sentence for the user of the ground station."""
        data = text.encode("ascii", "replace")
        for at in range(0, len(data), _TEXT_BYTES):
            self._put_important(FORMATS["MSG"].pack(now_ns // 1000, data[at : at + _TEXT_BYTES]))

    def log_disarmed(self, now_ns: int) -> None:
        """Log disarming at this instant, without a cycle after it."""
        self._changes.set_armed(now_ns // 1000, False)

    def log_task_stats(self, now_ns: int, stats: Sequence[TaskStats]) -> None:
        """Log the statistics of the executor's tasks since its start. Call it about once a second."""
        times = None if self._writer is None else self._window.finish(now_ns, stats)
        if times is None:
            return
        now_us = now_ns // 1000
        if self._lockstep:
            self._put_important(self._formats["PM"].pack(now_us, LOOP_HZ, *times[:3]))
            return
        self._put_important(self._formats["PM"].pack(now_us, LOOP_HZ, *times))
        for index, task in enumerate(stats):
            self._put(records.task(now_us, index, task))

    def log_missed_deadlines(self, now_ns: int, misses: Sequence[TaskMiss]) -> None:
        """Log each deadline that the executor's tasks missed."""
        for miss in () if self._lockstep else misses:
            self._put_important(records.missed_deadline(now_ns // 1000, miss))


def _drops(now_us: int, writer: LogWriter) -> bytes:
    return FORMATS["DSF"].pack(now_us, writer.dropped, writer.accepted_bytes)
