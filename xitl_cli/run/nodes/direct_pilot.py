"""What pilots without an autopilot share: nothing to reach, nothing sensed, no link."""

from __future__ import annotations

import time

from sim_core.frames import Array
from sim_core.kinematics import Kinematics
from xitl_cli.record.recorder import Recorder
from xitl_cli.record.records import MotorCommand, Task
from xitl_cli.run.nodes.score import EstimationScore
from xitl_cli.run.pace import Pace
from xitl_cli.run.pilot import (
    ActuatorReport,
    ClockReport,
    FaultReport,
    LinkReport,
    NodeReport,
    TakeoverReport,
    Traffic,
)


class DirectPilot:
    """See Pilot. Commands go straight to the vessel; what is left to say is `exchange` and `progress`."""

    def __init__(self, motors: tuple[float, ...]) -> None:
        self.command = MotorCommand(motors, armed=True)
        self.estimation: EstimationScore | None = None
        self.stale_exchanges = 0

    def prepare(self) -> None:
        pass

    def begin(self, recorder: Recorder, pace: Pace) -> None:
        pass

    def sense(self, sim_ns: int, motion: Kinematics, air_ned_mps: Array) -> None:
        pass

    def idle(self, seconds: float) -> None:
        time.sleep(seconds)

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

    def actuators(self) -> ActuatorReport | None:
        return None

    def takeovers(self) -> list[TakeoverReport]:
        return []

    def faults(self) -> list[FaultReport]:
        return []

    def autopilot(self) -> None:
        return None

    def traffic(self) -> Traffic:
        return {}
