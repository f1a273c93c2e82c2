"""The driver of a follower, with commands and reports that the test plays: what it asks for, and what it reports."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from sim_core.geodesy import LocalFrame
from xitl_cli.profile.schema.agents import FollowSpec
from xitl_cli.run.nodes.drivers import ArmingPhase
from xitl_cli.run.nodes.follow import FollowDriver
from xitl_cli.run.traffic.self_report import SelfReport, VesselVoices

FRAME = LocalFrame(-8.8, -63.95, 70.0)
S = 1_000_000_000
NORTH_MPS = 2.0


class Commands:
    """Stands in for the commands to an autopilot that is under way. asked: what it was sent, with its time in s."""

    def __init__(self) -> None:
        self.asked: list[tuple[Any, ...]] = []
        self.view = SimpleNamespace(ready_to_arm=True)

    def forget(self) -> None: ...

    def arm(self, sim_ns: int) -> bool:
        return True

    def set_mode(self, sim_ns: int, mode: str) -> bool:
        assert mode == "GUIDED"
        return True

    def sail(self, sim_ns: int, vel_ne_mps: tuple[float, float]) -> None:
        self.asked.append((sim_ns / S, "sail", *(round(part, 3) for part in vel_ne_mps)))

    def go_to(self, sim_ns: int, lat_deg: float, lon_deg: float, alt_m: float) -> None:
        place = FRAME.ned(np.array([lat_deg]), np.array([lon_deg]), np.array([alt_m]))[0]
        self.asked.append((sim_ns / S, "go to", *(round(float(part), 2) for part in place[:2])))


class Chase:
    """A follower 10 m behind a leader that goes north. The leader reports until `silent_from_s`."""

    def __init__(self, follower_north_m: float = -10.0, **spec: Any) -> None:
        self.leader: SelfReport | None = None
        self.follower: SelfReport | None = None
        self.done = False
        self.said: list[tuple[int, int, str]] = []
        self.commands = Commands()
        voices = VesselVoices()
        voices.add("lead", lambda: self.leader, lambda: self.done)
        voices.add("own", lambda: self.follower, lambda: False)
        self.driver = FollowDriver(
            cast(Any, self.commands), FRAME, FollowSpec(vessel="lead", **spec), voices, "own", NORTH_MPS
        )
        recorder = SimpleNamespace(
            log=lambda now_ns, severity, source, text: self.said.append((now_ns, severity, text))
        )
        self.driver.begin(cast(Any, SimpleNamespace(recorder=recorder)))
        self._north_m = follower_north_m
        self.leader_north_m = 0.0

    def run(self, from_s: float, until_s: float, speed_mps: float, hears: bool = True, every_s: float = 0.1) -> None:
        """The leader reports ten times a second, and the follower keeps its distance."""
        for step in range(round(from_s / every_s), round(until_s / every_s)):
            now_ns = round(step * every_s * S)
            if hears:
                self.leader = SelfReport(now_ns, (self.leader_north_m, 0.0), (speed_mps, 0.0), 0.0)
            self.follower = SelfReport(now_ns, (self._north_m, 0.0), (speed_mps, 0.0), 0.0)
            self.driver.update(now_ns)
            self.leader_north_m += speed_mps * every_s
            self._north_m += speed_mps * every_s


def test_it_waits_for_reports_of_both_vessels() -> None:
    chase = Chase()
    chase.driver.update(0)
    assert chase.driver.ready
    chase.leader = SelfReport(S, (0.0, 0.0), (0.0, 0.0), 0.0)
    chase.driver.update(S)
    assert chase.commands.asked == []


def test_it_asks_five_times_a_second_at_the_speed_of_the_leader() -> None:
    chase = Chase()
    chase.run(0.0, 20.0, NORTH_MPS)
    sails = [asked for asked in chase.commands.asked if asked[1] == "sail"]
    times = np.array([asked[0] for asked in sails])
    np.testing.assert_allclose(np.diff(times), 0.2, atol=1e-9)
    assert sails[-1][2] == pytest.approx(NORTH_MPS, abs=0.1)
    assert sails[-1][3] == 0.0
    assert all(asked[1] == "go to" for asked in chase.commands.asked[: len(chase.commands.asked) - len(sails)])


def test_behind_a_leader_at_rest_it_goes_to_its_place_and_repeats_it_each_second() -> None:
    chase = Chase()
    chase.run(0.0, 3.0, 0.0)
    assert chase.commands.asked == [(at_s, "go to", -10.0, 0.0) for at_s in (0.0, 1.0, 2.0)]


def test_a_place_that_moved_little_is_kept_and_another_one_sent_at_once() -> None:
    chase = Chase()
    chase.run(0.0, 0.5, 0.0)
    chase.leader_north_m = 1.4
    chase.run(0.5, 0.9, 0.0)
    assert [asked[2] for asked in chase.commands.asked] == [-10.0]
    chase.leader_north_m = 1.9
    chase.run(0.9, 1.3, 0.0)
    assert [asked[2] for asked in chase.commands.asked] == [-10.0, -8.1]


def test_a_lost_leader_is_told_once_and_its_last_place_kept_until_it_is_heard() -> None:
    chase = Chase(lost_s=5.0)
    chase.run(0.0, 10.0, NORTH_MPS)
    last_m = chase.leader_north_m - 0.2  # of its last report
    chase.run(10.0, 20.0, 0.0, hears=False)
    ((lost_ns, severity, text),) = chase.said
    assert lost_ns / S == pytest.approx(15.0, abs=0.11)  # the last report was at 9.9 s
    assert severity == 4
    assert text == "leader lost: no report of lead for 5 s; keeping the place behind its last position"
    kept = [asked for asked in chase.commands.asked if asked[0] > 15.2]
    assert {asked[1] for asked in kept} == {"go to"}
    assert len({asked[2] for asked in kept}) == 1
    assert kept[0][2] == pytest.approx(last_m - 10.0, abs=0.5)
    assert not chase.driver.progress().finished
    chase.done = True
    assert chase.driver.progress().finished
    assert not chase.driver.progress().completed
    chase.run(20.0, 21.0, 0.0)
    assert [(severity, text) for _, severity, text in chase.said[1:]] == [(5, "leader heard again: lead")]
    assert chase.driver.progress().completed
    report = chase.driver.report()
    assert report["follow"]["leader_lost"] == 1
    (warning,) = report["warnings"]
    assert warning.startswith("its leader lead was lost at 15.")


def test_the_distance_is_reported_from_the_first_time_at_the_place() -> None:
    chase = Chase(follower_north_m=-13.5)
    chase.run(0.0, 5.0, 0.0)
    report = chase.driver.report()["follow"]
    assert report["settled_s"] is None
    assert report["rms_m"] is None
    assert (report["vessel"], report["offset_frd_m"]) == ("lead", [-10.0, 0.0])
    chase = Chase(follower_north_m=-12.0)
    chase.run(0.0, 2.0, 0.0)
    chase._north_m = -9.0
    chase.run(2.0, 4.0, 0.0)
    report = chase.driver.report()["follow"]
    assert report["settled_s"] == 0.0
    assert report["rms_m"] == pytest.approx(np.sqrt((4.0 + 1.0) / 2.0))
    assert (report["p50_m"], report["max_m"]) == pytest.approx((1.5, 2.0))
    assert report["p95_m"] == pytest.approx(2.0)
    assert (report["behind_max_m"], report["ahead_max_m"]) == pytest.approx((2.0, 1.0))
    assert report["beside_p95_m"] == pytest.approx(0.0)


def test_a_place_beside_the_leader_is_kept_with_its_sign() -> None:
    chase = Chase(offset_frd_m=(-10.0, 5.0))
    chase.run(0.0, 0.1, 0.0)
    assert chase.commands.asked == [(0.0, "go to", -10.0, 5.0)]  # east is starboard of a leader to the north


def test_it_says_what_it_waits_for_until_it_is_under_way() -> None:
    chase = Chase()
    chase.commands.view.ready_to_arm = False
    assert not chase.driver.ready
    assert chase.driver.progress().waits_for == ArmingPhase.READY.value
    chase.commands.view.ready_to_arm = True
    chase.driver.update(0)
    assert chase.driver.ready
    assert chase.driver.progress().waits_for == ""
