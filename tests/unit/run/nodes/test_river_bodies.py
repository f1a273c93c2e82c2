"""Bodies in the water of a run: launches, what is recorded of them, collisions, and the tide."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from sim_core.world.debris import BodyKind, Launch
from xitl_cli.profile import load_profile
from xitl_cli.record.topics import TideState
from xitl_cli.run.nodes import river
from xitl_cli.run.nodes.river import OPEN_WATER, RiverNode, TideNode, _record_every

S = 1_000_000_000


class Recorder:
    def __init__(self) -> None:
        self.texts: list[tuple[int, str]] = []
        self.records: list[tuple[int, Any]] = []
        self.scenes: list[tuple[int, Any]] = []
        self.bodies: list[tuple[Any, ...]] = []
        self.perception = SimpleNamespace(bodies=lambda *given: self.bodies.append(given))

    def log(self, stamp_ns: int, severity: int, source: str, text: str) -> None:
        self.texts.append((stamp_ns, text))

    def write(self, stamp_ns: int, record: Any) -> None:
        self.records.append((stamp_ns, record))

    def scene(self, update: Any, stamp_ns: int) -> None:
        self.scenes.append((stamp_ns, update))


def launch(north_m: float = 15.0, east_m: float = 18.0, length_m: float = 4.0) -> Launch:
    return Launch(0, BodyKind.TRUNK, north_m, east_m, 0.0, length_m)


class Water:
    """A plant with a vessel at the origin, and debris."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, port: Any = None, drawn: bool = True) -> None:
        monkeypatch.setattr(river, "make_debris_scene", lambda bodies, first: (len(bodies), first))
        self.launched: list[Launch] = []
        self.waterways: list[Any] = []
        motion = SimpleNamespace(pos_ned_m=np.array([[1.0, 2.0, 0.0]]))
        outline = SimpleNamespace(reach_m=1.5)
        vessel = SimpleNamespace(motion=lambda: motion, simulation=SimpleNamespace(outline=outline))
        water = SimpleNamespace(density_kgpm3=1000.0)
        self.debris = SimpleNamespace(
            bodies=(), time_ns=0, yaw_rad=np.empty(0), yaw_rate_radps=np.empty(0), pos_ned_m=np.empty((0, 3)),
            vel_ned_mps=np.empty((0, 3)),
        )  # fmt: skip
        simulation = SimpleNamespace(
            dt_s=0.0025, waterway=OPEN_WATER, environment=SimpleNamespace(water=water), contact=False
        )
        plant = SimpleNamespace(
            simulation=simulation,
            vessels=(vessel,),
            state=SimpleNamespace(debris=self.debris),
            launch=self.launched.append,
            change_waterway=self.waterways.append,
        )
        self.due: list[Launch] = []
        self.asked: list[tuple[Any, ...]] = []
        encounters = SimpleNamespace(
            due=lambda *given: (self.asked.append(given), self.due)[1],
            afloat=lambda north_m, east_m: north_m >= 0.0,
            no_room=3,
        )
        self.progress = SimpleNamespace(target=None)
        self.node = RiverNode(cast(Any, plant), cast(Any, encounters), port, drawn, lambda: cast(Any, self.progress))
        self.recorder = Recorder()
        self.node.begin(cast(Any, SimpleNamespace(recorder=self.recorder)))

    def step(self, number: int, now_ns: int) -> Any:
        return SimpleNamespace(number=number, now_ns=now_ns)


def test_planned_bodies_are_launched_on_the_way_to_a_waypoint(monkeypatch: pytest.MonkeyPatch) -> None:
    water = Water(monkeypatch)
    water.due = [launch()]
    water.node.launching.exchange(water.step(1, S))
    assert (water.asked, water.launched) == ([], [])
    water.progress.target = 2
    water.node.launching.exchange(water.step(2, 2 * S))
    assert water.asked == [(2 * S, (1.0, 2.0), 2)]
    assert water.launched == [launch()]
    assert len(water.waterways) == 1  # open water has contact from now on


class Port:
    """A socket for launches. answers: whether each of `asked` was accepted."""

    address = "udp://127.0.0.1:7000"

    def __init__(self, *asked: Launch) -> None:
        self._asked = asked
        self.answers: list[bool] = []
        self.closed = False

    def serve(self, now_ns: int, accept: Any) -> None:
        self.answers = [accept(body) for body in self._asked]

    def report(self) -> str:
        return "counts"

    def close(self) -> None:
        self.closed = True


def test_requests_are_accepted_where_there_is_room(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(river, "MOST_BODIES", 3)
    port = Port(launch(), launch(north_m=-1.0), launch(north_m=16.0), launch(north_m=17.0))
    water = Water(monkeypatch, port)
    assert water.recorder.texts == [(0, "waits for launches at udp://127.0.0.1:7000")]
    water.debris.bodies = (1,)
    water.node.launching.exchange(water.step(1, S))
    assert port.answers == [True, False, True, False]
    assert [body.north_m for body in water.launched] == [15.0, 16.0]
    assert water.node.report()["debris"]["control"] == "counts"
    water.node.close()
    assert port.closed


def test_a_body_beyond_the_most_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    water = Water(monkeypatch)
    water.debris.bodies = (1,) * river.MOST_BODIES
    water.node.launch(launch())
    assert water.launched == []
    report = water.node.report()["debris"]
    assert (report["refused"], report["no_room"], report["control"], report["launched"]) == (1, 3, None, 0)
    assert water.node.refusal(launch()) == "there are 500 bodies in the water already"


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        (launch(), None),
        (launch(north_m=-1.0), "no free water at -1.0 N 18.0 E; choose another place"),
        (launch(north_m=3.0, east_m=2.0), "a vessel is at 3.0 N 2.0 E; choose another place"),
    ],
)
def test_the_reason_why_a_body_cannot_be_launched(
    monkeypatch: pytest.MonkeyPatch, body: Launch, reason: str | None
) -> None:
    assert Water(monkeypatch).node.refusal(body) == reason


def test_a_body_may_be_launched_just_clear_of_a_vessel(monkeypatch: pytest.MonkeyPatch) -> None:
    water = Water(monkeypatch)
    body = river.make_body(BodyKind.TRUNK, 4.0, 1000.0)
    clear_m = 1.5 + body.half_axis_m + body.radius_m
    assert water.node.refusal(launch(1.0, 2.0 + clear_m - 0.01)) is not None
    assert water.node.refusal(launch(1.0, 2.0 + clear_m + 0.01)) is None


def test_a_body_that_there_is_not_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    assert Water(monkeypatch).node.refusal(launch(length_m=-1.0)) is not None


def test_new_bodies_are_told_drawn_and_recorded_ten_times_a_second(monkeypatch: pytest.MonkeyPatch) -> None:
    water = Water(monkeypatch)
    body = SimpleNamespace(kind=BodyKind.TRUNK, length_m=4.0)
    water.debris.bodies = (body,)
    water.debris.time_ns, water.debris.yaw_rad, water.debris.yaw_rate_radps = S, np.array([-0.5]), np.array([2.0])
    water.debris.pos_ned_m, water.debris.vel_ned_mps = np.array([[15.0, 18.04, 0.0]]), np.array([[1.0, 2.0, 0.0]])
    every = _record_every(0.0025)
    assert every == 40
    water.node.sense(water.step(39, S))
    heading = math.degrees(-0.5) % 360.0
    assert water.recorder.texts == [(S, f"trunk 0 of 4.0 m in the water at 15.0 N 18.0 E, {heading:.0f}°")]
    assert water.recorder.scenes == [(S, (1, 0))]
    assert water.recorder.bodies == []
    water.node.sense(water.step(40, S + S // 2))
    ((stamp_ns, kinds, lengths, places, quats, speeds),) = water.recorder.bodies
    assert (stamp_ns, kinds, lengths.tolist()) == (S + S // 2, ["trunk"], [4.0])
    assert places.tolist() == [[15.5, 19.04, 0.0]]  # half a second later
    assert 2.0 * math.atan2(quats[0, 3], quats[0, 0]) == pytest.approx(-0.5 + 1.0)
    assert speeds.tolist() == [[1.0, 2.0, 0.0]]
    assert len(water.recorder.texts) == 1
    report = water.node.report()["debris"]
    assert (report["launched"], report["by"]) == (1, {"trunk": 1})


def test_bodies_are_not_drawn_in_a_recording_without_a_scene(monkeypatch: pytest.MonkeyPatch) -> None:
    water = Water(monkeypatch, drawn=False)
    water.debris.bodies = (SimpleNamespace(kind=BodyKind.TRUNK, length_m=4.0),)
    water.debris.yaw_rad, water.debris.pos_ned_m = np.zeros(1), np.zeros((1, 3))
    water.node.sense(water.step(1, S))
    assert water.recorder.scenes == []
    assert len(water.recorder.texts) == 1


@pytest.mark.parametrize(("dt_s", "every"), [(0.0025, 40), (0.01, 10), (0.1, 1), (1.0, 1)])
def test_bodies_are_recorded_at_their_rate_or_each_step(dt_s: float, every: int) -> None:
    assert _record_every(dt_s) == every


@pytest.mark.parametrize("scene", [True, False])
def test_the_tide_is_recorded_and_the_water_drawn_again_after_two_centimetres(
    monkeypatch: pytest.MonkeyPatch, scene: bool
) -> None:
    monkeypatch.setattr(river, "make_water_scene", lambda profiles, height_m: round(height_m, 3))
    tide = SimpleNamespace(
        height_m=lambda time_s: 0.011 * time_s, rise_mps=lambda time_s: 0.011, stream_mps=lambda time_s: 0.5
    )
    environment = SimpleNamespace(tide=tide, level_m=lambda time_s: 1.0 + 0.011 * time_s)
    plant = SimpleNamespace(simulation=SimpleNamespace(environment=environment))
    profile = load_profile("sitl", [f"recording.scene={str(scene).lower()}"]).runnable()
    node, recorder = TideNode([profile], cast(Any, plant)), Recorder()
    assert node.record_every == profile.clock.physics_rate_hz
    node.begin(cast(Any, SimpleNamespace(recorder=recorder)))
    for second in range(1, 5):
        node.record(cast(Any, SimpleNamespace(now_ns=second * S)))
    assert [stamp_ns // S for stamp_ns, _ in recorder.records] == [0, 1, 2, 3, 4]
    assert recorder.records[2][1] == TideState(pytest.approx(1.022), pytest.approx(0.022), 0.011, 0.5)  # type: ignore[arg-type]
    assert recorder.scenes == ([(2 * S, 0.022), (4 * S, 0.044)] if scene else [])
