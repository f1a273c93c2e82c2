"""No autopilot: motor commands by the clock, straight to the vessel."""

from __future__ import annotations

from sim_core.kinematics import Kinematics
from xitl_cli.record.records import MotorCommand
from xitl_cli.replay.track import Track
from xitl_cli.run.nodes.direct_pilot import DirectPilot
from xitl_cli.run.pilot import Progress


class TrackPilot(DirectPilot):
    """Plays a script or a recording; knows no waypoints. Played to its end it has completed what it was for."""

    def __init__(self, track: Track, mode: str, propellers: int) -> None:
        super().__init__(track.motors_at(0) or (0.0,) * propellers)
        self._track = track
        self._mode = mode
        self._now_ns = 0

    def exchange(self, sim_ns: int, motion: Kinematics) -> None:
        self._now_ns = sim_ns
        motors = self._track.motors_at(sim_ns)
        if motors is not None and motors != self.command.motors:
            self.command = MotorCommand(motors, armed=True)

    def progress(self) -> Progress:
        track = self._track
        return Progress(
            mode=self._mode,
            armed=True,
            finished=track.end_ns is not None and self._now_ns >= track.end_ns,
            completed=self._now_ns >= track.last_ns,
            waypoints=(),
        )
