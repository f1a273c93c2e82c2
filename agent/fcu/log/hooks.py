"""Where a flight log hangs on the autopilot."""

from __future__ import annotations

from collections.abc import Sequence

from agent.fcu.autopilot import Autopilot
from agent.fcu.mission import MissionItem
from agent.fcu.parameters import Parameters
from agent.fcu.samples import Actuators, BarometerSample, GnssSample, ImuSample, MagnetometerSample
from agent.timing.misses import Miss
from agent.timing.tasks import TaskStats


class NullFlightLog:
    """The hooks, doing nothing. Instants are the agent's clock's."""

    def begin(self, now_ns: int, lockstep: bool = False) -> None:
        """A new log starts here; one still open is closed."""

    def imu(self, sample: ImuSample) -> None:
        """A sample has come, as have those of the next three."""

    def gnss(self, sample: GnssSample) -> None: ...

    def magnetometer(self, sample: MagnetometerSample) -> None: ...

    def barometer(self, sample: BarometerSample) -> None: ...

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

    def missed(self, now_ns: int, misses: Sequence[Miss]) -> None:
        """Deadlines that the executor's tasks missed, each once."""

    @property
    def dropped(self) -> int:
        """Records of the newest log that it could not keep."""
        return 0

    def close(self) -> None:
        """The log ends here. Waits for the disk, but not long."""
