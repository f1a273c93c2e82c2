"""What the autopilot logs, and when: ArduRover's messages, from samples as they come and from its state each cycle.

Every sample is logged; attitude and motor outputs at the loop's rate, the rest in turns at a fifth of it. TimeUS is the
agent's clock. What a cycle finds changed (mode, arming, parameters, mission, home, failsafes) it logs by itself; the
hooks of those names only make the instant exact.
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
from agent.fcu.geodetic import Home, LocalProjection
from agent.fcu.mission import MissionItem, MissionSequence
from agent.fcu.parameters import TABLE, Parameters
from agent.fcu.vehicle import modes
from agent.fcu.vehicle.autopilot import LOOP_HZ, Autopilot
from agent.fcu.vehicle_state import (
    INFO,
    WARNING,
    Actuators,
    BarometerMeasurement,
    GnssMeasurement,
    ImuMeasurement,
    MagnetometerMeasurement,
    StateEstimate,
    Vector3,
)
from agent.timing.tasks import DeadlineMiss, TaskStats

ARMED, DISARMED, HOME_SET, FENCE_ON, FENCE_OFF = 10, 11, 25, 41, 42  # EV
EKF_CHECK, EKF_BAD = 16, 2  # ERR subsystem and its code
FAILSAFES = {"GCS": 8, "Fence": 9, "EKF": 17, "IMU": 26}  # ERR subsystems
RESOLVED, OCCURRED = 0, 1  # ERR codes
_ITEMS_A_CYCLE = 8  # a mission of hundreds of items is not logged in one cycle
_TEXT_BYTES = 64
_DEFAULTS = {row.name: float(row.default) for row in TABLE}
WINDOW_NS = 10_000_000_000
_CALL_NS = 1_000_000_000  # between calls of `take`; the window ends with the nearest one


class NullFlightLog:
    """The hooks, doing nothing. Instants are the agent's clock's."""

    def begin(self, now_ns: int, lockstep: bool = False) -> None:
        """A new log starts here; one still open is closed."""

    def imu(self, sample: ImuMeasurement) -> None:
        """A sample has come, as have those of the next three."""

    def gnss(self, sample: GnssMeasurement) -> None: ...

    def magnetometer(self, sample: MagnetometerMeasurement) -> None: ...

    def barometer(self, sample: BarometerMeasurement) -> None: ...

    def cycle(self, now_ns: int, autopilot: Autopilot, actuators: Actuators) -> None:
        """After each `Autopilot.control`."""

    def event(self, now_ns: int, severity: int, text: str) -> None:
        """A sentence for the person at the ground station."""

    def mode(self, now_ns: int, number: int, reason: int = 0) -> None:
        """The mode is now this; `reason` is ArduPilot's ModeReason, 0 unknown."""

    def arm(self, now_ns: int, armed: bool) -> None:
        """Armed, or disarmed."""

    def command(self, now_ns: int, seq: int, item: MissionItem) -> None:
        """An item of the mission."""

    def parameters(self, now_ns: int, parameters: Parameters) -> None:
        """What changed since the last call; at first, all."""

    def performance(self, now_ns: int, stats: Sequence[TaskStats]) -> None:
        """How the executor's tasks did since its start; call it about once a second."""

    def missed(self, now_ns: int, misses: Sequence[DeadlineMiss]) -> None:
        """Deadlines that the executor's tasks missed, each once."""

    @property
    def dropped(self) -> int:
        """Records of the newest log that it could not keep."""
        return 0

    def close(self) -> None:
        """The log ends here. Waits for the disk, but not long."""


class LoopTimes(NamedTuple):
    """`longest_us` from the start of one loop to that of the next; `load` is the tasks' share of the time, in 0.1 %."""

    long_loops: int
    loops: int
    longest_us: int
    load: int


class LoopWindow:
    """Told of every loop; a loop is long at 1.2 times its period."""

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

    def loop(self, now_ns: int) -> None:
        """A loop starts."""
        if self._last_ns is not None:
            interval_ns = now_ns - self._last_ns
            self._loops += 1
            self._long_loops += interval_ns > self._long_ns
            if interval_ns > self._longest_ns:
                self._longest_ns = interval_ns
        self._last_ns = now_ns

    def take(self, now_ns: int, stats: Sequence[TaskStats]) -> LoopTimes | None:
        """The window, once it is full; a new one then starts. Ask about once a second.

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


class _Seen(NamedTuple):
    """What a cycle compares with the cycle before."""

    mode: int = -1
    armed: bool = False
    failsafes: tuple[str, ...] = ()
    parameters_version: int = -1
    position_valid: bool = False
    home: Home | None = None
    frame: LocalProjection | None = None
    mission: MissionSequence = MissionSequence()
    current: int = 0


class Changes(NullFlightLog):
    """Finds them from cycle to cycle, and takes the hooks that make their instants exact."""

    def _forget(self) -> None:
        """All is new again."""
        self._seen = _Seen()
        self._mode = -1
        self._armed = False
        self._ekf_bad = False
        self._fence_on = False
        self._values: dict[str, float] = {}
        self._offset_mgauss: Vector3 = (0.0, 0.0, 0.0)
        self._items: Iterator[tuple[int, MissionItem]] = iter(())
        self._items_total = 0

    def _put_important(self, record: bytes) -> None:
        """Log what may not be dropped for want of room."""
        raise NotImplementedError

    # -- from cycle to cycle

    def _look(self, now_ns: int, autopilot: Autopilot) -> None:
        """Compare with the cycle before, and log what is new."""
        old = self._seen
        seen = self._seen = _Seen(
            autopilot.state.mode,
            autopilot.state.armed,
            autopilot.failsafes.active,
            autopilot.parameters.version,
            autopilot.state.estimate.position_valid,
            autopilot.navigation.home,
            autopilot.estimator.frame,
            autopilot.navigation.mission,
            autopilot.navigation.progress.current
            if autopilot.state.armed and autopilot.state.mode == modes.AUTO
            else 0,
        )
        if seen != old:
            self._log_changes(now_ns, autopilot, old, seen)

    def _log_changes(self, now_ns: int, autopilot: Autopilot, old: _Seen, seen: _Seen) -> None:
        now_us = now_ns // 1000
        if seen.parameters_version != old.parameters_version:
            self.parameters(now_ns, autopilot.parameters)
            self._log_fence(now_us, autopilot.fence.enabled)
        self.mode(now_ns, seen.mode)
        self.arm(now_ns, seen.armed)
        frame, home = seen.frame, seen.home
        if frame is not None and frame is not old.frame:
            self._put_important(records.place(now_us, records.ORIGIN, frame.lat_deg, frame.lon_deg, frame.alt_m))
        if home is not None and home != old.home:
            self._put_important(records.place(now_us, records.HOME, *home))
            self._put_important(FORMATS["EV"].pack(now_us, HOME_SET))
        if old.position_valid and not seen.position_valid:
            self._ekf_bad = True
            self._error(now_us, EKF_CHECK, EKF_BAD)
        elif self._ekf_bad and seen.position_valid:
            self._ekf_bad = False
            self._error(now_us, EKF_CHECK, RESOLVED)
        if seen.failsafes != old.failsafes:
            self._log_failsafes(now_us, autopilot.parameters, old.failsafes, seen.failsafes)
        if seen.mission != old.mission:
            self._items_total = len(seen.mission.items)
            self._items = iter(enumerate(seen.mission.items))
        if seen.current != old.current and 0 < seen.current < len(seen.mission.items):
            item = seen.mission.items[seen.current]
            total = len(seen.mission.items)
            self._put_important(records.mission_item("MISE", now_us, seen.current, total, item))

    def _log_fence(self, now_us: int, on: bool) -> None:
        if on != self._fence_on:
            self._put_important(FORMATS["EV"].pack(now_us, FENCE_ON if on else FENCE_OFF))
        self._fence_on = on

    def _log_failsafes(self, now_us: int, p: Parameters, old: tuple[str, ...], new: tuple[str, ...]) -> None:
        for name, subsystem in FAILSAFES.items():
            if (name in old) != (name in new):
                # A fence's code is the bits of FENCE_TYPE that were breached; which of two it was is not told apart.
                occurred = int(p["FENCE_TYPE"]) & 0xFF if name == "Fence" else OCCURRED
                self._error(now_us, subsystem, occurred if name in new else RESOLVED)

    def _log_items(self, now_ns: int) -> None:
        for _ in range(_ITEMS_A_CYCLE if self._items_total else 0):
            following = next(self._items, None)
            if following is None:
                self._items_total = 0
                return
            self.command(now_ns, *following)

    def _error(self, now_us: int, subsystem: int, code: int) -> None:
        self._put_important(FORMATS["ERR"].pack(now_us, subsystem, code))

    # -- the hooks

    def event(self, now_ns: int, severity: int, text: str) -> None:
        data = text.encode("ascii", "replace")
        for at in range(0, len(data), _TEXT_BYTES):
            self._put_important(FORMATS["MSG"].pack(now_ns // 1000, data[at : at + _TEXT_BYTES]))

    def mode(self, now_ns: int, number: int, reason: int = 0) -> None:
        if number != self._mode:
            self._mode = number
            self._put_important(FORMATS["MODE"].pack(now_ns // 1000, number, number, reason))

    def arm(self, now_ns: int, armed: bool) -> None:
        if armed != self._armed:
            self._armed = armed
            now_us = now_ns // 1000
            self._put_important(FORMATS["ARM"].pack(now_us, int(armed), int(self._values.get("ARMING_CHECK", 0))))
            self._put_important(FORMATS["EV"].pack(now_us, ARMED if armed else DISARMED))

    def command(self, now_ns: int, seq: int, item: MissionItem) -> None:
        total = max(self._items_total, seq + 1)
        self._put_important(records.mission_item("CMD", now_ns // 1000, seq, total, item))

    def parameters(self, now_ns: int, parameters: Parameters) -> None:
        pack, values = FORMATS["PARM"].pack, self._values
        for name in parameters:
            value = parameters[name]
            if values.get(name) != value:
                values[name] = value
                self._put_important(pack(now_ns // 1000, name.encode(), value, _DEFAULTS.get(name, math.nan)))
        x, y, z = (values.get(f"COMPASS_OFS_{axis}", 0.0) for axis in "XYZ")
        self._offset_mgauss = (x, y, z)


class FlightLog(Changes):
    """Logs to where `opener` says, each run to a new log; `now_ns` is the agent's clock, for what carries no instant.

    Nothing here waits for the disk, except in lockstep, where time stands still meanwhile and the log is to be the same
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
        self._count = 0
        self._forget()
        self._gnss_us: int | None = None
        self._said_problem = ""
        self._said_drops = False
        self._window = LoopWindow(now_ns, LOOP_HZ)

    # -- the log itself

    @property
    def path(self) -> Path | None:
        """Of the newest log, None before its file is open."""
        writer = self._writer or self._closed
        return None if writer is None else writer.path

    @property
    def problem(self) -> str:
        """Why the newest log is not whole, empty when it is."""
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
        writer = self._writer or self._closed
        return 0 if writer is None else writer.dropped

    def begin(self, now_ns: int, lockstep: bool = False) -> None:
        self.close()
        self._reset(now_ns, lockstep)
        self._writer = LogWriter(self._opener, lossless=lockstep)
        self._put = self._writer.put
        self._writer.put(header(self._formats, now_ns // 1000), True)
        # Readers tell by the name what vehicle's mode numbers these are.
        self.event(now_ns, INFO, f"xitl {agent.__version__}, messages and modes as ArduRover V4")
        if lockstep:
            self.event(now_ns, INFO, "Lockstep: loop times are the clock's own; no CPU load")

    def close(self) -> None:
        writer, self._writer = self._writer, None
        if writer is not None:
            self._closed = writer
            writer.close(_drops(self._now_ns() // 1000, writer), 60.0 if self._lockstep else 2.0)

    # -- sensors

    def imu(self, sample: ImuMeasurement) -> None:
        if self._writer is not None:
            self._put(records.imu(self._now_ns() // 1000, sample))

    def gnss(self, sample: GnssMeasurement) -> None:
        if self._writer is not None:
            now_us = self._now_ns() // 1000
            self._put(records.gnss(now_us, sample, now_us if self._gnss_us is None else self._gnss_us))
            self._gnss_us = now_us

    def magnetometer(self, sample: MagnetometerMeasurement) -> None:
        if self._writer is not None:
            self._put(records.magnetometer(self._now_ns() // 1000, sample, self._offset_mgauss))

    def barometer(self, sample: BarometerMeasurement) -> None:
        if self._writer is not None:
            self._put(records.barometer(self._now_ns() // 1000, sample))

    # -- the loop

    def cycle(self, now_ns: int, autopilot: Autopilot, actuators: Actuators) -> None:
        if self._writer is None:
            return
        self._window.loop(now_ns)
        estimate = autopilot.state.estimate
        self._look(now_ns, autopilot)
        now_us = now_ns // 1000
        output = autopilot.navigation.output if autopilot.state.armed else None
        self._put(records.attitude(now_us, estimate, math.nan if output is None else output.heading_rad))
        self._put(records.outputs(now_us, actuators))
        self._turns[self._count % len(self._turns)](now_us, autopilot, estimate)
        self._log_items(now_ns)
        if self._count % LOOP_HZ == 0:
            self._watch_writer(now_us, autopilot, self._writer)
        self._count += 1

    def _log_position(self, now_us: int, autopilot: Autopilot, estimate: StateEstimate) -> None:
        frame = autopilot.estimator.frame
        if frame is not None:
            self._put(records.position(now_us, estimate, frame, autopilot.navigation.home))

    def _log_solution(self, now_us: int, autopilot: Autopilot, estimate: StateEstimate) -> None:
        estimator = autopilot.estimator
        self._put(records.solution(now_us, estimate, estimator.gyro_bias_frd_radps, estimator.frame))

    def _log_health(self, now_us: int, autopilot: Autopilot, estimate: StateEstimate) -> None:
        self._put(records.health(now_us, estimate, autopilot.estimator.ratios))

    def _log_navigation(self, now_us: int, autopilot: Autopilot, estimate: StateEstimate) -> None:
        output = autopilot.navigation.output
        if output is not None and autopilot.state.armed:
            self._put(records.navigation(now_us, output, estimate.yaw_rad))

    def _log_inputs(self, now_us: int, autopilot: Autopilot, estimate: StateEstimate) -> None:
        self._put(records.inputs(now_us, autopilot.manual.widths_us(autopilot.state.now_ns)))
        (vn, ve, _), desired_mps = estimate.vel_ned_mps, math.nan
        speed_mps = ground_speed_mps(estimate.yaw_rad, vn, ve)
        if autopilot.state.armed and autopilot.state.mode not in (modes.MANUAL, modes.HOLD):
            desired_mps = speed_mps + autopilot.state.speed_error_mps
        sticks = autopilot.manual.sticks(now_us * 1000)
        self._put(records.control(now_us, sticks, speed_mps, desired_mps, estimate.gyro_frd_radps[2]))

    # -- trouble

    def _watch_writer(self, now_us: int, autopilot: Autopilot, writer: LogWriter) -> None:
        """Once a second: what was dropped into the log, and trouble to the ground station."""
        self._put_important(_drops(now_us, writer))
        problem = writer.problem
        if problem != self._said_problem:
            autopilot.events.add(WARNING, f"Log: {problem}" if problem else "Log: writing again")
            self._said_problem = problem
        if writer.dropped and not self._said_drops:
            autopilot.events.add(WARNING, "Log: the disk is too slow, records are dropped")
            self._said_drops = True

    def _put_important(self, record: bytes) -> None:
        if self._writer is not None:
            self._writer.put(record, True)

    # -- deadlines

    def performance(self, now_ns: int, stats: Sequence[TaskStats]) -> None:
        times = None if self._writer is None else self._window.take(now_ns, stats)
        if times is None:
            return
        now_us = now_ns // 1000
        if self._lockstep:
            self._put_important(self._formats["PM"].pack(now_us, LOOP_HZ, *times[:3]))
            return
        self._put_important(self._formats["PM"].pack(now_us, LOOP_HZ, *times))
        for index, task in enumerate(stats):
            self._put(records.task(now_us, index, task))

    def missed(self, now_ns: int, misses: Sequence[DeadlineMiss]) -> None:
        for one in () if self._lockstep else misses:
            self._put_important(records.miss(now_ns // 1000, one))


def _drops(now_us: int, writer: LogWriter) -> bytes:
    return FORMATS["DSF"].pack(now_us, writer.dropped, writer.accepted_bytes)
