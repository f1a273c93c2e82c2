"""Drivers against an autopilot that is played by the test: which messages they send, and when they are done."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agent.wire import dialect
from sim_core.geodesy import LocalFrame
from tests.golden import Golden
from xitl_cli.errors import UserError
from xitl_cli.profile.missions.ground_station_files import read_waypoints
from xitl_cli.profile.schema.agents import ScriptStep
from xitl_cli.replay.motor_schedule import MotorSchedule
from xitl_cli.run.links.agent_view import AgentView
from xitl_cli.run.links.autopilot_commands import AutopilotCommands
from xitl_cli.run.nodes.drivers import (
    READY_TIMEOUT_S,
    GroundStationDriver,
    MissionDriver,
    MissionItems,
    ReplayDriver,
    RosDriver,
    ScriptDriver,
)

S = 1_000_000_000
TICK = 20_000_000
FRAME = LocalFrame(-8.8, -63.95, 70.0)
ARM, SET_MODE = dialect.MAV_CMD_COMPONENT_ARM_DISARM, dialect.MAV_CMD_DO_SET_MODE
AUTO, GUIDED, MANUAL = 10, 15, 0


class Boat:
    """The autopilot's side: keeps what is sent to it, answers what it is told to."""

    def __init__(self) -> None:
        self.view = AgentView(FRAME, lambda severity, text: None, lambda stamp, estimate: None)
        self.sent: list[Any] = []
        self.orders = AutopilotCommands(self.view, self.sent.append, 1, 1)

    def take(self, kind: type[Any]) -> list[Any]:
        found = [message for message in self.sent if isinstance(message, kind)]
        self.sent.clear()
        return found

    def commands(self) -> list[tuple[int, float, float]]:
        return [(m.command, m.param1, m.param2) for m in self.take(dialect.MAVLink_command_long_message)]

    def accept(self, command: int, result: int = dialect.MAV_RESULT_ACCEPTED) -> None:
        self.view.handle(dialect.MAVLink_command_ack_message(command, result, 0, 0, 255, 190))

    def beat(self, mode: int, armed: bool) -> None:
        base = dialect.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
        self.view.handle(dialect.MAVLink_heartbeat_message(11, 3, base, mode, 4, 3))


@pytest.fixture
def boat() -> Boat:
    return Boat()


def test_a_mission_is_armed_when_ready_and_started_when_armed(boat: Boat) -> None:
    driver = MissionDriver(boat.orders, MissionItems((1, 2)))
    driver.update(TICK)
    assert boat.commands() == []
    boat.view.ready_to_arm = True
    driver.update(2 * TICK)
    assert boat.commands() == [(ARM, 1.0, 0.0)]
    driver.update(3 * TICK)
    assert boat.commands() == []  # an answer is given a second
    driver.update(2 * TICK + S)
    assert boat.commands() == [(ARM, 1.0, 0.0)]
    boat.accept(ARM)
    driver.update(3 * TICK + S)
    assert boat.commands() == [(SET_MODE, 1.0, 10.0)]
    boat.accept(SET_MODE)
    driver.update(4 * TICK + S)
    assert driver.progress().target == 0
    for mode, target in ((AUTO, 0), (GUIDED, None), (AUTO, 0)):  # an operator sends it elsewhere in between
        boat.beat(mode, armed=True)
        driver.update(5 * TICK + S)
        assert driver.progress().target == target
    boat.view.reached_seqs |= {1, 2}
    assert driver.progress().completed
    assert driver.progress().finished


def test_an_autopilot_that_never_gets_ready_ends_the_run(boat: Boat) -> None:
    boat.view.texts.append("PreArm: no fix")
    with pytest.raises(UserError, match="become ready to arm; it said: PreArm: no fix"):
        MissionDriver(boat.orders, MissionItems((1, 2))).update(round((READY_TIMEOUT_S + 1) * S))


def test_a_mission_waits_moored_for_the_others_of_its_fleet(boat: Boat) -> None:
    """Its time to arm runs anew once they are ready. It says that it is ready itself: two may wait for each other."""
    others = "escort to be ready"
    driver = MissionDriver(boat.orders, MissionItems((1, 2)), READY_TIMEOUT_S, lambda: others)
    assert (driver.ready, driver.progress().waits_for) == (False, "escort to be ready")
    boat.view.ready_to_arm = True
    late = round((READY_TIMEOUT_S + 30.0) * S)
    for now_ns in (TICK, late):
        driver.update(now_ns)
    assert driver.ready
    assert boat.commands() == []
    others = ""
    driver.update(late + TICK)
    assert boat.commands() == [(ARM, 1.0, 0.0)]
    assert driver.progress().waits_for == ""


def test_a_mission_that_is_not_ready_itself_does_not_wait_for_ever(boat: Boat) -> None:
    driver = MissionDriver(boat.orders, MissionItems((1, 2)), READY_TIMEOUT_S, lambda: "escort to be ready")
    with pytest.raises(UserError, match="become ready to arm"):
        driver.update(round((READY_TIMEOUT_S + 1) * S))


STEPS = (
    ScriptStep(at_s=1.0, mode="MANUAL", arm=True, rc_us=(1500, None, 1500)),
    ScriptStep(at_s=2.0, rc_us=(1600, 1234, None, None, None, None, None, None, 1700)),
    ScriptStep(at_s=3.0, mode="GUIDED", goto_ned_m=(30.0, -40.0), rc_us=(0, 0, 0, None, None, None, None, None, 0)),
    ScriptStep(at_s=4.0, arm=False, end=True),
)


def test_a_script_gives_each_order_in_its_time(boat: Boat) -> None:
    driver = ScriptDriver(boat.orders, FRAME, STEPS, MissionItems())
    driver.update(S - TICK)
    assert boat.sent == []
    driver.update(S)
    assert [type(message) for message in boat.sent] == [
        dialect.MAVLink_command_long_message,
        dialect.MAVLink_rc_channels_override_message,
    ]
    assert boat.commands() == [(SET_MODE, 1.0, float(MANUAL))]
    boat.accept(SET_MODE)
    driver.update(S + TICK)
    assert boat.commands() == [(ARM, 1.0, 0.0)]
    boat.accept(ARM)

    driver.update(2 * S)
    (override,) = boat.take(dialect.MAVLink_rc_channels_override_message)
    channels = [getattr(override, f"chan{number}_raw") for number in range(1, 19)]
    assert channels[:4] == [1600, 1234, 1500, 65535]
    assert channels[8] == 1700
    driver.update(2 * S + TICK)
    assert boat.sent == []
    driver.update(2 * S + 5 * TICK)  # repeated ten times a second, or the autopilot takes it for lost
    assert len(boat.take(dialect.MAVLink_rc_channels_override_message)) == 1

    driver.update(3 * S)
    (override,) = (m for m in boat.sent if isinstance(m, dialect.MAVLink_rc_channels_override_message))
    assert (override.chan1_raw, override.chan2_raw, override.chan3_raw, override.chan9_raw) == (0, 0, 0, 65534)
    assert boat.commands() == [(SET_MODE, 1.0, float(GUIDED))]
    boat.accept(SET_MODE)
    driver.update(3 * S + TICK)
    (target,) = boat.take(dialect.MAVLink_set_position_target_global_int_message)
    place = FRAME.ned(np.array([target.lat_int * 1e-7]), np.array([target.lon_int * 1e-7]), np.array([target.alt]))[0]
    assert place == pytest.approx([30.0, -40.0, 0.0], abs=0.01)  # 1e-7 degree is 11 mm
    assert target.type_mask == 0b110111111000
    assert not driver.progress().finished

    driver.update(4 * S)
    assert boat.commands() == [(ARM, 0.0, 0.0)]
    assert not driver.progress().finished  # its own order is still open
    boat.accept(ARM)
    assert driver.progress().finished
    assert driver.progress().completed


def test_a_target_is_repeated_while_the_vehicle_is_in_guided_and_no_longer(boat: Boat) -> None:
    driver = ScriptDriver(boat.orders, FRAME, (ScriptStep(at_s=0.0, goto_ned_m=(1.0, 2.0)),), MissionItems())
    kind = dialect.MAVLink_set_position_target_global_int_message
    driver.update(0)
    assert len(boat.take(kind)) == 1
    driver.update(S)
    assert boat.take(kind) == []
    boat.beat(GUIDED, armed=True)
    driver.update(2 * S)
    assert len(boat.take(kind)) == 1


def test_ros_nodes_see_what_the_departure_waits_for(boat: Boat) -> None:
    others = "escort to be ready"
    driver = RosDriver(boat.orders, FRAME, arms=True, others=lambda: others)
    driver.update(TICK)
    assert driver.progress().waits_for == others
    assert RosDriver(boat.orders, FRAME, arms=False).progress().waits_for == ""


def test_a_refused_order_is_repeated_until_the_next_step_and_spoils_the_script(boat: Boat) -> None:
    driver = ScriptDriver(
        boat.orders, FRAME, (ScriptStep(at_s=0.0, arm=True), ScriptStep(at_s=2.0, end=True)), MissionItems()
    )
    sent = []
    for tick in range(0, 2 * S + TICK, TICK):
        driver.update(tick)
        commands = boat.commands()
        if commands:
            boat.accept(ARM, dialect.MAV_RESULT_FAILED)
        sent += commands
    assert sent == [(ARM, 1.0, 0.0)] * 2
    assert driver.progress().finished
    assert not driver.progress().completed


def test_a_replay_waits_moored_and_then_goes_out_as_steering_and_throttle(boat: Boat) -> None:
    schedule = MotorSchedule((0, S), ((0.5, 0.5), (0.75, 0.25)), 2 * S)
    driver = ReplayDriver(boat.orders, schedule, (4, 2))
    driver.update(0)
    assert driver.progress().waits_for == "the autopilot to become ready to arm"
    boat.view.ready_to_arm = True
    driver.update(S)
    boat.accept(ARM)
    driver.update(S + TICK)
    assert boat.commands()[-1] == (SET_MODE, 1.0, float(MANUAL))
    boat.accept(SET_MODE)
    start = S + 2 * TICK
    driver.update(start)
    assert driver.progress().waits_for == ""
    for played, pulses in ((0, [65535, 1700, 65535, 1500]), (S, [65535, 1700, 65535, 1600])):
        boat.sent.clear()
        driver.update(start + played)
        (override,) = boat.take(dialect.MAVLink_rc_channels_override_message)
        assert [getattr(override, f"chan{number}_raw") for number in range(1, 5)] == pulses
    assert not driver.progress().completed
    driver.update(start + 2 * S)
    assert driver.progress().completed
    assert driver.progress().finished


PLACES = ((50.0, 10.0), (50.0, 60.0))


def _items(places: tuple[tuple[float, float], ...] = PLACES) -> list[Any]:
    """Home, a waypoint, a change of speed, and the other waypoints."""
    lat, lon, alt = FRAME.geodetic(np.array([[north, east, 0.0] for north, east in places]))
    waypoints = [(16, round(a * 1e7), round(o * 1e7), h) for a, o, h in zip(lat, lon, alt, strict=True)]
    rows = [(16, -88_000_000, -639_500_000, 70.0), waypoints[0], (178, 0, 0, 0.0), *waypoints[1:]]
    return [
        dialect.MAVLink_mission_item_int_message(255, 190, seq, 0, command, 0, 1, 0, 0, 0, 0, x, y, z, 0)
        for seq, (command, x, y, z) in enumerate(rows)
    ]


def _download(boat: Boat, driver: GroundStationDriver, now_ns: int, items: list[Any]) -> int:
    """Answer the driver's requests, every third only when it asks again."""
    asked = 0
    while True:
        driver.update(now_ns)
        requests, boat.sent[:] = list(boat.sent), []
        for request in requests:
            asked += 1
            if asked % 3 == 2:
                continue
            if isinstance(request, dialect.MAVLink_mission_request_list_message):
                driver.handle(dialect.MAVLink_mission_count_message(255, 190, len(items), 0))
            elif isinstance(request, dialect.MAVLink_mission_request_int_message):
                driver.handle(items[request.seq])
        if any(isinstance(message, dialect.MAVLink_mission_ack_message) for message in boat.sent):
            boat.sent.clear()
            return now_ns
        now_ns += S // 4
        assert now_ns < 100 * S


def _gcs(boat: Boat, stay: bool = False) -> GroundStationDriver:
    return GroundStationDriver(boat.orders, FRAME, ("udp://127.0.0.1:14550", "tcp://0.0.0.0:5760"), stay)


def test_a_ground_station_is_waited_for_without_an_order(boat: Boat) -> None:
    driver = _gcs(boat)
    boat.view.ready_to_arm = True
    for second in range(600):
        driver.update(second * S)
    assert boat.sent == []
    waits_for = driver.progress().waits_for
    assert "sends to UDP 127.0.0.1:14550, listens at TCP 0.0.0.0:5760" in waits_for
    boat.beat(MANUAL, armed=True)
    driver.update(600 * S)
    assert driver.progress().waits_for == ""
    boat.beat(MANUAL, armed=False)
    driver.update(601 * S)
    assert driver.progress().waits_for == ""  # once let go it is not moored again


def test_the_mission_that_a_ground_station_started_is_what_counts(boat: Boat) -> None:
    driver = _gcs(boat)
    boat.beat(AUTO, armed=True)
    _download(boat, driver, 0, _items())
    progress = driver.progress()
    assert progress.waypoints is not None
    assert [xy for place in progress.waypoints for xy in place] == pytest.approx(
        [xy for place in PLACES for xy in place], abs=0.02
    )
    boat.view.target_seq = 1
    assert driver.progress().target == 0
    boat.view.reached_seqs.add(1)
    boat.view.target_seq = 3  # the change of speed in between is no place
    assert (driver.progress().target, driver.progress().reached) == (1, 1)
    boat.view.reached_seqs.add(3)
    driver.update(50 * S)
    assert not driver.progress().finished  # the ground station is to hear of it
    driver.update(52 * S)
    progress = driver.progress()
    assert progress.finished
    assert progress.completed
    assert progress.target is None


def test_the_mission_of_a_ground_station_is_kept_as_a_file_that_a_profile_reads(boat: Boat, tmp_path: Path) -> None:
    driver = _gcs(boat)
    driver.save(tmp_path)
    assert not list(tmp_path.iterdir())  # no mission was started
    boat.beat(AUTO, armed=True)
    items = _items()
    _download(boat, driver, 0, items)
    driver.save(tmp_path)
    course = read_waypoints((tmp_path / "mission.waypoints").read_text(encoding="utf-8"))
    assert [item.command for item in course.items] == [16, 178, 16]
    for kept, sent in zip(course.items, items[1:], strict=True):
        place = None if not sent.x else (sent.x * 1e-7, sent.y * 1e-7)
        assert kept.place_deg == (place if place is None else pytest.approx(place, abs=1e-7))
        assert kept.altitude_m == pytest.approx(sent.z, abs=1e-6)


def test_a_mission_with_a_waypoint_skipped_is_over_and_not_completed(boat: Boat) -> None:
    driver = _gcs(boat)
    boat.beat(AUTO, armed=True)
    _download(boat, driver, 0, _items())
    boat.view.reached_seqs.add(3)
    driver.update(50 * S)
    driver.update(52 * S)
    assert driver.progress().finished
    assert not driver.progress().completed


def test_with_stay_another_mission_is_flown_after_the_first(boat: Boat) -> None:
    driver = _gcs(boat, stay=True)
    boat.beat(AUTO, armed=True)
    now_ns = _download(boat, driver, 0, _items())
    boat.view.reached_seqs |= {1, 3}
    assert driver.progress().completed
    assert not driver.progress().finished
    boat.beat(4, armed=True)
    driver.update(now_ns + S)
    boat.beat(AUTO, armed=True)
    _download(boat, driver, now_ns + 2 * S, _items(((5.0, 5.0), (9.0, 9.0), (12.0, 0.0))))
    progress = driver.progress()
    assert progress.reached == 0
    assert not progress.completed
    assert progress.waypoints is not None
    assert len(progress.waypoints) == 3


def test_a_mission_in_pieces_goes_on_counting(boat: Boat) -> None:
    driver = _gcs(boat)
    boat.beat(AUTO, armed=True)
    now_ns = _download(boat, driver, 0, _items())
    boat.view.reached_seqs.add(1)
    boat.beat(4, armed=True)
    driver.update(now_ns + S)
    boat.beat(AUTO, armed=True)
    _download(boat, driver, now_ns + 2 * S, _items())
    assert driver.progress().reached == 1


PX4_AUTO, PX4_HOLD = 4 << 16 | 4 << 24, 4 << 16 | 3 << 24


class Px4Boat(Boat):
    """A PX4: its receiver acknowledges a mode before anybody has looked at it."""

    def beat(self, mode: int, armed: bool) -> None:
        base = dialect.MAV_MODE_FLAG_SAFETY_ARMED if armed else 0
        self.view.handle(dialect.MAVLink_heartbeat_message(10, dialect.MAV_AUTOPILOT_PX4, base, mode, 4, 3))


def test_the_mode_of_a_px4_is_what_its_heartbeat_says() -> None:
    boat = Px4Boat()
    boat.beat(PX4_HOLD, armed=True)
    assert not boat.orders.set_mode(0, "AUTO")
    assert [p for *p, _ in boat.commands()] == [[SET_MODE, 1.0]]
    boat.accept(SET_MODE)  # the receiver
    assert not boat.orders.set_mode(TICK, "AUTO")
    boat.accept(SET_MODE, dialect.MAV_RESULT_TEMPORARILY_REJECTED)  # the commander
    assert not boat.orders.set_mode(S, "AUTO")
    assert len(boat.commands()) == 1  # asked for again after a second
    boat.beat(PX4_AUTO, armed=True)
    assert boat.orders.set_mode(S + TICK, "AUTO")
    assert boat.commands() == []


def test_a_mode_that_a_px4_was_in_before_is_asked_for_all_the_same() -> None:
    boat = Px4Boat()
    boat.beat(PX4_HOLD, armed=True)
    assert not boat.orders.mode_is_set()
    assert not boat.orders.set_mode(0, "HOLD")
    assert len(boat.commands()) == 1
    assert boat.orders.set_mode(TICK, "HOLD")
    boat.orders.forget()
    assert not boat.orders.mode_is_set()


def test_a_px4_goes_to_a_place_by_reposition_which_it_gets_until_it_has_taken_it() -> None:
    boat = Px4Boat()
    boat.beat(PX4_HOLD, armed=True)
    steps = (ScriptStep(at_s=0.0, goto_ned_m=(30.0, -40.0)), ScriptStep(at_s=5.0, goto_ned_m=(1.0, 2.0)))
    driver = ScriptDriver(boat.orders, FRAME, steps, MissionItems())
    kind = dialect.MAVLink_command_int_message
    driver.update(0)
    (asked,) = boat.take(kind)
    lat, lon, _ = (float(value[0]) for value in FRAME.geodetic(np.array([[30.0, -40.0, 0.0]])))
    assert (asked.command, asked.frame, asked.param2) == (dialect.MAV_CMD_DO_REPOSITION, dialect.MAV_FRAME_GLOBAL, 1.0)
    assert (asked.x, asked.y) == (round(lat * 1e7), round(lon * 1e7))
    driver.update(S)
    assert len(boat.take(kind)) == 1  # nobody answered
    boat.accept(dialect.MAV_CMD_DO_REPOSITION)
    for second in (2, 3, 4):
        driver.update(second * S)
    assert boat.take(kind) == []  # each would make it begin anew
    driver.update(5 * S)
    assert len(boat.take(kind)) == 1


def test_what_is_not_well_is_said_where_no_text_gives_a_reason(boat: Boat, golden: Golden) -> None:
    driver = MissionDriver(boat.orders, MissionItems((1, 2)))
    position, estimator, radio = 0x4000, 0x200000, 0x10000
    enabled = position | estimator | radio
    boat.view.handle(dialect.MAVLink_sys_status_message(enabled, enabled, estimator, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0))
    with pytest.raises(UserError) as refused:
        driver.update(round((READY_TIMEOUT_S + 1) * S))
    golden("error", refused.value)
