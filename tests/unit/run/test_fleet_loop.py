"""The loop of a run with several vessels: who is called when, until when, and who is named."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal

import pytest

from xitl_cli.errors import UserError
from xitl_cli.profile.schema.profile import ClockSpec
from xitl_cli.record.mcap_file import RecordingError
from xitl_cli.record.topics import MotorCommand
from xitl_cli.run.core.node import ControlNode, ExchangePart, RunNode, RunStep, SimulationClock, VesselNodes, WorldNodes
from xitl_cli.run.core.pace import Lockstep
from xitl_cli.run.core.reports import Ending, Progress
from xitl_cli.run.loop import Loop

CLOCK = ClockSpec(physics_rate_hz=100.0, exchange_rate_hz=50.0, duration_s=0.2)


class Deaf:
    def __getattr__(self, name: str) -> Any:
        return lambda *arguments: None


class View:
    """Of a plant, as one vessel has it."""

    def __init__(self, number: int) -> None:
        self.held = False
        self.state = f"state {number}"
        self.number = number

    def motion(self) -> str:
        return f"motion {self.number}"


class World:
    """In place of a plant: time alone goes on."""

    def __init__(self, vessels: int) -> None:
        self.simulation = self.state = self
        self.time_ns, self.dt_ns = 0, 10_000_000
        self.vessels = tuple(View(number) for number in range(vessels))
        self.commands: list[Any] = []

    def advance(self, commands: list[Any], max_steps: int = 1) -> None:
        self.time_ns += max_steps * self.dt_ns
        self.commands += [commands] * max_steps

    def touching(self) -> tuple[int, ...]:
        return ()


class Ends(ControlNode):
    """Finishes with exchange `last`; waits for somebody up to exchange `waits`."""

    def __init__(self, name: str, calls: list[str], last: int, waits: int = 0) -> None:
        self.command, self.progress = MotorCommand((0.0,)), Progress("", waits_for="armed" if waits else "")
        self.ticking = ExchangePart(lambda step: calls.append(f"{name} ticks"))
        self.steps: list[RunStep] = []
        self._name, self._calls, self._last, self._waits = name, calls, last, waits

    def exchange(self, step: RunStep) -> None:
        self._calls.append(f"{self._name} answers")
        self.steps.append(step)
        done = len(self.steps)
        self.command = MotorCommand((float(done),))
        waits = "armed" if done < self._waits else ""
        self.progress = Progress("", finished=done >= self._last, completed=done >= self._last, waits_for=waits)


class Sees(RunNode):
    def __init__(self, sense: Callable[[RunStep], None]) -> None:
        self.see = sense

    def sense(self, step: RunStep) -> None:
        self.see(step)


def loop_of(
    vessels: list[VesselNodes], world: WorldNodes | None = None, clock: ClockSpec = CLOCK
) -> tuple[Loop, World]:
    plant, pace, nobody = World(len(vessels)), Lockstep(), Deaf()
    anything: Any = plant
    silent: Any = nobody
    return Loop(clock, anything, vessels, pace, SimulationClock(pace), silent, lambda: False, world), plant


def test_all_have_their_tick_before_the_first_answer_is_waited_for_and_the_world_is_first_and_last() -> None:
    calls: list[str] = []
    controls = {name: Ends(name, calls, last=1) for name in ("a", "b")}
    vessels = [VesselNodes(name, control, (control.ticking, control)) for name, control in controls.items()]
    first, last = (ExchangePart(lambda step, who=who: calls.append(who)) for who in ("river", "view"))  # type: ignore[misc]
    loop, _ = loop_of(vessels, WorldNodes((first,), (last,)))
    assert loop.run() is Ending.FINISHED
    assert calls == ["river", "a ticks", "b ticks", "a answers", "b answers", "view"]
    assert [control.steps[0].motion for control in controls.values()] == ["motion 0", "motion 1"]
    assert [control.steps[0].state for control in controls.values()] == ["state 0", "state 1"]


def test_a_run_lasts_until_all_that_are_awaited_have_finished() -> None:
    calls: list[str] = []
    early, late, drifts = Ends("early", calls, 1), Ends("late", calls, 3), Ends("drifts", calls, 99)
    vessels = [VesselNodes(name, one, (one,)) for name, one in (("early", early), ("late", late))]
    loop, plant = loop_of([*vessels, VesselNodes("drifts", drifts, (drifts,), awaited=False)])
    assert loop.run() is Ending.FINISHED
    assert loop.completed
    assert [len(one.steps) for one in (early, late, drifts)] == [3, 3, 3]
    assert plant.commands[-1] == [(2.0,), (2.0,), (2.0,)]
    loop, _ = loop_of([VesselNodes("drifts", drifts, (drifts,), awaited=False)])
    assert loop.run() is Ending.DURATION
    assert not loop.completed


def test_a_vessel_is_held_for_itself() -> None:
    calls: list[str] = []
    ready, waits = Ends("ready", calls, 4), Ends("waits", calls, 4, waits=3)
    loop, _ = loop_of([VesselNodes("ready", ready, (ready,)), VesselNodes("waits", waits, (waits,))])
    loop.run()
    assert [step.held for step in ready.steps] == [False] * 4
    assert [step.held for step in waits.steps] == [True, True, True, False]


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (UserError("the agent is gone"), "b: the agent is gone"),
        (RecordingError("the disk is full"), "the disk is full"),
    ],
)
def test_what_goes_wrong_is_said_of_the_vessel_and_a_full_disk_of_nobody(error: UserError, said: str) -> None:
    def lost(step: RunStep) -> None:
        raise error

    calls: list[str] = []
    a, b = Ends("a", calls, 9), Ends("b", calls, 9)
    loop, _ = loop_of([VesselNodes("a", a, (a,)), VesselNodes("b", b, (Sees(lost), b))])
    with pytest.raises(UserError) as raised:
        loop.run()
    assert str(raised.value) == said


class DiesAt(Ends):
    """Is lost in exchange `dies`."""

    def __init__(self, name: str, calls: list[str], dies: int) -> None:
        super().__init__(name, calls, 99)
        self._dies = dies

    def exchange(self, step: RunStep) -> None:
        if len(self.steps) + 1 >= self._dies:
            raise UserError("the agent is gone")
        super().exchange(step)


@pytest.mark.parametrize(("on_loss", "motor"), [("drift", 0.0), ("continue", 2.0)])
def test_the_others_sail_on_without_a_lost_vessel(on_loss: Literal["drift", "continue"], motor: float) -> None:
    calls: list[str] = []
    a, b = DiesAt("a", calls, dies=3), Ends("b", calls, 6)
    recorded = ExchangePart(lambda step: None)
    vessels = [VesselNodes("a", a, (a, recorded)), VesselNodes("b", b, (b,))]
    loop, plant = loop_of(vessels, clock=replace(CLOCK, on_loss=on_loss))
    assert loop.run() is Ending.FINISHED
    assert loop.losses == {"a": "the agent is gone"}
    assert not loop.completed
    assert (len(a.steps), len(b.steps)) == (2, 6)
    assert plant.commands[-1] == [(motor,), (5.0,)]


def test_a_run_ends_when_all_that_are_awaited_are_lost() -> None:
    calls: list[str] = []
    a, b, drifts = DiesAt("a", calls, 2), DiesAt("b", calls, 4), Ends("drifts", calls, 99)
    vessels = [VesselNodes(name, one, (one,)) for name, one in (("a", a), ("b", b))]
    loop, _ = loop_of(
        [*vessels, VesselNodes("drifts", drifts, (drifts,), awaited=False)], clock=replace(CLOCK, on_loss="drift")
    )
    with pytest.raises(UserError, match=r"^b: the agent is gone$"):
        loop.run()
    assert [*loop.losses] == ["a", "b"]
