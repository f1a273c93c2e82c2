"""The verdict of a run from what its nodes report."""

from __future__ import annotations

from typing import Any

import pytest

from tests.golden import Golden
from xitl_cli.record.topics import AutopilotEvent, LinkReport, PaceReport, TaskTiming
from xitl_cli.run.core.reports import ClockReport, Ending, FaultReport
from xitl_cli.run.summary import Verdict, judge, measured_figures, stop_text, why_text

PHYSICS = TaskTiming("PS1", "physics", 400.0, 40_000, 14_400)
CONTROL = TaskTiming("LC", "control", 50.0, 4900, 300, skipped=100)
ODOMETRY = TaskTiming("HC", "odometry", 10.0, 500, 500, skipped=500)
STEPPED = ClockReport("LC", 0.0, 1.0, steps=1)
MISSION = {"waypoints_reached": 3, "waypoints_total": 6}


def verdict(**reports: Any) -> Verdict:
    told: dict[str, Any] = {"tasks": [], "links": [], "clocks": [], "faults": [], **reports}
    return judge(Ending.FINISHED, True, False, "", measured_figures(100.0, told.pop("pace", PaceReport()), **told))


def test_everything_that_makes_a_run_none_in_real_time_is_named(golden: Golden) -> None:
    link = LinkReport("sensors", 10_000, 9000, 1000, impaired=600)
    found = verdict(
        tasks=[PHYSICS, CONTROL, ODOMETRY], links=[link], clocks=[STEPPED], pace=PaceReport(4, 24.0, 9, 24.7, 7.0)
    )
    assert found.real_time is False
    golden("text", found.shortfalls, "9 times", "24.7 s", "7.0 s", "36 %", "6.0 %", "300", "5000", "4.0 %", "400")
    assert found.warnings == [f"not a real-time run: {'; '.join(found.shortfalls)}"]
    section = found.section()
    assert section["physics_missed_share"] == pytest.approx(0.36)
    assert (section["agent_task"], section["link"], section["clock_steps"]) == ("LC control", "sensors", 1)
    assert (section["stalls"], section["stalled_s"], section["longest_stall_s"]) == (9, 24.7, 7.0)


@pytest.mark.parametrize(
    ("kind", "from_s", "spared"), [("agent", 1.0, True), ("agent", None, False), ("imu", 1.0, False)]
)
def test_what_a_fault_did_to_an_agent_on_purpose_is_not_held_against_the_run(
    kind: str, from_s: float | None, spared: bool
) -> None:
    found = verdict(tasks=[PHYSICS, CONTROL], clocks=[STEPPED], faults=[FaultReport("x", kind, from_s, None)])
    assert len(found.shortfalls) == (1 if spared else 3)
    assert found.shortfalls[0] == "36 % of the physics deadlines missed"  # the host is the host


@pytest.mark.parametrize(
    ("ending", "completed", "timed", "done", "asked"),
    [
        (Ending.FINISHED, True, False, True, False),
        (Ending.FINISHED, False, False, False, False),
        (Ending.DURATION, False, True, False, True),
        (Ending.DURATION, False, False, False, False),
        (Ending.DURATION, True, False, True, False),
        (Ending.INTERRUPTED, True, True, False, False),
        (Ending.FAILED, True, True, False, False),
    ],
)
def test_a_duration_is_reached_on_purpose_only_when_it_was_asked_for(
    ending: Ending, completed: bool, timed: bool, done: bool, asked: bool
) -> None:
    found = judge(ending, completed, timed, "", None)
    assert (found.completed, found.duration_asked, found.real_time) == (done, asked, None)


@pytest.mark.parametrize(
    ("ending", "driver", "completed", "frozen", "said"),
    [
        (Ending.FINISHED, "mission", False, False, "3 of 6 waypoints"),
        (Ending.DURATION, "mission", False, False, "duration reached, 3 of 6 waypoints"),
        (Ending.INTERRUPTED, "script", False, False, "interrupted, the script was not played to its end"),
        (Ending.FINISHED, "replay", True, False, "the replay was played to its end"),
        (Ending.FAILED, "mission", False, False, "the cable; 3 of 6 waypoints"),
        (
            Ending.DURATION,
            "ground-station",
            False,
            True,
            "duration reached, 3 of 6 waypoints, the vessel was never armed and stayed frozen",
        ),
    ],
)
def test_why_it_ended_is_said_with_how_far_it_came(
    ending: Ending, driver: str, completed: bool, frozen: bool, said: str
) -> None:
    assert why_text(ending, "the cable", driver, completed, MISSION, frozen) == said


@pytest.mark.parametrize(
    ("ending", "said"),
    [
        (Ending.DURATION, "stopped by HOLD (EKF failsafe) at 41.2 s; 3 of 6 waypoints"),
        (Ending.FINISHED, "stopped by HOLD (EKF failsafe) at 41.2 s; 3 of 6 waypoints"),
        (Ending.INTERRUPTED, "interrupted; stopped by HOLD (EKF failsafe) at 41.2 s; 3 of 6 waypoints"),
        (Ending.FAILED, "the cable; stopped by HOLD (EKF failsafe) at 41.2 s; 3 of 6 waypoints"),
    ],
)
def test_a_stop_is_named_before_the_waypoints(ending: Ending, said: str) -> None:
    stop = stop_text([AutopilotEvent(41.2, "mode", "HOLD", "AUTO", "EKF failsafe")], "mission")
    assert why_text(ending, "the cable", "mission", False, MISSION, False, stop) == said
