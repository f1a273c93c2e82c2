"""The loop of a run: wait for the instant, step the world, let every node sense, exchange and record."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import Any

from xitl_cli.profile.schema.profile import ClockSpec
from xitl_cli.record.recorder import Recorder
from xitl_cli.record.topics import MotorCommand, PaceReport
from xitl_cli.run.core.node import RunStep, SimulationClock, VesselNodes
from xitl_cli.run.core.pace import Pace
from xitl_cli.run.core.reports import Ending
from xitl_cli.run.links.connection import wait_for_any
from xitl_cli.run.world.plant import Plant

WARNING = 4  # MAV_SEVERITY_WARNING


class Loop:
    """Steps `plant` and calls the nodes of each vessel, until one has finished, time is up or `interrupted` says so.

    While a controlling node waits for somebody, the vessel's state is frozen; the duration counts that time too.
    completed: the controlling nodes did all they were there for.
    """

    def __init__(
        self,
        keys: ClockSpec,
        plant: Plant,
        vessels: Sequence[VesselNodes],
        pace: Pace,
        clock: SimulationClock,
        recorder: Recorder,
        interrupted: Callable[[], bool],
    ) -> None:
        self.completed = False
        self._plant = plant
        self._controls = [vessel.control for vessel in vessels]
        self._vessels = vessels
        self._pace = pace
        self._clock = clock
        self._recorder = recorder
        self._interrupted = interrupted
        self._every_exchange = round(keys.physics_rate_hz / keys.exchange_rate_hz)
        self._last_step = round(keys.duration_s * keys.physics_rate_hz)
        self._slips = 0
        self._commands: list[MotorCommand] = []
        self._motors: list[tuple[float, ...]] = []

    def run(self) -> Ending:
        """Raises UserError when a node is lost or the recording cannot be written; the plant keeps its last state."""
        sense, exchange, record = (self._calls(method) for method in ("sense", "exchange", "record"))
        plant, clock = self._plant, self._clock
        vessel = plant.vessels[0]
        self._look_at_progress()
        number = 0
        while number < self._last_step:
            number += 1
            self._wait_until(plant.state.time_ns + plant.simulation.dt_ns)
            plant.advance(self._commanded())
            state = vessel.state
            clock.step_ns = state.time_ns
            step = RunStep(number, state.time_ns, state, vessel.motion(), vessel.held)
            for call in sense:
                call(step)
            exchanges = number % self._every_exchange == 0
            if exchanges:
                for call in exchange:
                    call(step)
                self._look_at_progress()
                self._recorder.flush_if_due()
            for call in record:
                call(step)
            if exchanges:
                if any(control.progress.finished for control in self._controls):
                    return Ending.FINISHED
                if self._interrupted():
                    return Ending.INTERRUPTED
        return Ending.DURATION

    def _calls(self, method: str) -> list[Callable[..., Any]]:
        return [call for vessel in self._vessels for call in vessel.overriding(method)]

    def _wait_until(self, sim_ns: int) -> None:
        pace = self._pace
        pace.wait_until(sim_ns, self._receive)
        if pace.slips != self._slips:
            self._slips = pace.slips
            self._recorder.log(self._plant.state.time_ns, WARNING, "run", _slipped(pace.report()))

    def _receive(self, seconds: float) -> None:
        """Take in what comes from anywhere; waits for it at most so long."""
        links = [link for links in self._calls("links") for link in links()]
        if not links:
            time.sleep(seconds)
        elif len(links) > 1:
            wait_for_any(links, seconds)
            seconds = 0.0
        for receive in self._calls("receive"):
            receive(seconds)

    def _commanded(self) -> list[tuple[float, ...]]:
        """Motor commands (C,) in force, by vessel."""
        commands = [control.command for control in self._controls]
        if commands != self._commands:
            self._commands = commands
            self._motors = [command.motors for command in commands]
        return self._motors

    def _look_at_progress(self) -> None:
        progress = [control.progress for control in self._controls]
        for vessel, one in zip(self._plant.vessels, progress, strict=True):
            vessel.held = bool(one.waits_for)
        self.completed = all(one.completed for one in progress)


def _slipped(report: PaceReport) -> str:
    return (
        f"this machine stood still: the world did too, {report.slipped_s:.2f} s in all (slip {report.slips}); an agent "
        "in real time had no sensors meanwhile"
    )
