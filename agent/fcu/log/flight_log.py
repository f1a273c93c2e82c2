"""What the autopilot logs, and when: ArduRover's messages, from samples as they come and from its state each cycle.

Every sample is logged; attitude and motor outputs at the loop's rate, the rest in turns at a fifth of it. TimeUS is the
agent's clock. What a cycle finds changed (mode, arming, parameters, mission, home, failsafes) it logs by itself; the
hooks of those names only make the instant exact.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Callable

import agent
from agent.dataflash.files import Opener
from agent.dataflash.format import header
from agent.dataflash.messages import FORMATS, FORMATS_IN_LOCKSTEP
from agent.dataflash.writer import Writer
from agent.fcu import modes
from agent.fcu.autopilot import LOOP_HZ, Autopilot
from agent.fcu.control.loops import ground_speed_mps
from agent.fcu.events import INFO, WARNING, Event
from agent.fcu.log import records
from agent.fcu.log.changes import Changes
from agent.fcu.log.loop_window import LoopWindow
from agent.fcu.samples import Actuators, BarometerSample, Estimate, GnssSample, ImuSample, MagnetometerSample
from agent.timing.misses import Miss
from agent.timing.tasks import TaskStats


class FlightLog(Changes):
    """Logs to where `opener` says, each run to a new log; `now_ns` is the agent's clock, for what carries no instant.

    Nothing here waits for the disk, except in lockstep, where time stands still meanwhile and the log is to be the same
    every time.
    """

    def __init__(self, opener: Opener, now_ns: Callable[[], int]) -> None:
        self._opener = opener
        self._now_ns = now_ns
        self._writer: Writer | None = None
        self._closed: Writer | None = None
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
        self._writer = Writer(self._opener, lossless=lockstep)
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

    def imu(self, sample: ImuSample) -> None:
        if self._writer is not None:
            self._put(records.imu(self._now_ns() // 1000, sample))

    def gnss(self, sample: GnssSample) -> None:
        if self._writer is not None:
            now_us = self._now_ns() // 1000
            self._put(records.gnss(now_us, sample, now_us if self._gnss_us is None else self._gnss_us))
            self._gnss_us = now_us

    def magnetometer(self, sample: MagnetometerSample) -> None:
        if self._writer is not None:
            self._put(records.magnetometer(self._now_ns() // 1000, sample, self._offset_mgauss))

    def barometer(self, sample: BarometerSample) -> None:
        if self._writer is not None:
            self._put(records.barometer(self._now_ns() // 1000, sample))

    # -- the loop

    def cycle(self, now_ns: int, autopilot: Autopilot, actuators: Actuators) -> None:
        if self._writer is None:
            return
        self._window.loop(now_ns)
        estimate = autopilot.estimate
        self._look(now_ns, autopilot)
        now_us = now_ns // 1000
        output = autopilot.navigation if autopilot.armed else None
        self._put(records.attitude(now_us, estimate, math.nan if output is None else output.heading_rad))
        self._put(records.outputs(now_us, actuators))
        self._turns[self._count % len(self._turns)](now_us, autopilot, estimate)
        self._log_items(now_ns)
        if self._count % LOOP_HZ == 0:
            self._watch_writer(now_us, autopilot, self._writer)
        self._count += 1

    def _log_position(self, now_us: int, autopilot: Autopilot, estimate: Estimate) -> None:
        frame = autopilot.estimator.frame
        if frame is not None:
            self._put(records.position(now_us, estimate, frame, autopilot.home))

    def _log_solution(self, now_us: int, autopilot: Autopilot, estimate: Estimate) -> None:
        estimator = autopilot.estimator
        self._put(records.solution(now_us, estimate, estimator.gyro_bias_frd_radps, estimator.frame))

    def _log_health(self, now_us: int, autopilot: Autopilot, estimate: Estimate) -> None:
        self._put(records.health(now_us, estimate, autopilot.estimator.ratios))

    def _log_navigation(self, now_us: int, autopilot: Autopilot, estimate: Estimate) -> None:
        output = autopilot.navigation
        if output is not None and autopilot.armed:
            self._put(records.navigation(now_us, output, estimate.yaw_rad))

    def _log_inputs(self, now_us: int, autopilot: Autopilot, estimate: Estimate) -> None:
        self._put(records.inputs(now_us, autopilot.rc_channels))
        (vn, ve, _), desired_mps = estimate.vel_ned_mps, math.nan
        speed_mps = ground_speed_mps(estimate.yaw_rad, vn, ve)
        if autopilot.armed and autopilot.mode not in (modes.MANUAL, modes.HOLD):
            desired_mps = speed_mps + autopilot.speed_error_mps
        sticks = autopilot.manual.sticks(now_us * 1000)
        self._put(records.control(now_us, sticks, speed_mps, desired_mps, estimate.gyro_frd_radps[2]))

    # -- trouble

    def _watch_writer(self, now_us: int, autopilot: Autopilot, writer: Writer) -> None:
        """Once a second: what was dropped into the log, and trouble to the ground station."""
        self._put_important(_drops(now_us, writer))
        problem = writer.problem
        if problem != self._said_problem:
            autopilot.say(Event(WARNING, f"Log: {problem}" if problem else "Log: writing again"))
            self._said_problem = problem
        if writer.dropped and not self._said_drops:
            autopilot.say(Event(WARNING, "Log: the disk is too slow, records are dropped"))
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

    def missed(self, now_ns: int, misses: Sequence[Miss]) -> None:
        for one in () if self._lockstep else misses:
            self._put_important(records.miss(now_ns // 1000, one))


def _drops(now_us: int, writer: Writer) -> bytes:
    return FORMATS["DSF"].pack(now_us, writer.dropped, writer.accepted_bytes)
