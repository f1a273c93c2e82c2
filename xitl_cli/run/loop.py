"""The loop of a run: wait for the instant, step the world, let every node sense, exchange and record."""

from __future__ import annotations

import time
import traceback
from collections.abc import Callable, Collection, Iterator, Sequence

from agent.wire.dialect import MAV_SEVERITY_ERROR as ERROR
from agent.wire.dialect import MAV_SEVERITY_WARNING as WARNING
from sim_core.vessel.actuators import ActuatorError
from xitl_cli.errors import UserError
from xitl_cli.profile.schema.profile import ClockSpec
from xitl_cli.record.mcap_file import RecordingError
from xitl_cli.record.recorder import Recorder
from xitl_cli.registry import ACTUATORS, package_of
from xitl_cli.run.core.node import (
    PluginNodeError,
    RunNode,
    RunStep,
    SimulationClock,
    VesselNodes,
    WorldNodes,
    overriding,
)
from xitl_cli.run.core.pace import SOURCE as PACE
from xitl_cli.run.core.pace import Pace
from xitl_cli.run.core.reports import Ending
from xitl_cli.run.links.connection import wait_for_any
from xitl_cli.run.world.plant import Plant

Call = Callable[[RunStep], object]
Group = tuple[int, list[Call]]
"""Calls that get the same step. Number n is vessel n, counted from 1. Number 0 is the world's nodes, with the first
vessel's step.
"""


class Schedule:
    """Calls of a method of the nodes in their order, each with its period in physics steps.

    `touch` is called right before a node's `sense`. groups: the nodes of each group, by its number. periods: of all
    calls.
    """

    def __init__(self, method: str, groups: Sequence[tuple[int, Sequence[RunNode]]]) -> None:
        self._groups = [(number, list(_calls_of(method, nodes))) for number, nodes in groups]
        self.periods = sorted({period for _, calls in self._groups for period, _ in calls if period is not None})
        self._due: dict[tuple[bool, ...], list[Group]] = {}

    def due(self, number: int, touching: Collection[int] = ()) -> list[Group]:
        """Return the calls that are due at step `number`. touching: numbers of the groups with a contact."""
        key = tuple([number % period == 0 for period in self.periods])
        if touching or key not in self._due:
            periods = {period for period, divides in zip(self.periods, key, strict=True) if divides}
            due = [
                (group, [call for period, call in calls if period in periods or (period is None and group in touching)])
                for group, calls in self._groups
            ]
            due = [group for group in due if group[1]]
            if touching:
                return due
            self._due[key] = due
        return self._due[key]


def _calls_of(method: str, nodes: Sequence[RunNode]) -> Iterator[tuple[int | None, Call]]:
    """Yield period and call; the period of calls at a contact is None."""
    for node in nodes:
        if method == "sense":
            yield from ((None, call) for call in overriding([node], "touch"))
        period = getattr(node, f"{method}_every", 1)
        yield from ((period, call) for call in overriding([node], method))


class StepViews:
    """The latest step of the plant, for each group. A view is made at its first call: most steps need only a few."""

    def __init__(self, plant: Plant, number: int) -> None:
        self._plant = plant
        self._number = number
        self._views: list[RunStep | None] = [None] * (len(plant.vessels) + 1)

    def of_group(self, group: int) -> RunStep:
        """Return the step for a group's calls."""
        step = self._views[group]
        if step is None:
            view = self._plant.vessels[max(group - 1, 0)]
            step = RunStep(self._number, self._plant.state.time_ns, view, view.motion(), view.held)
            self._views[group] = step
        return step


class Loop:
    """Steps `plant` and calls the nodes of the world and of each vessel.

    The loop ends when every awaited vessel has finished, when the time is up or when `interrupted` returns True. A
    vessel's state is frozen while its controlling node waits; the duration includes that time. completed: the
    controlling nodes of the awaited vessels did their task.

    When a node of a fleet's vessel raises UserError and `on_loss` is not `end`, that vessel is lost. From then on its
    nodes only record. losses: the reasons, by vessel. The run ends with that error when no awaited vessel is left.

    An exchange first calls the nodes ahead of the controlling nodes for all vessels, then the controlling nodes. In
    lockstep, all agents therefore have their tick before the loop waits for the first answer. A fleet records in
    between: the host works while agents elsewhere do, and the recorded values depend on no answer.
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
        world: WorldNodes | None = None,
    ) -> None:
        self.completed = False
        self.losses: dict[str, str] = {}
        self._plant = plant
        self._world = world or WorldNodes()
        self._awaited = [vessel for vessel in vessels if vessel.awaited]
        self._vessels = vessels
        self._alone = not vessels[0].name
        self._on_loss = "end" if self._alone else keys.on_loss
        self._names = ["", *(vessel.name for vessel in vessels)]
        self._pace = pace
        self._clock = clock
        self._recorder = recorder
        self._interrupted = interrupted
        self._every_exchange = round(keys.physics_rate_hz / keys.exchange_rate_hz)
        self._last_step = round(keys.duration_s * keys.physics_rate_hz)
        self._slips = 0
        self._motors: list[tuple[float, ...]] = []

    def run(self) -> Ending:
        """Raises UserError when a node is lost or the recording cannot be written; the plant keeps its last state."""
        vessels, ahead, behind = self._vessels, [self._world.ahead], [self._world.behind]
        of_vessels = [vessel.nodes for vessel in vessels]
        sense = self._grouped("sense", ahead, of_vessels, behind)
        record = self._grouped("record", ahead, of_vessels, behind)
        # Calls before the controlling nodes, and calls from the controlling nodes on
        ticks = self._grouped("exchange", ahead, [vessel.ahead for vessel in vessels], [])
        answers = self._grouped("exchange", [], [vessel.behind for vessel in vessels], behind)
        plant, clock = self._plant, self._clock
        self._update_progress()
        number, dt_ns = 0, plant.simulation.dt_ns
        periods = sorted({*sense.periods, *record.periods, self._every_exchange})
        while number < self._last_step:
            # One step, or all steps until something is due
            due = 1
            if not self._pace.waits:
                due = min([period - number % period for period in periods])
            due = min(due, self._last_step - number)
            self._wait_until(plant.state.time_ns + due * dt_ns)
            try:
                plant.advance(self._motors, due)
            except ActuatorError as error:
                now_ns, package = plant.state.time_ns, package_of(ACTUATORS, error.kind)
                text = "".join(traceback.format_exception(error))
                self._recorder.log(now_ns, ERROR, "vehicle.actuators", text)
                raise PluginNodeError(
                    f"{error} at {now_ns * 1e-9:.2f} s ({package}); correct the plug-in or remove it from the profile"
                ) from error
            clock.step_ns = plant.state.time_ns
            number = clock.step_ns // dt_ns
            steps = StepViews(plant, number)
            touching = plant.touching()
            touched = {0 if self._alone else vessel + 1 for vessel in touching} if touching else ()
            self._call(sense.due(number, touched), steps)
            if number % self._every_exchange:
                self._call(record.due(number), steps, of_lost=True)
            else:
                self._call(ticks.due(number), steps)
                if not self._alone:
                    self._call(record.due(number), steps, of_lost=True)
                self._call(answers.due(number), steps)
                self._update_progress()
                self._recorder.flush_if_due()
                if self._alone:
                    self._call(record.due(number), steps, of_lost=True)
                remaining = self._remaining(self._awaited)
                if self._awaited and all(vessel.control.progress.finished for vessel in remaining):
                    return Ending.FINISHED
                if self._interrupted():
                    return Ending.INTERRUPTED
        return Ending.DURATION

    def _call(self, groups: list[Group], steps: StepViews, of_lost: bool = False) -> None:
        """Call the groups. When a node fails, raises UserError with the name of its vessel.

        of_lost: call the nodes of lost vessels too.
        """
        for number, calls in groups:
            if not of_lost and self._names[number] in self.losses:
                continue
            step = steps.of_group(number)
            try:
                for call in calls:
                    call(step)
            except UserError as error:
                self._lose(self._names[number], error)

    def _lose(self, name: str, error: UserError) -> None:
        """Mark the vessel as lost. Raises the error when it ends the run."""
        if not name or self._on_loss == "end" or isinstance(error, (RecordingError, PluginNodeError)):
            raise named(name, error) from error
        if name in self.losses:  # an error of its recording
            return
        self.losses[name] = str(error)
        effect = "drifts with its motors stopped" if self._on_loss == "drift" else "keeps its last motor commands"
        self._recorder.log(self._plant.state.time_ns, WARNING, "run", f"{name} is lost and {effect}: {error}")
        if not self._remaining(self._awaited or self._vessels):
            raise named(name, error) from error

    def _remaining(self, vessels: Sequence[VesselNodes]) -> list[VesselNodes]:
        return [vessel for vessel in vessels if vessel.name not in self.losses]

    def _grouped(
        self,
        method: str,
        first: Sequence[Sequence[RunNode]],
        vessels: Sequence[Sequence[RunNode]],
        last: Sequence[Sequence[RunNode]],
    ) -> Schedule:
        """Group the calls of `method`. first, last: lists of nodes of the world. vessels: the nodes of each vessel."""
        if self._alone:
            return Schedule(method, [(0, [node for nodes in (*first, *vessels, *last) for node in nodes])])
        numbered = [*((0, nodes) for nodes in first), *enumerate(vessels, start=1), *((0, nodes) for nodes in last)]
        return Schedule(method, numbered)

    def _wait_until(self, sim_ns: int) -> None:
        pace = self._pace
        pace.wait_until(sim_ns, self._receive)
        if pace.slips != self._slips:
            self._slips = pace.slips
            text = (
                f"this machine stalled and the world paused for {pace.slip_s:.2f} s (pause {pace.slips}, "
                f"{pace.report().slipped_s:.2f} s in all); an agent in real time got no sensor samples meanwhile"
            )
            self._recorder.log(self._plant.state.time_ns, WARNING, PACE, text)

    def _receive(self, seconds: float) -> None:
        """Process all input; wait for it for at most this time."""
        remaining = self._remaining(self._vessels)
        links = [link for vessel in remaining for of_node in overriding(vessel.nodes, "links") for link in of_node()]
        if not links:
            time.sleep(seconds)
        elif len(links) > 1:
            wait_for_any(links, seconds)
            seconds = 0.0
        for vessel in remaining:
            try:
                for receive in overriding(vessel.nodes, "receive"):
                    receive(seconds)
            except UserError as error:
                self._lose(vessel.name, error)

    def _update_progress(self) -> None:
        self._motors = []
        for view, vessel in zip(self._plant.vessels, self._vessels, strict=True):
            lost, control = vessel.name in self.losses, vessel.control
            view.held = bool(control.progress.waits_for) and not lost
            motors = control.command.motors
            self._motors.append((0.0,) * len(motors) if lost and self._on_loss == "drift" else motors)
        self.completed = bool(self._awaited) and all(
            vessel.control.progress.completed and vessel.name not in self.losses for vessel in self._awaited
        )


def named(vessel: str, error: UserError) -> UserError:
    """Prefix the error with the name of its vessel. An error of the recording belongs to no vessel."""
    return UserError(f"{vessel}: {error}") if vessel and not isinstance(error, RecordingError) else error
