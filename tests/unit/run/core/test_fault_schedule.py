"""What is in force when: every instant by hand."""

from __future__ import annotations

import json
from typing import Any

import pytest

from agent.wire.impaired import NO_FAULTS, LinkFaults
from tests.golden import Golden
from xitl_cli.profile.files.yaml_file import parse_yaml
from xitl_cli.profile.reader import read_group
from xitl_cli.profile.schema.faults import FaultSpec
from xitl_cli.record.topics import FaultEvent
from xitl_cli.run.core.faults import FaultSchedule, FaultsInForce
from xitl_cli.seeds import Seeds

S = 1_000_000_000


def fault_from(keys: object) -> FaultSpec:
    """A fault as a profile gives it."""
    entry = parse_yaml(json.dumps(keys), "test")
    assert entry is not None
    return read_group(entry, FaultSpec, "test")


class Recorder:
    def __init__(self) -> None:
        self.faults: list[tuple[int, str, bool]] = []
        self.said: list[str] = []

    def write(self, stamp_ns: int, event: FaultEvent) -> None:
        self.faults.append((stamp_ns, event.fault, event.active))

    def log(self, stamp_ns: int, severity: int, source: str, text: str) -> None:
        assert (severity, source) == (5, "run")
        self.said.append(text)


def schedule(seed: int = 1, **faults: Any) -> FaultSchedule:
    made = {name.replace("_", "-"): fault_from(fault) for name, fault in faults.items()}
    return FaultSchedule(made, Seeds(seed))


def walk(made: FaultSchedule, until_s: float, link: str = "agent") -> dict[float, FaultsInForce]:
    """Every change, exchange by exchange at 50 Hz."""
    changes = {}
    for step in range(1, round(until_s * 50) + 1):
        faults = made.at(step * S // 50, link)
        if faults is not None:
            changes[step / 50] = faults
    return changes


def test_nothing_planned_is_nothing_to_do() -> None:
    assert walk(schedule(), 1.0) == {}


def test_a_fault_begins_at_its_instant_and_ends_before_its_end() -> None:
    changes = walk(schedule(cut={"from_s": 0.5, "until_s": 1.0, "link": {"cut": True}}), 2.0)
    assert list(changes) == [0.5, 1.0]
    assert changes[0.5].to_agent == changes[0.5].from_agent == LinkFaults(cut=True)
    assert changes[1.0] == FaultsInForce()


def test_a_fault_from_the_start_without_an_end() -> None:
    changes = walk(schedule(skew={"agent": {"clock_skew_ppm": 80.0, "clock_offset_s": 3.0}}), 1.0)
    assert list(changes) == [0.02]
    assert (changes[0.02].clock_skew_ppm, changes[0.02].clock_offset_s) == (80.0, 3.0)


@pytest.mark.parametrize(
    ("direction", "to_agent", "from_agent"), [("sensors", 0.2, 0.0), ("actuators", 0.0, 0.2), ("both", 0.2, 0.2)]
)
def test_directions(direction: str, to_agent: float, from_agent: float) -> None:
    faults = walk(schedule(lossy={"link": {"loss": 0.2, "direction": direction}}), 0.02)[0.02]
    assert (faults.to_agent.loss, faults.from_agent.loss) == (to_agent, from_agent)


def test_faults_that_overlap() -> None:
    changes = walk(
        schedule(
            late={"from_s": 0.2, "until_s": 0.8, "link": {"delay_s": 0.1, "jitter_s": 0.01, "loss": 0.5}},
            lossy={"from_s": 0.4, "until_s": 0.6, "link": {"delay_s": 0.2, "loss": 0.5}},
            busy={"from_s": 0.4, "until_s": 0.6, "agent": {"cpu_load": 0.9}},
            busier={"from_s": 0.5, "until_s": 0.6, "agent": {"cpu_load": 0.5}},
        ),
        1.0,
    )
    # busier is less busy than busy already is: nothing changes at 0.5 s.
    assert list(changes) == [0.2, 0.4, 0.6, 0.8]
    assert changes[0.4].to_agent.delay_s == pytest.approx(0.3)
    assert changes[0.4].to_agent.loss == pytest.approx(0.75)  # 1 - 0.5 * 0.5
    assert (changes[0.4].cpu_load, changes[0.6].cpu_load) == (0.9, 0.0)
    assert changes[0.6] == changes[0.2]


def test_each_link_has_its_own_faults() -> None:
    made = schedule(cut={"from_s": 0.5, "link": {"cut": True, "which": "standby"}}, busy={"agent": {"cpu_load": 0.5}})
    assert walk(made, 1.0, "standby")[0.5].to_agent.cut
    agent = walk(made, 1.0, "agent")
    assert list(agent) == [0.02]
    assert agent[0.02].to_agent == NO_FAULTS


def test_what_is_drawn_depends_on_the_seed_and_the_name_alone() -> None:
    def seed(made: FaultSchedule) -> int:
        return walk(made, 0.02)[0.02].seed

    lossy = {"link": {"loss": 0.2}}
    first = seed(schedule(lossy=lossy))
    assert first == seed(schedule(lossy=lossy, busy={"agent": {"cpu_load": 0.5}}))
    assert len({first, seed(schedule(seed=2, lossy=lossy)), seed(schedule(other=lossy))}) == 3
    assert 0 <= first < 2**32


def test_the_message_to_the_agent_carries_what_is_its_own() -> None:
    faults = walk(
        schedule(
            one={"link": {"direction": "actuators", "delay_s": 0.01, "jitter_s": 0.002, "loss": 0.25, "cut": True}},
            two={"link": {"direction": "sensors", "reorder": 0.5}},
            three={"agent": {"cpu_load": 0.5, "clock_offset_s": 3.0, "clock_skew_ppm": -80.0}},
        ),
        0.02,
    )[0.02]
    assert faults.on_agent
    message = faults.message(20_000_000)
    assert (message.time_usec, message.delay_usec, message.jitter_usec, message.cut) == (20_000, 10_000, 2_000, 1)
    assert (message.loss, message.reorder, message.duplicate) == (0.25, 0.0, 0.0)
    assert (message.clock_offset_ns, message.clock_skew_ppm, message.cpu_load) == (3 * S, -80.0, 0.5)
    assert message.seed != faults.seed  # what is lost one way says nothing about the other


def test_the_end_of_all_faults_is_all_zero_to_the_agent() -> None:
    message = FaultsInForce().message(1_000_000)
    assert not FaultsInForce().on_agent
    assert not any(getattr(message, name) for name in message.fieldnames if name != "time_usec")


def test_beginnings_and_ends_are_recorded_and_said_once(golden: Golden) -> None:
    made = schedule(
        link_cut={"from_s": 0.5, "until_s": 1.0, "link": {"cut": True}},
        gone={"from_s": 0.6, "gnss": {"dropout": 0.5, "position_bias_ned_m": (1.0, 0.0, 0.0)}},
        never={"from_s": 9.0, "imu": {"freeze": True}},
    )
    recorder: Any = Recorder()
    in_force = {}
    for step in range(1, 101):
        made.record(step * S // 50, recorder)
        in_force[step / 50] = made.names_in_force()
    assert recorder.faults == [(S // 2, "link-cut", True), (S * 6 // 10, "gone", True), (S, "link-cut", False)]
    golden("message", recorder.said, "50 %")
    assert (in_force[0.48], in_force[0.6], in_force[1.0]) == ((), ("link-cut", "gone"), ("gone",))
    reports = made.reports({"gone": {"gnss_dropped": 3}})
    assert [(report.name, report.kind, report.from_s, report.until_s, report.did) for report in reports] == [
        ("link-cut", "link", 0.5, 1.0, {}),
        ("gone", "gnss", 0.6, None, {"gnss_dropped": 3}),
        ("never", "imu", None, None, {}),
    ]


def counted(made: FaultSchedule, counts: list[tuple[float, int, int, float]]) -> list[dict[str, int]]:
    """What each fault did when the ends' totals were so at these instants, the agent's as told at another."""
    recorder: Any = Recorder()
    for now_s, to_agent, from_agent, told_s in counts:
        made.record(round(now_s * S), recorder)
        made.count_impaired(to_agent, from_agent, round(told_s * S))
    return [report.did for report in made.reports({})]


def test_lost_frames_are_put_down_to_the_fault_in_force() -> None:
    made = schedule(
        one={"from_s": 1.0, "until_s": 2.0, "link": {"loss": 0.5}},
        two={"from_s": 3.0, "until_s": 4.0, "link": {"cut": True}},
    )
    # What the agent tells of the first one's time comes when that is over, in two parts.
    counts = [(1.0, 0, 0, 0.7), (1.5, 10, 0, 0.7), (2.0, 12, 4, 1.7), (2.5, 12, 4, 1.7), (2.9, 12, 6, 2.7)]
    first, second = counted(made, [*counts, (3.5, 40, 6, 2.7), (5.0, 45, 16, 4.7)])
    assert first == {"frames_lost_to_agent": 12, "frames_lost_from_agent": 6}
    assert second == {"frames_lost_to_agent": 33, "frames_lost_from_agent": 10}


def test_lost_frames_are_put_down_to_faults_of_their_direction() -> None:
    made = schedule(
        out={"from_s": 1.0, "until_s": 3.0, "link": {"loss": 0.5, "direction": "sensors"}},
        back={"from_s": 1.0, "until_s": 3.0, "link": {"loss": 0.5, "direction": "actuators"}},
        other={"from_s": 1.0, "link": {"loss": 0.5, "which": "standby"}},
    )
    assert counted(made, [(1.0, 0, 0, 1.0), (2.0, 5, 7, 2.0), (4.0, 6, 8, 4.0)]) == [
        {"frames_lost_to_agent": 6},
        {"frames_lost_from_agent": 8},
        {},
    ]


def test_a_fault_shorter_than_the_time_between_two_counts_gets_its_own() -> None:
    made = schedule(blip={"from_s": 1.1, "until_s": 1.3, "link": {"cut": True}})
    assert counted(made, [(1.0, 0, 0, 1.0), (2.0, 50, 0, 1.0), (3.0, 50, 20, 2.0), (4.0, 60, 30, 3.0)]) == [
        {"frames_lost_to_agent": 50, "frames_lost_from_agent": 20}
    ]
