"""The operator of a run: what it carries out and when, what it records, and what it refuses."""

from __future__ import annotations

import json
from collections import Counter
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from sim_core.environment.waves import FlatWater, WaveField
from xitl_cli.record.topics import OperatorAction, SeaComponents
from xitl_cli.run.core.pace import OperatedLockstep
from xitl_cli.run.nodes.operator import OperatorNode
from xitl_cli.run.operator.operation import TimedAction

S = 1_000_000_000


class Pace(OperatedLockstep):
    """A pace that does not wait. did: what it was told."""

    def __init__(self) -> None:
        self.did: list[tuple[Any, ...]] = []
        self.listen: Any = None
        self._factor: float | None = None
        self._stands = False

    @property
    def factor(self) -> float | None:
        return self._factor

    @property
    def paused(self) -> bool:
        return self._stands

    def set_factor(self, factor: float | None) -> None:
        self._factor = factor

    def pause(self, now_ns: int) -> None:
        self._stands = True
        self.did.append(("pause", now_ns))

    def resume(self) -> None:
        self._stands = False
        self.did.append(("resume",))

    def step(self, length_ns: int) -> None:
        self.did.append(("step", length_ns))


class Recorder:
    def __init__(self) -> None:
        self.records: list[tuple[int, Any]] = []
        self.texts: list[tuple[int, int, str]] = []

    def write(self, stamp_ns: int, record: Any) -> None:
        self.records.append((stamp_ns, record))

    def log(self, stamp_ns: int, severity: int, source: str, text: str) -> None:
        self.texts.append((stamp_ns, severity, text))


class Steering:
    """Receiver of a vessel's orders. given: orders in turn."""

    silences = 2

    def __init__(self) -> None:
        self.given: list[Any] = []
        self.asked_by: Counter[str] = Counter()
        self.say = ""

    def check(self, order: Any) -> None: ...

    def give(self, order: Any) -> None:
        self.given.append(order)

    def update(self, now_ns: int, say: Any) -> None:
        if self.say:
            say(self.say)


class Orders:
    """Faults and links of a vessel. injected: names and what they were."""

    def __init__(self) -> None:
        self.injected: list[tuple[str, Any]] = []

    def fault_names(self) -> tuple[str, ...]:
        return ("gap",)

    def inject(self, name: str, fault: Any) -> None:
        self.injected.append((name, fault))

    def read_fault(self, asked: Any, now_ns: int) -> Any:
        return ("fault", asked.on, now_ns)

    def read_link(self, asked: Any, now_ns: int) -> Any:
        return ("link", asked.cut, now_ns)


class Made:
    """An operator of the vessels a (with an autopilot) and b (without)."""

    def __init__(self, *events: TimedAction, realtime: bool = False) -> None:
        self.changes = SimpleNamespace(
            waves=FlatWater(),
            asked="environment",
            is_settled=True,
            did=[],
            read=lambda name, action: f"{name} {action.get('mean_mps')}",
            update=lambda now_ns: None,
        )
        self.changes.ask = lambda name, group: self.changes.did.append((name, group))
        self.river = SimpleNamespace(launched=[], refusal=lambda body: "no free water" if body.north_m < 0 else None)
        self.river.launch = self.river.launched.append
        self.steering, self.orders = Steering(), Orders()
        self.node = OperatorNode(
            cast(Any, self.changes),
            cast(Any, self.river),
            ["a", "b"],
            cast(Any, {"a": self.steering}),
            cast(Any, {"a": self.orders}),
            events,
        )
        self.recorder, self.pace = Recorder(), None if realtime else Pace()
        self.node.begin(cast(Any, SimpleNamespace(recorder=self.recorder, pace=self.pace)))

    def exchange(self, at_s: float = 1.0) -> None:
        self.node.exchange(cast(Any, SimpleNamespace(now_ns=round(at_s * S))))

    def actions(self) -> list[tuple[Any, str]]:
        return [
            (json.loads(record.action), record.source)
            for _, record in self.recorder.records
            if isinstance(record, OperatorAction)
        ]


def test_an_action_is_carried_out_and_recorded_at_the_next_exchange() -> None:
    made = Made()
    action = {"action": "wind", "mean_mps": 6}
    assert made.node.ask(action, "view") is None
    assert made.changes.did == []
    made.exchange(2.0)
    assert made.changes.did == [("wind", "wind 6")]
    assert made.actions() == [(action, "view")]
    assert made.recorder.texts == [(2 * S, 6, "wind mean_mps 6 (view)")]
    assert made.node.now_ns == 2 * S
    assert made.node.environment == "environment"
    assert made.node.report()["operator"]["actions"] == {"wind": 1}


def test_an_operator_that_did_nothing_reports_nothing() -> None:
    made = Made()
    made.exchange()
    assert made.node.report() == {"operator": None}


def test_listeners_are_polled_at_every_exchange_and_in_a_pause() -> None:
    made = Made()
    polled: list[int] = []
    made.node.listen(lambda: polled.append(1))
    made.exchange()
    assert made.pace is not None
    made.pace.listen()
    assert len(polled) == 2


def test_orders_go_to_the_vessel_and_streams_keep_the_latest() -> None:
    made = Made()
    for speed in (1.0, 2.0):
        action = {"action": "velocity", "speed_mps": speed, "turn_rate_radps": 0.0, "vessel": "a"}
        assert made.node.ask(action, "ros") is None
    assert made.node.ask({"action": "arm", "armed": True, "vessel": "a"}, "view") is None
    made.exchange()
    assert [type(order).__name__ for order in made.steering.given] == ["SteerVelocity", "Arm"]
    assert made.steering.given[0].speed_mps == 2.0
    assert made.steering.asked_by["ros"] == 1
    assert [text for _, _, text in made.recorder.texts] == ['arm armed true, vessel "a" (view)']  # no streams
    report = made.node.report()["operator"]
    assert (report["superseded"], report["silences"]) == (1, 2)


def test_a_sentence_about_a_vessel_begins_with_its_name() -> None:
    made = Made()
    made.steering.say = "in GUIDED"
    made.exchange()
    assert made.recorder.texts == [(S, 6, "a: in GUIDED")]


@pytest.mark.parametrize(
    ("action", "told"),
    [
        ({"action": "arm", "armed": True, "vessel": "c"}, "arm: vessel = 'c' is not in this run; use a, b"),
        ({"action": "arm", "armed": True, "vessel": "b"}, "arm: b has no autopilot; use autopilot.kind: embedded"),
        (
            {"action": "velocity", "speed_mps": 1, "turn_rate_radps": 0, "vessel": "b"},
            "velocity: b has no autopilot; use autopilot.kind: embedded, or driver.kind: ros",
        ),
        ({"action": "fault", "name": "gap", "on": True, "vessel": "b"}, "fault: b has no autopilot"),
        ({"action": "link", "cut": True, "vessel": "b"}, "link: b has no autopilot"),
        ({"action": "launch", "kind": "trunk", "north_m": -1, "east_m": 2}, "launch: no free water"),
        ({"action": "resume"}, "resume: the run is not paused; pause it first"),
        ({"action": "step"}, "step: the run is not paused; pause it first"),
    ],
)
def test_what_is_not_possible_is_refused_and_counted(action: dict[str, Any], told: str) -> None:
    made = Made()
    refusal = made.node.ask(action)
    assert refusal is not None
    assert refusal.startswith(told)
    made.exchange()
    assert made.actions() == []
    assert made.node.report()["operator"]["refused"] == 1


def test_faults_and_links_are_switched_at_their_instant() -> None:
    made = Made()
    made.exchange(3.0)
    assert made.node.ask({"action": "fault", "name": "gap", "on": True, "vessel": "a"}) is None
    assert made.node.ask({"action": "link", "cut": True, "vessel": "a"}) is None
    made.exchange(4.0)
    (fault, link) = made.orders.injected
    assert fault == ("gap", ("fault", True, 3 * S))
    assert link[1] == ("link", True, 3 * S)
    assert made.node.faults == {"a": ("gap",)}


def test_bodies_that_wait_for_their_launch_are_known() -> None:
    made = Made()
    made.exchange(2.0)
    for north_m in (1.0, 3.0):
        made.node.ask({"action": "launch", "kind": "trunk", "north_m": north_m, "east_m": 2, "heading_deg": 90})
    made.node.ask({"action": "wind", "mean_mps": 6})
    waiting = made.node.waiting_launches
    assert [(body.north_m, body.east_m, body.heading_rad) for body in waiting] == [
        (1.0, 2.0, pytest.approx(np.pi / 2)),
        (3.0, 2.0, pytest.approx(np.pi / 2)),
    ]
    made.exchange(2.1)
    assert made.river.launched == list(waiting)
    assert made.node.waiting_launches == ()


def test_a_pause_begins_at_the_exchange_and_ends_at_once() -> None:
    made = Made()
    pace = made.pace
    assert pace is not None
    assert made.node.ask({"action": "pause"}, "view") is None
    assert made.node.paused
    assert (made.node.paused_by, pace.did) == ("view", [])
    assert made.node.ask({"action": "pause"}, "ros") == "pause: the run is paused already; resume or step it"
    assert made.node.paused_by == "view"
    made.exchange(2.0)
    assert pace.did == [("pause", 2 * S)]
    assert made.node.ask({"action": "step", "seconds": 0.25}) is None
    assert pace.did[-1] == ("step", 250_000_000)
    assert made.node.ask({"action": "resume"}) is None
    assert (pace.did[-1], made.node.paused, made.node.paused_by) == (("resume",), False, None)
    made.exchange(3.0)
    assert [action["action"] for action, _ in made.actions()] == ["pause", "step", "resume"]
    assert pace.did.count(("step", 250_000_000)) == 1


def test_a_step_before_the_pause_has_begun_waits_for_the_exchange() -> None:
    made = Made()
    assert made.pace is not None
    made.node.ask({"action": "pause"})
    made.node.ask({"action": "step", "seconds": 0.5})
    assert made.pace.did == []
    made.exchange()
    assert made.pace.did == [("pause", S), ("step", 500_000_000)]


def test_a_pause_that_is_taken_back_before_the_exchange_does_not_begin() -> None:
    made = Made()
    assert made.pace is not None
    made.node.ask({"action": "pause"})
    made.node.ask({"action": "resume"})
    made.exchange()
    assert made.pace.did == [("resume",)]


def test_the_pace_is_changed_at_once_and_only_in_lockstep() -> None:
    made = Made()
    assert made.node.ask({"action": "pace", "factor": 0.5}) is None
    assert made.node.factor == 0.5
    made.exchange()
    assert made.actions() == [({"action": "pace", "factor": 0.5}, "operator")]
    real = Made(realtime=True)
    assert real.node.factor is None
    assert real.node.ask({"action": "pause"}) == "pause: not possible in real time; use clock.mode: lockstep"


def test_actions_of_an_earlier_run_are_repeated_at_their_instants() -> None:
    events = (
        TimedAction(1 * S, {"action": "wind", "mean_mps": 6}, "view"),
        TimedAction(2 * S, {"action": "pause"}, "view"),
        TimedAction(2 * S, {"action": "arm", "armed": True, "vessel": "c"}, "file"),
        TimedAction(9 * S, {"action": "wind", "mean_mps": 7}, "view"),
    )
    made = Made(*events)
    made.exchange(0.999)
    assert made.actions() == []
    made.exchange(1.0)
    assert made.actions() == [({"action": "wind", "mean_mps": 6}, "view")]
    made.exchange(2.5)
    assert made.actions()[1:] == [({"action": "pause"}, "view")]
    assert made.pace is not None
    assert (made.pace.did, made.node.paused) == ([], False)  # a pace is only recorded again
    assert made.recorder.texts[-2][1:] == (
        4,
        "--replay-events: refused at 2.00 s: arm: vessel = 'c' is not in this run; use a, b",
    )
    report = made.node.report()
    assert (report["operator"]["replayed"], report["operator"]["not_replayed"]) == (2, 1)
    assert report["warnings"] == ["--replay-events: the run ended before 1 of the actions"]


def waves(amplitude_m: float) -> WaveField:
    field = WaveField.__new__(WaveField)
    for name, value in {
        "amplitude_m": np.array([amplitude_m]),
        "wave_vector_radpm": np.array([[0.1, 0.2]]),
        "phase_rad": np.array([0.5]),
    }.items():
        object.__setattr__(field, name, value)
    return field


def test_changing_waves_are_recorded_twice_a_second_and_when_they_have_settled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(WaveField, "apparent_omega_radps", np.array([1.5]), raising=False)
    made = Made()
    recorded = []
    for at_s, settled in ((0.4, False), (0.5, False), (0.9, False), (1.0, False), (1.1, True), (1.2, True)):
        if at_s < 1.2:
            made.changes.waves = waves(at_s)
        made.changes.is_settled = settled
        made.exchange(at_s)
        seas = [record for _, record in made.recorder.records if isinstance(record, SeaComponents)]
        recorded.append([next(iter(sea.amplitude_m)) for sea in seas])
    assert recorded == [[], [0.5], [0.5], [0.5, 1.0], [0.5, 1.0, 1.1], [0.5, 1.0, 1.1]]
    sea = seas[0]
    assert (list(sea.wave_number_north_radpm), list(sea.wave_number_east_radpm)) == ([0.1], [0.2])
    assert (list(sea.angular_frequency_radps), list(sea.phase_rad)) == ([1.5], [0.5])
    made.changes.waves = FlatWater()
    made.exchange(2.0)
    last = made.recorder.records[-1][1]
    assert (last.amplitude_m, last.phase_rad) == ((), ())
