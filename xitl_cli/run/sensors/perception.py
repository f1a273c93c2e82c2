"""The eyes of a companion in the loop: instruments that look at the world, and the truth they are held against."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Protocol

from sim_core.kinematics import Kinematics
from sim_core.simulation import Simulation, SimulationState
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.recorder import Recorder
from xitl_cli.run.seeds import Seeds
from xitl_cli.run.sensors.lidar import lidar_of
from xitl_cli.run.sensors.sonar import sonar_of
from xitl_cli.run.world.scenery import Scenery

SOURCE = "perception"
WARNING, INFO = 4, 6  # MAV_SEVERITY

Send = Callable[[Sequence[Any]], None]


class Instrument(Protocol):
    """A sensor of the companion. address: where others may talk to it too, None for nowhere."""

    @property
    def address(self) -> str | None: ...

    def begin(self, recorder: Any) -> None:
        """The run starts; what it sees is kept with the PerceptionRecorder."""

    def look(self, step: int, sim_ns: int, state: SimulationState, motion: Kinematics) -> list[Any]:
        """After each physics step, counted from 1: the messages that are due."""

    def report(self) -> dict[str, Any]:
        """What it did, for the summary."""

    def close(self) -> None:
        """Give back what it holds."""


class NoPerception:
    """Nothing is looked at."""

    def begin(self, recorder: Recorder) -> None:
        """The run starts."""

    def look(self, step: int, sim_ns: int, state: SimulationState, motion: Kinematics) -> None:
        """After each physics step, counted from 1."""

    def report(self) -> dict[str, Any] | None:
        """What each instrument did, by name."""
        return None

    def close(self) -> None:
        """Give back what they hold."""


class Perception(NoPerception):
    """Instruments by name, and where their messages go. warnings: what of the world looks wrong when the run begins."""

    def __init__(
        self, instruments: dict[str, Instrument], send: Send, warnings: Callable[[], Sequence[str]] = tuple
    ) -> None:
        self._instruments = instruments
        self._send = send
        self._warnings = warnings

    def begin(self, recorder: Recorder) -> None:
        for text in self._warnings():
            recorder.log(0, WARNING, SOURCE, text)
        for name, instrument in self._instruments.items():
            if instrument.address is not None:
                recorder.log(0, INFO, SOURCE, f"{name} answers its own protocol at {instrument.address}")
            instrument.begin(recorder.perception)

    def look(self, step: int, sim_ns: int, state: SimulationState, motion: Kinematics) -> None:
        for instrument in self._instruments.values():
            messages = instrument.look(step, sim_ns, state, motion)
            if messages:
                self._send(messages)

    def report(self) -> dict[str, Any]:
        return {name: instrument.report() for name, instrument in self._instruments.items()}

    def close(self) -> None:
        for instrument in self._instruments.values():
            instrument.close()


def perception_of(
    profile: RunProfile, seeds: Seeds, scenery: Scenery, simulation: Simulation, send: Send
) -> NoPerception:
    """What the profile has of lidar and sonar. Raises UserError for a mesh or a line that cannot be had."""
    sensors = profile.sensors
    instruments: dict[str, Instrument] = {}
    if sensors is not None and sensors.lidar is not None:
        instruments["lidar"] = lidar_of(profile, seeds, scenery, simulation)
    if sensors is not None and sensors.sonar is not None:
        instruments["sonar"] = sonar_of(profile, seeds, scenery, simulation)
    return Perception(instruments, send, lambda: scenery.warnings) if instruments else NoPerception()
