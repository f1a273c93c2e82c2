"""Parameters and mission brought to an autopilot that is played by the test, on simulation time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from agent.mavlink.missions import waypoint_items
from agent.wire import dialect
from tests.golden import Golden
from xitl_cli.errors import UserError
from xitl_cli.run.nodes import preparation
from xitl_cli.run.nodes.preparation import (
    ACCEPT_AS_IS,
    ANSWER_S,
    MISSION_S,
    PREFLIGHT_CALIBRATION,
    REFUSED_S,
    TRIES,
    CalibrationStep,
    MissionStep,
    ParameterStep,
    PatientTimer,
)

SHARE = preparation.WALL_SHARE
TICK = 10_000_000
SECOND = 1_000_000_000
TARGET = (1, 1)
PLACES = [(-8.8, -63.95, 70.0), (-8.79, -63.95, 70.0), (-8.78, -63.94, 70.0)]
PLANS = {0: waypoint_items(PLACES)}
ACCEPTED, NO_SPACE = dialect.MAV_MISSION_ACCEPTED, dialect.MAV_MISSION_NO_SPACE


@pytest.fixture(autouse=True)
def _no_wall_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Here all goes by simulation time."""
    monkeypatch.setattr(preparation, "WALL_SHARE", 0.0)


class Rover:
    """Holds parameters and a mission. keeps: what it does not change. drops: messages that it does not get."""

    def __init__(self, drops: Callable[[int], bool] = lambda number: False, **parameters: float) -> None:
        self.parameters = parameters
        self.keeps: set[str] = set()
        self.sent: list[Any] = []
        self.items: list[Any] = []
        self.has_room = True
        self._drops = drops
        self._count = 0
        self._answers: list[Any] = []
        self._wanted = 0

    def take(self, message: Any) -> None:
        self.sent.append(message)
        if self._drops(len(self.sent)):
            return
        if isinstance(message, dialect.MAVLink_param_request_read_message):
            self._tell(message.param_id)
        elif isinstance(message, dialect.MAVLink_param_set_message):
            name = message.param_id
            if name not in self.keeps:
                self.parameters[name] = message.param_value
            self._tell(name)
        elif isinstance(message, dialect.MAVLink_mission_count_message):
            self.items, self._wanted = [], message.count
            self._ask()
        elif isinstance(message, dialect.MAVLink_mission_item_int_message) and message.seq == len(self.items):
            self.items.append(message)
            self._ask()

    def _tell(self, name: str) -> None:
        if name in self.parameters:
            kind = dialect.MAV_PARAM_TYPE_REAL32
            value = dialect.MAVLink_param_value_message(name.encode(), self.parameters[name], kind, 900, 65535)
            self._answers.append(value)

    def _ask(self) -> None:
        if not self.has_room:
            self._answers.append(dialect.MAVLink_mission_ack_message(255, 190, NO_SPACE, 0))
        elif len(self.items) == self._wanted:
            self._answers.append(dialect.MAVLink_mission_ack_message(255, 190, ACCEPTED, 0))
        else:
            self._answers.append(dialect.MAVLink_mission_request_message(255, 190, len(self.items), 0))

    def answers(self) -> list[Any]:
        taken, self._answers = self._answers, []
        return taken

    def kinds(self) -> list[str]:
        return [message.get_type() for message in self.sent]


def run(exchange: Any, rover: Rover, seconds: float, start_ns: int = 0) -> None:
    for sim_ns in range(start_ns, start_ns + round(seconds * SECOND), TICK):
        exchange.update(sim_ns)
        for answer in rover.answers():
            exchange.handle(answer)


def test_what_differs_is_set_and_what_is_right_is_left_alone() -> None:
    rover = Rover(WP_SPEED=2.0, WP_RADIUS=3.0)
    setting = ParameterStep(rover.take, TARGET, {"WP_RADIUS": 3.0, "WP_SPEED": 3.0})
    run(setting, rover, 0.2)
    assert setting.done
    assert rover.parameters == {"WP_SPEED": 3.0, "WP_RADIUS": 3.0}
    assert setting.changed == ["WP_SPEED"]
    assert rover.kinds() == ["PARAM_REQUEST_READ", "PARAM_REQUEST_READ", "PARAM_SET"]


def test_a_value_that_is_rounded_to_four_bytes_on_the_way_is_right() -> None:
    rover = Rover(INS_POS1_X=0.10000000149011612)
    setting = ParameterStep(rover.take, TARGET, {"INS_POS1_X": 0.1})
    run(setting, rover, 0.1)
    assert setting.done
    assert setting.changed == []


def test_what_is_lost_on_the_way_is_asked_for_again() -> None:
    rover = Rover(drops=lambda number: number % 2 == 1, WP_SPEED=2.0)
    setting = ParameterStep(rover.take, TARGET, {"WP_SPEED": 3.0})
    run(setting, rover, 3 * ANSWER_S)
    assert setting.done
    assert rover.parameters["WP_SPEED"] == 3.0


def test_a_parameter_that_the_autopilot_does_not_change_is_named_with_both_values() -> None:
    rover = Rover(WP_SPEED=2.0)
    rover.keeps = {"WP_SPEED"}
    setting = ParameterStep(rover.take, TARGET, {"WP_SPEED": 3.0})
    with pytest.raises(UserError, match=r"autopilot.parameters.WP_SPEED = 3: the autopilot keeps 2"):
        run(setting, rover, 1.0)


def test_a_parameter_that_the_firmware_does_not_have_is_named(golden: Golden) -> None:
    rover = Rover()
    setting = ParameterStep(rover.take, TARGET, {"WP_SPED": 3.0})
    with pytest.raises(UserError) as refused:
        run(setting, rover, (TRIES + 1) * ANSWER_S)
    golden("error", refused.value, tries=TRIES)
    assert len(rover.sent) == TRIES


def test_the_parameters_of_others_that_come_in_between_are_passed_over() -> None:
    rover = Rover(WP_SPEED=2.0)
    setting = ParameterStep(rover.take, TARGET, {"WP_SPEED": 3.0})
    setting.update(0)
    setting.handle(dialect.MAVLink_param_value_message(b"WP_RADIUS", 3.0, 9, 900, 65535))
    setting.handle(dialect.MAVLink_heartbeat_message(11, 3, 0, 0, 4, 3))
    assert not setting.done
    run(setting, rover, 0.1, TICK)
    assert setting.done


def test_the_mission_is_handed_over_item_by_item_with_home_first() -> None:
    rover = Rover()
    upload = MissionStep(rover.take, TARGET, PLANS)
    run(upload, rover, 0.2)
    assert upload.done
    assert rover.kinds() == ["MISSION_COUNT", *["MISSION_ITEM_INT"] * 3, "MISSION_SET_CURRENT"]
    assert rover.sent[-1].seq == 1
    assert [(item.seq, item.x, item.y) for item in rover.items] == [
        (seq, round(lat * 1e7), round(lon * 1e7)) for seq, (lat, lon, _) in enumerate(PLACES)
    ]


def test_a_mission_that_is_lost_on_the_way_is_announced_again() -> None:
    rover = Rover(drops=lambda number: number in (1, 3))
    upload = MissionStep(rover.take, TARGET, PLANS)
    run(upload, rover, 3.5)
    assert upload.done
    assert [item.seq for item in rover.items] == [0, 1, 2]


def test_an_autopilot_that_has_no_room_yet_gets_the_mission_later() -> None:
    rover = Rover()
    rover.has_room = False
    upload = MissionStep(rover.take, TARGET, PLANS)
    run(upload, rover, REFUSED_S / 2)
    assert not upload.done
    rover.has_room = True
    run(upload, rover, 2.0, round(REFUSED_S / 2 * SECOND))
    assert upload.done


def test_an_autopilot_that_goes_on_refusing_the_mission_ends_the_run_with_its_reason() -> None:
    rover = Rover()
    rover.has_room = False
    upload = MissionStep(rover.take, TARGET, PLANS)
    with pytest.raises(UserError, match=r"mission: the autopilot refused it \(MAV_MISSION_NO_SPACE\)"):
        run(upload, rover, REFUSED_S + 1.0)


def test_an_autopilot_that_does_not_ask_for_the_mission_ends_the_run() -> None:
    rover = Rover(drops=lambda number: True)
    upload = MissionStep(rover.take, TARGET, PLANS)
    with pytest.raises(UserError, match="mission: the autopilot did not finish taking it"):
        run(upload, rover, MISSION_S + 1.0)


def test_no_mission_is_done_at_once() -> None:
    assert MissionStep(Rover().take, TARGET, {}).done


def test_the_calibration_is_accepted_by_the_command_that_arducopter_and_rover_know() -> None:
    rover = Rover()
    acceptance = CalibrationStep(rover.take, TARGET, wanted=True)
    acceptance.update(0)
    (command,) = rover.sent
    assert (command.command, command.param5) == (PREFLIGHT_CALIBRATION, ACCEPT_AS_IS)
    acceptance.handle(dialect.MAVLink_command_ack_message(PREFLIGHT_CALIBRATION, 0, 0, 0, 255, 190))
    assert acceptance.done


def test_an_autopilot_that_does_not_answer_to_it_is_left_at_that() -> None:
    rover = Rover()
    acceptance = CalibrationStep(rover.take, TARGET, wanted=True)
    run(acceptance, rover, (TRIES + 1) * ANSWER_S)
    assert acceptance.done
    assert len(rover.sent) == TRIES
    assert CalibrationStep(rover.take, TARGET, wanted=False).done


@pytest.fixture
def wall(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [100.0]
    monkeypatch.setattr(preparation, "WALL_SHARE", SHARE)
    monkeypatch.setattr(preparation.time, "monotonic", lambda: now[0])
    return now


def test_it_is_over_when_both_clocks_say_so(wall: list[float]) -> None:
    waiting = PatientTimer()
    assert not waiting.started
    assert not waiting.is_over(50 * SECOND, 1.0)
    waiting.start(10 * SECOND)
    wall[0] += 0.9 * SHARE
    assert not waiting.is_over(30 * SECOND, 1.0)  # twenty seconds of simulation in a moment
    wall[0] += 0.2 * SHARE
    assert waiting.is_over(30 * SECOND, 1.0)
    assert not waiting.is_over(10 * SECOND + SECOND // 2, 1.0)


def test_it_starts_anew_and_stops(wall: list[float]) -> None:
    waiting = PatientTimer()
    waiting.start(0)
    wall[0] += 10.0
    waiting.start(5 * SECOND)
    assert not waiting.is_over(6 * SECOND, 1.0)
    waiting.stop()
    assert not waiting.is_over(60 * SECOND, 1.0)
