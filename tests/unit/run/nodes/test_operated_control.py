"""A vessel without an autopilot that an operator drives, and what the operator does with streams."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from xitl_cli.errors import UserError
from xitl_cli.profile import load_profile
from xitl_cli.run.nodes.direct_control import OperatedControl
from xitl_cli.run.nodes.display import NoDisplay
from xitl_cli.run.nodes.operator import OperatorNode
from xitl_cli.run.operator.actions import ActionError, Arm, CommandMotor, EndRun, SteerVelocity
from xitl_cli.run.operator.operation import Operation
from xitl_cli.run.session import Result, run

MS = 1_000_000
STEP: Any = None  # motor commands need no step


def control(vehicle: str = "mitl") -> OperatedControl:
    return OperatedControl(load_profile(vehicle, ["driver.kind=ros", "ros.enabled=false"]).runnable())


def test_motor_commands_go_out_as_they_are_and_each_falls_silent_by_itself() -> None:
    vessel = control()
    said: list[str] = []
    vessel.give(CommandMotor(number=0, command=0.5))
    vessel.give(CommandMotor(number=1, command=-0.25))
    for ms in range(0, 1001, 20):
        if ms % 500 == 0:
            vessel.give(CommandMotor(number=1, command=-0.25))
        vessel.update(ms * MS, said.append)
        vessel.exchange(STEP)
        assert vessel.command.motors == (0.5, -0.25)
    vessel.update(1020 * MS, said.append)
    vessel.exchange(STEP)
    assert vessel.command.motors == (0.0, -0.25)
    assert said == ["no command for propeller 0 for 1 s: neutral"]
    assert vessel.silences == 1


def test_what_it_cannot_do_is_refused() -> None:
    vessel = control()
    with pytest.raises(ActionError, match="number = 2 is none of 2 propellers; use 0 to 1"):
        vessel.check(CommandMotor(number=2, command=0.0))
    with pytest.raises(ActionError, match="has no autopilot"):
        vessel.check(Arm())
    vessel.check(SteerVelocity(speed_mps=1.0, turn_rate_radps=0.0))
    vessel.give(EndRun())
    vessel.exchange(STEP)
    assert vessel.progress.finished


class Stream:
    """Asks at each exchange for what `wanted(seconds)` says, `times` times over."""

    def __init__(self, wanted: Any, times: int = 1) -> None:
        self.refused: list[str] = []
        self._wanted, self._times = wanted, times

    def __call__(self, operator: OperatorNode) -> None:
        self._operator = operator
        operator.listen(self._look)

    def _look(self) -> None:
        for action in self._wanted(self._operator.now_ns * 1e-9) * self._times:
            refusal = self._operator.ask(action, "ros")
            if refusal is not None:
                self.refused.append(refusal)


def played(folder: Path, stream: Stream, **keys: Any) -> Result:
    overrides = ["driver.kind=ros", "ros.enabled=false", *(f"{key}={value}" for key, value in keys.items())]
    profile = load_profile("mitl", overrides)
    return run(profile, folder, False, NoDisplay, operation=Operation(people=(stream,)))


@pytest.mark.medium
def test_of_many_between_two_exchanges_the_latest_counts(tmp_path: Path) -> None:
    one = [{"action": "velocity", "speed_mps": speed, "turn_rate_radps": 0.0} for speed in (0.1, 0.2)]
    stream = Stream(lambda now_s: one if now_s < 1.0 else [{"action": "end"}], times=3)
    summary = played(tmp_path / "run", stream).summary
    done, superseded = summary["operator"]["actions"]["velocity"], summary["operator"]["superseded"]
    assert 45 <= done <= 51
    assert superseded == 5 * done
    assert summary["ended"] == "finished"
    assert summary["verdict"]["why"] == "nodes of ROS drove"


@pytest.mark.medium
def test_a_vessel_that_nobody_can_drive_does_not_set_out(tmp_path: Path) -> None:
    profile = load_profile("mitl", ["driver.kind=ros", "ros.enabled=false"])
    with pytest.raises(UserError, match=r"driver\.kind = ros needs ROS, which is off.*--replay-events"):
        run(profile, tmp_path / "run", False, NoDisplay)
    assert not (tmp_path / "run").exists()
