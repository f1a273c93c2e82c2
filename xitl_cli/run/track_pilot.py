"""No autopilot: motor commands by the clock, straight to the vessel."""

from __future__ import annotations

import time

from sim_core.kinematics import Kinematics
from xitl_cli.recording.recorder import Recorder
from xitl_cli.recording.records import MotorCommand, Task
from xitl_cli.replay.track import Track
from xitl_cli.run.pace import Pace
from xitl_cli.run.pilot import ClockReport, LinkReport, NodeReport, Progress
from xitl_cli.run.score import EstimationScore


class TrackPilot:
    """Plays a script or a recording; knows no waypoints. Played to its end it has completed what it was for."""

    def __init__(self, track: Track, mode: str, propellers: int) -> None:
        self._track = track
        self._mode = mode
        self._now_ns = 0
        self.command = MotorCommand(track.motors_at(0) or (0.0,) * propellers, armed=True)
        self.estimation: EstimationScore | None = None
        self.stale_exchanges = 0

    def prepare(self) -> None:
        pass

    def begin(self, recorder: Recorder, pace: Pace) -> None:
        pass

    def sense(self, sim_ns: int, motion: Kinematics) -> None:
        pass

    def exchange(self, sim_ns: int, motion: Kinematics) -> None:
        self._now_ns = sim_ns
        motors = self._track.motors_at(sim_ns)
        if motors is not None and motors != self.command.motors:
            self.command = MotorCommand(motors, armed=True)

    def idle(self, seconds: float) -> None:
        time.sleep(seconds)

    def progress(self) -> Progress:
        track = self._track
        return Progress(
            mode=self._mode,
            armed=True,
            finished=track.end_ns is not None and self._now_ns >= track.end_ns,
            completed=self._now_ns >= track.last_ns,
            waypoints=(),
        )

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
