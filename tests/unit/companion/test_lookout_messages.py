"""What the lookout tells of an obstacle, and how it takes the helm and gives it back, with exact figures."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from agent.companion.autopilot_state import MissionCopy, MissionCopyItem, MissionPosition, PathAhead
from agent.companion.avoidance import AROUND, FREE, STAY, AvoidanceChoice, AvoidancePlanner, CollisionCheck, Obstacles
from agent.companion.clouds import PointCloud, cloud_messages
from agent.companion.command_output import DETOUR, NONE, RETURN, STOP, CommandOutput
from agent.companion.detection import Cluster
from agent.companion.obstacle_avoidance import ObstacleAvoidance, make_proximity_messages
from agent.companion.perception import MOST_WAITING, Perception
from agent.companion.pose_history import VehiclePose
from agent.companion.rigid_motion import quaternion_from_euler, rotation_matrix
from agent.companion.settings import TUNED, CompanionParameters
from agent.mavlink.modes import AUTO, GUIDED, HOLD
from agent.wire import dialect as mav

MS = 1_000_000
STILL = np.zeros(2)
BOW_M = 1.15
NO_PLACE, NO_SIZE = np.empty((0, 2)), np.empty(0)
NOTHING = Obstacles(NO_PLACE, NO_PLACE, NO_SIZE, NO_SIZE, NO_SIZE, NO_PLACE)
AT_ONCE = np.ones(1)
IN_THE_WAY = Obstacles(np.array([[15.0, 0.5]]), np.zeros((1, 2)), AT_ONCE, AT_ONCE, 0.0 * AT_ONCE, NO_PLACE)


def pose(
    north_m: float, east_m: float, heading_deg: float, vel_ne_mps: tuple[float, float] = (0.0, 0.0)
) -> VehiclePose:
    turn = rotation_matrix(quaternion_from_euler(0.0, 0.0, math.radians(heading_deg)))
    return VehiclePose(np.array((north_m, east_m, 0.4)), turn, np.array((*vel_ne_mps, 0.0)))


def test_proximity_is_the_nearest_point_of_each_sector_of_five_degrees() -> None:
    """The vessel heads east from (10, 20). Sectors are clockwise from the bow; 65535 is unknown, 6001 is free."""
    ahead, right, left, behind = (0.0, 1.0), (-1.0, 0.0), (1.0, 0.0), (0.0, -1.0)

    def at(distance_m: float, direction: tuple[float, float]) -> list[float]:
        return [10.0 + distance_m * direction[0], 20.0 + distance_m * direction[1]]

    turned = math.radians(90.0 + 29.0)  # 29 degrees to starboard is sector 6, the last one in view
    points = [at(12.0, ahead), at(10.0, ahead), at(5.0, right), at(0.3, left), at(60.0, behind)]
    points.append(at(8.0, (math.cos(turned), math.sin(turned))))
    points.append(at(60.1, (math.cos(math.radians(135.0)), math.sin(math.radians(135.0)))))
    around, forward = make_proximity_messages(np.array(points), pose(10.0, 20.0, 90.0), 7_654_321_000, BOW_M, 60.0)
    expected = {sector: 6001 if min(sector, 72 - sector) <= 6 else 65535 for sector in range(72)}
    expected.update({0: 1000, 18: 500, 54: 50, 36: 6000, 6: 800})
    assert list(around.distances) == list(expected.values())
    assert (around.time_usec, around.min_distance, around.max_distance) == (7_654_321, 50, 6000)
    assert (around.increment, around.increment_f, around.angle_offset, around.frame) == (5, 5.0, 0.0, 12)
    # The nearest in view is 8 m from the origin.
    assert (forward.time_boot_ms, forward.current_distance) == (7654, 800 - 115)
    assert (forward.min_distance, forward.max_distance) == (1, 6000)
    assert forward.horizontal_fov == pytest.approx(math.radians(65.0))


@pytest.mark.parametrize(
    ("distance_m", "forward_cm"), [(None, 6001), (1.0, 1), (61.0, 6001), (60.0, 6000 - 115), (30.004, 2885)]
)
def test_the_distance_ahead_is_that_from_the_bow(distance_m: float | None, forward_cm: int) -> None:
    points = np.empty((0, 2)) if distance_m is None else np.array([[distance_m, 0.0], [-2.0, 0.0]])
    _, forward = make_proximity_messages(points, pose(0.0, 0.0, 0.0), 0, BOW_M, 60.0)
    assert forward.current_distance == forward_cm


def watching(heading_deg: float, vel_ne_mps: tuple[float, float]) -> ObstacleAvoidance:
    """A lookout at (10, 20) that has seen a thing at rest, 4 m by 2 m and 1 m high, for six seconds."""
    watch = ObstacleAvoidance()
    for tick in range(31):
        stamp_ns = tick * 200 * MS
        watch.vehicle.history.add_attitude(
            stamp_ns, quaternion_from_euler(0.0, 0.0, math.radians(heading_deg)), np.zeros(3)
        )
        watch.vehicle.history.add_position(stamp_ns, np.array((10.0, 20.0, 0.4)), np.array((*vel_ne_mps, 0.0)))
        cluster = Cluster(stamp_ns, np.array([[30.0, 30.0]]), np.array((30.0, 30.0)), 4.0, 2.0, 1.0, 0.0, 9, 9)
        watch.tracker.update(stamp_ns, [cluster], np.array((10.0, 20.0)), 0.4, 1.0, STILL)
    return watch


def test_an_obstacle_is_told_with_its_range_from_the_bow_and_its_bearing() -> None:
    heading_deg, vel_ne_mps, now_ns = 20.0, (2.0, 0.5), 6000 * MS
    watch = watching(heading_deg, vel_ne_mps)
    (told,) = watch.obstacle_messages(now_ns)
    heading_rad = math.radians(heading_deg)
    bow = (10.0 + BOW_M * math.cos(heading_rad), 20.0 + BOW_M * math.sin(heading_rad))
    corner = (30.0 - 2.0 - bow[0], 30.0 - 1.0 - bow[1])  # the nearest one of the box
    range_m = math.hypot(*corner)
    assert told.range == pytest.approx(range_m, abs=1e-6)
    closing_mps = (corner[0] * vel_ne_mps[0] + corner[1] * vel_ne_mps[1]) / range_m
    assert told.closing_speed == pytest.approx(closing_mps, abs=1e-6)
    assert told.bearing == pytest.approx(math.atan2(10.0, 20.0) - heading_rad)
    assert list(told.pos_ned) == pytest.approx([30.0, 30.0, 0.4 + 0.15 - 0.5])
    assert list(told.vel_ned) == pytest.approx([0.0, 0.0, 0.0], abs=1e-9)
    assert list(told.size) == pytest.approx([4.0, 2.0, 1.0])
    assert (told.time_usec, told.id, told.points, told.hits) == (6_000_000, 1, 9, 31)
    assert watch.obstacle_messages(9_000 * MS) == [], "the pose is unknown by then"


def test_nothing_is_commanded_without_clouds() -> None:
    """It is blind: no targets, and no proximity. What the autopilot is asked for is not affected."""
    watch = watching(0.0, (0.0, 0.0))
    assert watch.proximity_messages(6000 * MS) == []
    assert watch.plan(6000 * MS) == []


class Helm:
    """The command output with an autopilot under way to the north, every 0.2 s."""

    def __init__(self) -> None:
        self.output = CommandOutput(AvoidancePlanner(3.0, 1.8, 12.0, 1.4), 1.8, 3.0)
        self.way: Any = PathAhead(((0.0, 0.0), (200.0, 0.0)), 3.0)
        self.vehicle: Any = SimpleNamespace(
            target=(1, 1), armed=True, mode=AUTO, path_ahead=lambda: self.way, set_mode=self._set_mode
        )
        self.pose: VehiclePose | None = pose(0.0, 0.0, 0.0, (3.0, 0.0))
        self.now_ns = 0

    def _set_mode(self, mode: int) -> None:
        self.vehicle.mode = mode

    def update(self, around: Obstacles, after_ms: int = 200) -> list[Any]:
        self.now_ns += after_ms * MS
        return self.output.update(self.vehicle, self.pose, around, STILL, self.now_ns)

    def acknowledge(self, result: int = 0, command: int = mav.MAV_CMD_DO_SET_MODE) -> None:
        self.output.handle_acknowledgement(mav.MAVLink_command_ack_message(command, result), self.vehicle)

    def take(self) -> None:
        """Get to GUIDED."""
        while not self.update(IN_THE_WAY):
            pass
        self.acknowledge()
        assert self.vehicle.mode == GUIDED


def asks_for(messages: list[Any], mode: int) -> bool:
    (message,) = messages
    assert (message.target_system, message.target_component) == (1, 1)
    assert (message.command, message.param1) == (mav.MAV_CMD_DO_SET_MODE, 1.0)
    return bool(message.param2 == mode)


def test_a_blocked_path_is_seen_twice_before_the_helm_is_taken() -> None:
    helm = Helm()
    assert [len(helm.update(IN_THE_WAY)) for _ in range(2)] == [0, 1]
    again = Helm()
    again.update(IN_THE_WAY)
    again.update(NOTHING)
    assert again.update(IN_THE_WAY) == [], "the two looks are in a row"
    assert asks_for(again.update(IN_THE_WAY), GUIDED)


def test_a_mode_is_asked_for_six_times_every_half_second_and_then_given_up() -> None:
    helm = Helm()
    helm.update(IN_THE_WAY)
    assert asks_for(helm.update(IN_THE_WAY), GUIDED)
    assert helm.update(IN_THE_WAY, 499) == []
    asked = 1
    assert asks_for(helm.update(IN_THE_WAY, 1), GUIDED)
    asked += 1
    while helm.output.refused == 0:
        asked += len(helm.update(IN_THE_WAY, 500))
    assert (asked, helm.output.refused) == (6, 1)
    assert helm.update(IN_THE_WAY) == []
    assert asks_for(helm.update(IN_THE_WAY), GUIDED), "it begins anew"


def test_a_refused_mode_releases_the_helm() -> None:
    helm = Helm()
    helm.update(IN_THE_WAY)
    helm.update(IN_THE_WAY)
    helm.acknowledge(command=mav.MAV_CMD_COMPONENT_ARM_DISARM)
    assert helm.output.refused == 0
    helm.acknowledge(mav.MAV_RESULT_FAILED)
    assert (helm.output.refused, helm.vehicle.mode) == (1, AUTO)
    helm.acknowledge(mav.MAV_RESULT_FAILED)
    assert helm.output.refused == 1, "nothing was asked for"
    assert helm.update(IN_THE_WAY) == []
    assert asks_for(helm.update(IN_THE_WAY), GUIDED)


def test_a_detour_is_counted_once_and_ends_in_auto() -> None:
    helm = Helm()
    helm.take()
    assert helm.output.manoeuvre == NONE
    for _ in range(3):
        (target,) = helm.update(IN_THE_WAY)
        assert helm.output.manoeuvre == DETOUR
        assert target.type_mask == 0x9C7
        assert math.hypot(target.vx, target.vy) > 0.5
        assert abs(math.atan2(target.vy, target.vx)) > math.radians(5.0)
    # The path is free: some looks on the way back, then the mission gets the helm
    messages = [helm.update(NOTHING) for _ in range(TUNED.free_plans)]
    for (target,) in messages[:-1]:
        assert (target.vx, target.vy, target.yaw) == pytest.approx((3.0, 0.0, 0.0), abs=1e-9)
        assert target.coordinate_frame == mav.MAV_FRAME_LOCAL_NED
    assert helm.output.manoeuvre == RETURN
    assert asks_for(messages[-1], AUTO)
    helm.acknowledge()
    assert helm.vehicle.mode == AUTO
    assert helm.update(NOTHING) == []
    assert (helm.output.manoeuvre, helm.output.detours, helm.output.stops) == (NONE, 1, 0)
    helm.take()
    helm.update(IN_THE_WAY)
    assert helm.output.detours == 2


@pytest.mark.parametrize(
    ("off_m", "heading_deg", "back"), [(1.1, 0.0, True), (1.3, 0.0, False), (0.0, 19.0, True), (0.0, 21.0, False)]
)
def test_the_mission_goes_on_when_the_vessel_is_on_its_leg_and_along_it(
    off_m: float, heading_deg: float, back: bool
) -> None:
    helm = Helm()
    helm.take()
    heading_rad = math.radians(heading_deg)
    helm.pose = pose(50.0, off_m, heading_deg, (3.0 * math.cos(heading_rad), 3.0 * math.sin(heading_rad)))
    for _ in range(TUNED.free_plans - 1):
        helm.update(NOTHING)
    (message,) = helm.update(NOTHING)
    assert isinstance(message, mav.MAVLink_command_long_message) is back


def test_near_the_end_of_a_leg_the_mission_goes_on_at_once() -> None:
    for north_m, back in ((194.1, True), (193.9, False)):
        helm = Helm()
        helm.take()
        helm.pose = pose(north_m, 2.0, 0.0, (3.0, 0.0))
        for _ in range(TUNED.free_plans - 1):
            helm.update(NOTHING)
        (message,) = helm.update(NOTHING)
        assert isinstance(message, mav.MAVLink_command_long_message) is back, north_m


@pytest.mark.parametrize("change", ["disarmed", "other mode", "no pose", "no path", "auto"])
def test_the_helm_is_not_held_against_the_operator(change: str) -> None:
    helm = Helm()
    helm.take()
    helm.update(IN_THE_WAY)
    if change == "disarmed":
        helm.vehicle.armed = False
    elif change == "other mode":
        helm.vehicle.mode = HOLD
    elif change == "no pose":
        helm.pose = None
    elif change == "no path":
        helm.way = None
    else:
        helm.vehicle.mode = AUTO
    assert helm.update(IN_THE_WAY) == []
    kept = change in ("no pose", "no path")
    assert helm.output.manoeuvre == (DETOUR if kept else NONE)
    if change == "other mode":
        helm.vehicle.mode = GUIDED
        assert helm.update(IN_THE_WAY) == [], "somebody else's GUIDED"


def test_a_stop_holds_its_place_and_is_counted_once() -> None:
    across = np.column_stack([np.full(200, 6.0), np.linspace(-50.0, 50.0, 200)])
    wall = IN_THE_WAY._replace(points_ne_m=across)
    helm = Helm()
    helm.pose = pose(0.0, 0.0, 0.0, (0.3, 0.0))
    while not helm.update(wall):
        pass
    helm.acknowledge()
    first, second = helm.update(wall)[0], helm.update(wall)[0]
    assert (helm.output.manoeuvre, helm.output.stops, helm.output.detours) == (STOP, 1, 0)
    assert first.type_mask == second.type_mask == 0xDF8
    assert (first.x, first.y) == (second.x, second.y)
    assert (first.vx, first.vy, first.yaw) == (0.0, 0.0, 0.0)
    helm.pose = pose(0.9 * TUNED.moved_m, 0.0, 0.0, (0.3, 0.0))
    (third,) = helm.update(wall)
    assert (third.x, third.y) == (first.x, first.y), "it comes to rest a little farther"
    helm.pose = pose(1.1 * TUNED.moved_m, 0.0, 0.0, (0.3, 0.0))
    (fourth,) = helm.update(wall)
    assert (fourth.x, fourth.y) == pytest.approx((first.x + 1.1 * TUNED.moved_m, first.y))
    assert helm.output.stops == 1


def item(command: int, lat_e7: int = 0, lon_e7: int = 0, speed_mps: float = 0.0) -> MissionCopyItem:
    return MissionCopyItem(command, lat_e7, lon_e7, speed_mps)


def test_the_places_of_a_mission_end_at_a_jump_or_a_stay() -> None:
    copy = MissionCopy()
    assert copy.positions_from(1) == []
    assert copy.position_before(3) is None
    assert copy.speed_mps(3) is None
    copy.items = [
        item(16, 100, 200),
        item(16, 1, 2),
        item(178, speed_mps=2.5),
        item(82, 0, 4),
        item(16),  # without a place
        item(178, speed_mps=math.nan),
        item(31, 5, 0),
        item(20),
        item(16, 7, 8),
    ]
    places = [
        MissionPosition(1, 1, 2),
        MissionPosition(3, 0, 4),
        MissionPosition(6, 5, 0),
        MissionPosition(7, 100, 200),
    ]
    assert copy.positions_from(0) == copy.positions_from(1) == places
    assert copy.positions_from(4) == places[2:]
    assert copy.positions_from(8) == [MissionPosition(8, 7, 8)]
    assert copy.positions_from(9) == []
    assert [copy.position_before(seq) for seq in (0, 1, 2, 3, 4, 6, 99)] == [
        *(None, None, places[0], places[0], places[1], places[1]),
        MissionPosition(8, 7, 8),
    ]
    assert [copy.speed_mps(seq) for seq in (1, 2, 6)] == [None, 2.5, 2.5]
    copy.items[2] = item(178, speed_mps=30.0)
    assert copy.speed_mps(6) is None
    copy.items[1] = item(17, 1, 2)
    assert copy.positions_from(1) == [MissionPosition(1, 1, 2)]
    copy.items[1] = item(177)
    assert copy.positions_from(1) == []


def test_a_mission_is_copied_again_when_its_length_changes_and_after_a_pause() -> None:
    copy = MissionCopy()
    assert copy.poll((1, 1), 0)[0].get_type() == "MISSION_REQUEST_LIST"
    tries, now_ns = 1, 0
    while tries < 8:
        now_ns += 100 * MS
        tries += len(copy.poll((1, 1), now_ns))
    last_ns = now_ns
    asked = [copy.poll((1, 1), last_ns + after_ns) for after_ns in (1_000 * MS, 9_999 * MS, 10_000 * MS)]
    assert [len(messages) for messages in asked] == [0, 0, 1]
    copy.items, copy._wanted = [item(16)] * 3, False
    for total in (0, 65535, 2, 3):
        copy.note_total(total)
        assert copy.poll((1, 1), 10**12) == []
    copy.note_total(4)
    assert len(copy.poll((1, 1), 10**12)) == 1


class Lookout:
    """Perception without odometry."""

    def __init__(self, lockstep: bool = True) -> None:
        parameters = CompanionParameters()
        parameters._set("ODO_ENABLE", 0.0)
        self.said: list[str] = []
        self.watch = ObstacleAvoidance()
        self.perception = Perception(parameters, self.watch, lockstep, self.said.append)

    def cloud(self, number: int, stamp_ns: int, kind: int = mav.XITL_CLOUD_KIND_LIDAR) -> None:
        points = np.array([[10.0, 0.0, 0.1]], dtype=np.float32)
        cloud = PointCloud(kind, number, stamp_ns, points, np.zeros(1, dtype=np.float32), np.zeros(1, dtype=np.uint8))
        for message in cloud_messages(cloud, (0.0, 0.0, 0.0)):
            assert self.perception.handle(message, stamp_ns + 30 * MS)

    def status(self, now_ns: int = 0) -> Any:
        return self.perception.status(now_ns)


def test_clouds_that_are_not_processed_in_time_are_dropped_and_counted() -> None:
    lookout = Lookout()
    for number in range(MOST_WAITING + 3):
        lookout.cloud(number, number * 100 * MS)
    lookout.cloud(0, 0, mav.XITL_CLOUD_KIND_LIDAR_MAP)
    assert lookout.perception.process(lambda: 600 * MS) == []
    status = lookout.status(1_234_567_000)
    assert (status.clouds_dropped, lookout.perception.clouds, status.time_usec) == (3, MOST_WAITING + 4, 1_234_567)
    # The last cloud ended at 0.5 s.
    assert status.latency == pytest.approx(0.1)
    assert (status.poses, status.poses_refused, status.map_points) == (0, 0, 0)


def test_a_detection_of_a_camera_is_counted_and_other_messages_are_not_taken() -> None:
    lookout = Lookout()
    detection = mav.MAVLink_xitl_detection_message(0, (0.0, 0.0, 0.0), 0.1, 0.1, 0.1, 0.2, 0.9, b"person")
    assert lookout.perception.handle(detection, 0)
    assert lookout.status().detections == 1
    beat = mav.MAVLink_heartbeat_message(11, 3, 0, 0, 4, 3)
    assert not lookout.perception.handle(beat, 0)
    assert lookout.said == []


def test_guided_of_somebody_else_is_left_alone_from_the_start() -> None:
    helm = Helm()
    helm.vehicle.mode = GUIDED
    assert [helm.update(IN_THE_WAY) for _ in range(3)] == [[], [], []]


class Decided:
    """Stands in for the planner. asked: whether the vessel stayed, and the course held, at each choice."""

    def __init__(self) -> None:
        self.check = CollisionCheck(0.5, True, 3.0)
        self.choice = AvoidanceChoice(AROUND, 0.7, 2.0, 4.0)
        self.place = np.array((5.0, 6.0))
        self.asked: list[tuple[bool, float | None]] = []
        self.speeds: set[float] = set()

    def check_collision(self, legs: Any, pos: Any, vel: Any, bow: float, speed_mps: float, around: Any) -> Any:
        self.speeds.add(speed_mps)
        return self.check

    def choose_course(
        self, legs: Any, pos: Any, vel: Any, bow: float, speed_mps: float, around: Any, last_rad: float | None,
        stays: bool, current: Any,
    ) -> Any:  # fmt: skip
        self.speeds.add(speed_mps)
        self.asked.append((stays, last_rad))
        return self.choice

    def waiting_position(self, pos: Any, vel: Any, around: Any, current: Any) -> Any:
        return self.place


def decided() -> tuple[Helm, Decided]:
    helm, planner = Helm(), Decided()
    helm.output = CommandOutput(planner, 1.8, 3.0)  # type: ignore[arg-type]
    return helm, planner


@pytest.mark.parametrize(("after_s", "looks"), [(7.9, 2), (8.0, 8)])
def test_a_late_collision_is_seen_more_often_before_the_helm_is_taken(after_s: float, looks: int) -> None:
    helm, planner = decided()
    planner.check = CollisionCheck(0.5, True, after_s)
    assert [len(helm.update(NOTHING)) for _ in range(looks)] == [0] * (looks - 1) + [1]


@pytest.mark.parametrize(("planned_mps", "speed_mps"), [(2.5, 2.5), (None, 3.0)])
def test_the_speed_is_that_of_the_mission_or_of_the_vessel(planned_mps: float | None, speed_mps: float) -> None:
    helm, planner = decided()
    helm.way = PathAhead(((0.0, 0.0), (200.0, 0.0)), planned_mps)
    helm.take()
    helm.update(NOTHING)
    assert planner.speeds == {speed_mps}


def test_the_planner_knows_the_course_held_and_whether_the_vessel_stays() -> None:
    helm, planner = decided()
    helm.take()
    choices = [
        AvoidanceChoice(AROUND, 0.7, 2.0, 4.0), *[AvoidanceChoice(STAY, 0.0, 0.0, 4.0)] * 2,
        AvoidanceChoice(FREE, 0.0, 3.0, 4.0), AvoidanceChoice(AROUND, -0.4, 1.0, 4.0),
    ]  # fmt: skip
    sent = []
    for planner.choice in choices:
        (message,) = helm.update(NOTHING)
        sent.append((helm.output.manoeuvre, message.vx, message.vy, message.x, message.y))
    assert planner.asked == [(False, None), (False, 0.7), (True, None), (True, None), (False, None)]
    expected = [
        (DETOUR, 2.0 * math.cos(0.7), 2.0 * math.sin(0.7), 0.0, 0.0), *[(STOP, 0.0, 0.0, 5.0, 6.0)] * 2,
        (RETURN, 3.0, 0.0, 0.0, 0.0), (DETOUR, math.cos(0.4), -math.sin(0.4), 0.0, 0.0),
    ]  # fmt: skip
    np.testing.assert_allclose(sent, expected, atol=1e-9)
    assert (helm.output.detours, helm.output.stops) == (1, 1)


@pytest.mark.parametrize(
    ("kind", "clearance_m", "ends"), [(FREE, 2.3, True), (FREE, 2.29, False), (AROUND, 9.0, False), (STAY, 9.0, False)]
)
def test_a_detour_ends_when_the_legs_are_chosen_and_clear(kind: int, clearance_m: float, ends: bool) -> None:
    """Half a metre more than the 1.8 m at which it begins, four plans in a row."""
    helm, planner = decided()
    helm.take()
    planner.check = CollisionCheck(clearance_m, False, 3.0)
    planner.choice = AvoidanceChoice(kind, 0.0, 3.0, clearance_m)
    sent = [helm.update(NOTHING)[0] for _ in range(4)]
    assert [isinstance(message, mav.MAVLink_command_long_message) for message in sent] == [False] * 3 + [ends]


def test_a_vessel_past_the_end_of_its_leg_is_on_a_leg_from_its_place() -> None:
    """It is 5 m past a corner, to which the autopilot turns back. So does the course of the return."""
    helm, planner = decided()
    helm.way = PathAhead(((0.0, 0.0), (100.0, 0.0), (100.0, 80.0)), 3.0)
    helm.take()
    planner.choice = AvoidanceChoice(FREE, 0.0, 3.0, 4.0)
    helm.pose = pose(105.0, 0.0, 0.0, (3.0, 0.0))
    (message,) = helm.update(NOTHING)
    assert (message.vx, message.vy) == pytest.approx((-3.0, 0.0), abs=1e-6)
    helm.pose = pose(99.0, 0.0, 0.0, (3.0, 0.0))
    (message,) = helm.update(NOTHING)
    assert (message.vx, message.vy) == pytest.approx((3.0, 0.0), abs=1e-6)
