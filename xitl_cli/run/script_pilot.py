"""No autopilot: motor commands by the clock, straight to the vessel."""

from __future__ import annotations

import time

from sim_core.kinematics import Kinematics
from xitl_cli.profile.schema import RunProfile
from xitl_cli.recording.recorder import Recorder
from xitl_cli.recording.records import MotorCommand, Task
from xitl_cli.run.pace import Pace
from xitl_cli.run.pilot import ClockReport, LinkReport, NodeReport, Progress
from xitl_cli.run.score import EstimationScore


class ScriptPilot:
    """Holds each step of the script until the next; knows no waypoints and so never completes a mission."""

    def __init__(self, profile: RunProfile) -> None:
        self._steps = sorted(profile.driver.script, key=lambda step: step.at_s)
        self.command = MotorCommand((0.0,) * len(profile.vehicle.propellers), armed=True)
        self._next = 0
        self.estimation: EstimationScore | None = None
        self.stale_exchanges = 0

    def prepare(self) -> None:
        pass

    def begin(self, recorder: Recorder, pace: Pace) -> None:
        pass

    def sense(self, sim_ns: int, motion: Kinematics) -> None:
        pass

    def exchange(self, sim_ns: int, motion: Kinematics) -> None:
        while self._next < len(self._steps) and self._steps[self._next].at_s * 1e9 <= sim_ns:
            self.command = MotorCommand(self._steps[self._next].motors, armed=True)
            self._next += 1

    def idle(self, seconds: float) -> None:
        time.sleep(seconds)

    def progress(self) -> Progress:
        return Progress(mode="SCRIPT", armed=True)

    def position_error_m(self) -> float | None:
        return None

    def end(self) -> None:
        pass

    def close(self) -> None:
        pass

    def links(self) -> list[LinkReport]:
        return []

    def tasks(self) -> list[Task]:
        return []

    def clocks(self) -> list[ClockReport]:
        return []

    def nodes(self) -> list[NodeReport]:
        return []
