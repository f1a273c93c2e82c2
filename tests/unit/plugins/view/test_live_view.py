"""The view of a run without its process: what is given to it, when, and that nothing it does reaches the run."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import xitl_cli.plugins.view.live_view as view_node
from agent.wire import dialect
from sim_core.world.debris import BodyKind, Launch
from tests.doubles.side_process import SideProcessDouble
from tests.golden import Golden
from xitl_cli.errors import UserError
from xitl_cli.plugins.view.live_view import LiveViewNode, VesselWatch, cloud_points
from xitl_cli.plugins.view.messages import ViewRefusal, ViewStart
from xitl_cli.plugins.view.model import ViewInstant
from xitl_cli.plugins.view.scene import read_bodies, read_scene_updates
from xitl_cli.profile import load_profile
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.recorder import Recorder
from xitl_cli.record.topics import BatteryMessage
from xitl_cli.run.core.node import ControlNode, RunContext, SimulationClock
from xitl_cli.run.core.pace import Lockstep
from xitl_cli.run.nodes.direct_control import direct_control
from xitl_cli.run.nodes.display import RunStatus
from xitl_cli.run.nodes.mission import MissionNode
from xitl_cli.run.world.plant import Plant
from xitl_cli.run.world.world import build_plant
from xitl_cli.scenery import Scenery
from xitl_cli.seeds import Seeds

STATUS = RunStatus(0.0, 60.0, "AUTO", True, 1, 6, 2.5, 90.0, -0.4, 0.2, 0.5, 4.0, (0.5, 0.4), lost=3, missed=2)


class Page(SideProcessDouble):
    """The view's end of the pipe; its clock is the node's."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        super().__init__(monkeypatch)
        self.now_s = 0.0
        self.said: list[str] = []

    def say(self, **message: object) -> None:
        self.pipe.send(message)

    def received(self) -> list[Any]:
        return self.pipe.receive()


Parts = tuple[LiveViewNode, VesselWatch, Plant, Recorder]


@pytest.fixture(scope="module")
def profile() -> RunProfile:
    return load_profile("mitl", ["view.open=false", "view.rate_hz=10"]).runnable()


@pytest.fixture
def page(monkeypatch: pytest.MonkeyPatch) -> Iterator[Page]:
    made = Page(monkeypatch)
    yield made
    made.close()


OPERATED = pytest.mark.parametrize("pace", [view_node.OperatedLockstep(lambda: False)], ids=["operated"])
"""A run whose pace an operator sets."""


@pytest.fixture
def pace() -> Lockstep:
    return Lockstep()


@pytest.fixture
def control(profile: RunProfile) -> ControlNode:
    return direct_control(profile)


@pytest.fixture
def parts(profile: RunProfile, page: Page, tmp_path: Path, pace: Lockstep, control: ControlNode) -> Iterator[Parts]:
    plant = build_plant([profile], Seeds(1), Scenery(profile))
    with ExitStack() as opened:
        watch = VesselWatch(profile, plant.vessels[0], control, MissionNode(profile, control), lambda: STATUS)
        node = LiveViewNode([profile], plant, [watch], lambda: b"", page.said.append, lambda: False, lambda: page.now_s)
        opened.callback(node.close)
        recorder = Recorder(tmp_path / "run.mcap", "none")
        opened.callback(recorder.close)
        node.prepare()
        for part in (watch, node):
            part.begin(RunContext(recorder, pace, SimulationClock(pace)))
        yield node, watch, plant, recorder


@pytest.mark.medium
def test_it_says_where_it_is_and_gives_the_scene_at_once(parts: Parts, page: Page) -> None:
    assert page.said[-1].startswith("view: http://127.0.0.1:")
    (start,) = page.received()
    assert isinstance(start, ViewStart)
    assert start.title == "mitl"


@pytest.mark.medium
def test_an_instant_is_given_when_it_is_asked_for_and_due(parts: Parts, page: Page) -> None:
    node, _, plant, _ = parts
    page.received()

    def after(seconds: float) -> list[Any]:
        page.now_s += seconds
        node.poll()
        return page.received()

    assert after(1.0) == []
    page.say(browsers=1, joined=1)
    page.say(ask=True)
    (instant,) = after(0.2)
    assert isinstance(instant, ViewInstant)
    assert instant.time_s == plant.state.time_ns * 1e-9
    assert instant.vessels[""].numbers["links lost"] == 3
    assert instant.vessels[""].numbers["cross-track m"] == -0.4
    assert after(0.2) == []  # it has not asked again: skipped
    page.say(ask=True)
    assert after(0.01) == []  # asked, and not due: neither
    assert len(after(0.2)) == 1
    page.say(browsers=0, joined=1)
    assert after(0.2) == after(0.2) == []
    view = node.report()["view"]
    assert (view["shown"], view["skipped"], view["browsers"]) == (2, 1, 1)


@pytest.mark.medium
def test_a_view_that_is_gone_is_told_once(parts: Parts, page: Page) -> None:
    node, *_ = parts
    page.close()
    for _ in range(3):
        page.now_s += 1.0
        node.poll()
    assert [text for text in page.said if text.startswith("warning")] == [
        "warning: the 3D view has ended; the run continues without it"
    ]
    assert node.report()["warnings"] == ["the 3D view has ended; the run continues without it"]


@pytest.mark.medium
def test_what_nobody_reads_is_bounded(parts: Parts, page: Page, monkeypatch: pytest.MonkeyPatch) -> None:
    node, *_ = parts
    monkeypatch.setattr(view_node, "MOST_WAITING_BYTES", 0)
    page.say(browsers=1, joined=1)
    for _ in range(2000):
        page.say(ask=True)
        page.now_s += 1.0
        node.poll()
        if node.report()["view"]["skipped"]:
            break
    assert node.report()["view"]["skipped"] == 1


@pytest.mark.medium
def test_without_an_operator_an_action_is_refused(parts: Parts, page: Page) -> None:
    node, *_ = parts
    page.received()
    page.say(action={"action": "pause"})
    page.now_s += 1.0
    node.poll()
    assert page.received() == [ViewRefusal("this run accepts no actions")]
    view = node.report()["view"]
    assert (view["actions"], view["refused"]) == (1, 1)


class StubOperator:
    """Takes down what it is asked."""

    def __init__(self) -> None:
        self.faults: dict[str, tuple[str, ...]] = {}
        self.asked: list[dict[str, Any]] = []
        self.paused_by: str | None = None
        self.waiting_launches: tuple[Launch, ...] = ()
        self.poll: Callable[[], object] | None = None

    @property
    def paused(self) -> bool:
        return self.paused_by is not None

    def listen(self, poll: Callable[[], object]) -> None:
        self.poll = poll

    def ask(self, action: dict[str, Any], source: str) -> str | None:
        self.asked.append(action)
        return None


@pytest.mark.medium
@OPERATED
def test_it_keeps_real_time_while_somebody_looks_and_lets_go_later(parts: Parts, page: Page) -> None:
    node, *_ = parts
    operator = StubOperator()
    node.attach_operator(operator)  # type: ignore[arg-type]
    assert operator.poll == node.poll

    def after(seconds: float) -> list[dict[str, Any]]:
        page.now_s += seconds
        node.poll()
        asked, operator.asked = operator.asked, []
        return asked

    page.say(browsers=1, joined=1)
    assert after(0.2) == [{"action": "pace", "factor": 1.0}]
    page.say(browsers=0, joined=1)
    assert after(0.2) == []
    page.say(browsers=1, joined=2)
    assert after(1.0) == []  # the page was loaded anew
    page.say(browsers=0, joined=2)
    after(0.2)
    assert after(view_node.ALONE_S) == [{"action": "pace", "factor": None}]


@pytest.mark.medium
@OPERATED
def test_a_pause_stays_when_the_last_browser_closes_and_the_terminal_says_so(
    parts: Parts, page: Page, golden: Golden
) -> None:
    node, *_ = parts
    operator = StubOperator()
    node.attach_operator(operator)  # type: ignore[arg-type]
    operator.paused_by = "view"

    def after(seconds: float) -> None:
        page.now_s += seconds
        node.poll()

    page.say(browsers=1, joined=1)
    after(0.2)
    page.say(browsers=0, joined=1)
    after(0.2)
    address = page.said[-1].removeprefix("view: ")
    after(view_node.ALONE_S)
    assert {"action": "resume"} not in operator.asked
    assert operator.asked[-1] == {"action": "pace", "factor": None}
    golden("message", page.said[-1], address=address)
    told = len(page.said)
    after(view_node.ALONE_S)
    assert len(page.said) == told


@pytest.mark.medium
@OPERATED
@pytest.mark.parametrize(("paused_by", "resumed"), [("view", True), ("foxglove", False)])
def test_a_view_that_is_gone_ends_its_own_pause_alone(parts: Parts, page: Page, paused_by: str, resumed: bool) -> None:
    node, *_ = parts
    operator = StubOperator()
    node.attach_operator(operator)  # type: ignore[arg-type]
    operator.paused_by = paused_by
    page.close()
    for _ in range(3):
        page.now_s += 1.0
        node.poll()
    assert ({"action": "resume"} in operator.asked) == resumed
    assert node.report()["warnings"][0].endswith("; its pause has ended") == resumed


@pytest.mark.medium
def test_debris_that_waits_for_the_next_exchange_is_drawn_where_it_will_be(parts: Parts, page: Page) -> None:
    node, _, plant, _ = parts
    operator = StubOperator()
    node.attach_operator(operator)  # type: ignore[arg-type]
    page.received()
    page.say(browsers=1, joined=1)

    def shown() -> list[Any]:
        page.say(ask=True)
        page.now_s += 1.0
        node.poll()
        return page.received()

    (instant,) = shown()
    assert not instant.bodies
    launch = Launch(0, BodyKind.TRUNK, 12.0, 34.0, 0.5, 4.0)
    operator.waiting_launches = (launch,)
    update, instant = shown()
    assert list(read_bodies(read_scene_updates(update.update))) == [0]
    assert instant.bodies[0].position_enu_m[:2] == pytest.approx([34.0, 12.0])
    assert not plant.state.debris.bodies
    operator.waiting_launches = ()
    plant.launch(launch)
    (launched,) = shown()
    assert launched.bodies[0].position_enu_m == pytest.approx(instant.bodies[0].position_enu_m)
    assert launched.bodies[0].attitude_wxyz == pytest.approx(instant.bodies[0].attitude_wxyz)


@pytest.mark.medium
def test_a_guided_target_takes_the_place_of_the_waypoint(parts: Parts, control: ControlNode) -> None:
    _, watch, *_ = parts
    control.progress = replace(control.progress, target=1)
    assert watch.instant(0, 0).target_enu_m is not None
    control.progress = replace(control.progress, guided_ne_m=(5.0, 20.0))
    guided = watch.instant(0, 0)
    assert guided.guided_enu_m is not None
    assert guided.guided_enu_m == pytest.approx([20.0, 5.0, 0.0])
    assert guided.target_enu_m is None


@pytest.mark.medium
@pytest.mark.parametrize("pace", [view_node.OperatedLockstep(lambda: False, 4.0)])
def test_a_pace_that_was_given_is_kept(parts: Parts, page: Page) -> None:
    node, *_ = parts
    operator = StubOperator()
    node.attach_operator(operator)  # type: ignore[arg-type]
    page.say(browsers=1, joined=1)
    page.now_s += 1.0
    node.poll()
    assert operator.asked == []


@pytest.mark.medium
def test_clouds_are_where_the_vessel_was(parts: Parts) -> None:
    _, watch, plant, recorder = parts
    points = np.array([[2.0, 1.0, -0.5], [3.0, 0.0, 0.0]], dtype=np.float32)
    clouds: list[Any] = []
    recorder.watch("/lidar/points", lambda stamp_ns, cloud: clouds.append(cloud))
    recorder.perception.lidar_points(0, points, np.zeros(2, np.float32), np.zeros(2, np.uint8))
    assert cloud_points(clouds[0]) == pytest.approx(points * [1.0, -1.0, -1.0])
    motion = plant.vessels[0].motion()
    placed = motion.pos_ned_m[0] + points @ motion.rot_ned_frd[0].T
    drawn = watch.instant(0, 0).clouds["lidar"]
    assert drawn == pytest.approx(placed[:, [1, 0, 2]] * [1.0, 1.0, -1.0], abs=1e-4)
    assert watch.instant(0, 0).clouds["lidar"] is drawn


@pytest.mark.medium
def test_words_and_misses_are_passed_on(parts: Parts) -> None:
    _, watch, _, recorder = parts
    recorder.log(2_500_000_000, 4, "autopilot", "Failsafe")
    (event,) = watch.events()
    assert (event.time_s, event.severity, event.text) == (2.5, 4, "autopilot: Failsafe")
    assert watch.events() == []
    assert watch.instant(0, 5).numbers["deadline misses"] == 7


@pytest.mark.medium
def test_the_instruments_have_speeds_and_battery(parts: Parts) -> None:
    _, watch, plant, recorder = parts
    numbers = watch.instant(0, 0).numbers
    motion, current = plant.vessels[0].motion(), plant.vessels[0].state.current_ned_mps
    through_mps = float(np.linalg.norm((motion.vel_ned_mps - current)[0, :2]))
    assert numbers["speed through water m/s"] == pytest.approx(through_mps)
    assert math.isnan(numbers["desired heading °"])
    assert "battery V" not in numbers
    recorder.write(0, BatteryMessage(24.5, 3.0, 0.25))
    numbers = watch.instant(0, 0).numbers
    assert (numbers["battery V"], numbers["battery used Ah"]) == (24.5, 0.25)


@pytest.mark.medium
def test_obstacles_have_the_class_that_the_cameras_saw(parts: Parts) -> None:
    _, watch, _, recorder = parts
    for number, label, share in ((1, b"", 0.0), (2, b"buoy", 0.75)):
        numbers = (0.0, 8.0, 0.0, number, 9, 5, 0.1, share, label)  # from the heading on
        place, still, size = [5.0 * number, 2.0, 0.0], [0.0, 0.0, 0.0], [1.0, 3.0, 1.0]
        message = dialect.MAVLink_xitl_obstacle_message(0, place, still, size, *numbers)
        recorder.perception.obstacle(0, message)
    instant = watch.instant(0, 0)
    assert instant.obstacle_classes == ("", "buoy 75 %")
    assert instant.obstacles_enu_m.tolist() == [[2.0, 5.0, 0.0], [2.0, 10.0, 0.0]]


@pytest.mark.medium
def test_the_map_of_the_profile_is_on_the_page(page: Page, tmp_path: Path) -> None:
    path, site = tmp_path / "map.geojson", load_profile("mitl").runnable().site
    path.write_text(json.dumps({"type": "Point", "coordinates": [site.longitude_deg, site.latitude_deg]}))
    profile = load_profile("mitl", [f"view.map={path}"]).runnable()
    plant = build_plant([profile], Seeds(1), Scenery(profile))
    node = LiveViewNode([profile], plant, [], lambda: b"", page.said.append, lambda: False, lambda: page.now_s)
    path.rename(tmp_path / "later.geojson")
    with pytest.raises(UserError, match=r"view.map = .*map.geojson: cannot be read"):
        node.prepare()
    (tmp_path / "later.geojson").rename(path)
    with ExitStack() as opened:
        opened.callback(node.close)
        recorder = Recorder(tmp_path / "run.mcap", "none")
        opened.callback(recorder.close)
        node.prepare()
        node.begin(RunContext(recorder, Lockstep(), SimulationClock(Lockstep())))
        (start,) = page.received()
    assert start.chart.shapes[0].rings_en_m[0] == pytest.approx(np.zeros((1, 2)), abs=1e-3)


def test_no_view_is_made_unless_it_is_asked_for() -> None:
    assert not load_profile("mitl").runnable().view.show
    assert load_profile("mitl", ["view.rate_hz=5"]).runnable().view.show
    assert not load_profile("mitl", ["view.show=false"]).runnable().view.show
