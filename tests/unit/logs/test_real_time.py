"""The judgement of a run in real time: by figures on either side of each limit."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

import xitl
from tests.golden import Golden
from tests.patience import let_pass
from xitl_cli.logs.model.sections import Evidence, Severity
from xitl_cli.logs.signals.real_time import LIMITS, LinkLosses, RealTimeFigures, TaskMissCount, not_real_time
from xitl_cli.plugins.logs.analyses.real_time import analyse, measured
from xitl_cli.run.nodes.direct_control import IdealControl


def figures(**values: Any) -> RealTimeFigures:
    return RealTimeFigures(**{"length_s": 100.0, **values})


KEPT = {
    "physics": TaskMissCount("PS1 physics", 40_000, 1900),
    "control": TaskMissCount("LC control", 5000, 90),
    "link": LinkLosses("sensors", 50_000, 400),
    "stalls": 10,
    "stalled_s": 0.9,
    "longest_stall_s": 0.2,
}


def test_a_run_within_every_limit_kept_real_time() -> None:
    assert figures(**KEPT).shortfalls() == ()


@pytest.mark.parametrize(
    ("measured", "said"),
    [
        ({"physics": TaskMissCount("PS1 physics", 40_000, 14_400)}, "36 % of the physics deadlines missed"),
        (
            {"control": TaskMissCount("LC control", 4900, 300)},
            "6.1 % of the agent's cycles missed (LC control: 300 of 4900)",
        ),
        ({"link": LinkLosses("sensors", 50_000, 900)}, "1.8 % of the frames lost (sensors: 900)"),
        (
            {"stalls": 9, "stalled_s": 24.7, "longest_stall_s": 5.1},
            "the host stalled 9 times, 24.7 s in all, the longest 5.1 s",
        ),
        ({"stalls": 1, "stalled_s": 0.3, "longest_stall_s": 0.3}, "the host stalled once, 0.30 s in all"),
        (
            {"stalls": 20, "stalled_s": 2.0, "longest_stall_s": 0.1},
            "the host stalled 20 times, 2.0 s in all, the longest 0.10 s",
        ),
        ({"slipped_s": 400.0}, "the host fell behind by 400.0 s that were not made up"),
        ({"clock_steps": (("LC", 2),)}, "the clock of LC stepped 2 times"),
    ],
)
def test_each_limit_by_itself_makes_it_none(measured: dict[str, Any], said: str) -> None:
    assert figures(**{**KEPT, **measured}).shortfalls() == (said,)


def test_all_of_them_are_one_sentence(golden: Golden) -> None:
    found = figures(physics=TaskMissCount("", 100, 36), stalls=3, stalled_s=24.7, longest_stall_s=9.0).shortfalls()
    golden("text", not_real_time(found), "3 times", "24.7 s", "9.0 s", "36 %")
    assert LIMITS.clock_steps == 0


SECOND = 1_000_000_000


@pytest.mark.parametrize(
    ("limit", "beyond"),
    [
        ({"physics": TaskMissCount("P", 1000, 50)}, {"physics": TaskMissCount("P", 1000, 51)}),
        ({"control": TaskMissCount("C", 1000, 20)}, {"control": TaskMissCount("C", 1000, 21)}),
        ({"link": LinkLosses("L", 1000, 10)}, {"link": LinkLosses("L", 1000, 11)}),
        ({"stalls": 2, "longest_stall_s": 0.25}, {"stalls": 2, "longest_stall_s": 0.251}),
        ({"stalls": 2, "stalled_s": 1.0}, {"stalls": 2, "stalled_s": 1.01}),  # of 100 s
        ({"slipped_s": 1.0}, {"slipped_s": 1.01}),
        ({"slipped_s": 0.9, "stalled_s": 0.9}, {"slipped_s": 1.1, "stalled_s": 0.9}),
        ({"stood_s": 1.0}, {"stood_s": 1.01}),
        ({"physics": TaskMissCount("P", 0, 9), "link": LinkLosses("L", 0, 9)}, {"clock_steps": (("LC", 1),)}),
    ],
)
def test_a_limit_is_kept_at_its_value_and_not_beyond(limit: dict[str, Any], beyond: dict[str, Any]) -> None:
    assert figures(**limit).shortfalls() == ()
    assert len(figures(**beyond).shortfalls()) == 1


def test_a_stall_that_was_not_made_up_is_told_once() -> None:
    """The host fell behind because it stalled."""
    assert len(figures(stalls=1, stalled_s=5.0, longest_stall_s=5.0, slipped_s=4.9).shortfalls()) == 1
    assert len(figures(stalls=1, stalled_s=5.0, longest_stall_s=5.0, slipped_s=5.1).shortfalls()) == 2


def pace(**last: Any) -> MadeTable:
    columns = {"stalls": 0.0, "stalled_s": 0.0, "longest_stall_s": 0.0, "slipped_s": 0.0} | last
    return MadeTable("/pace", SECOND * np.array([1, 51]), {name: [0.0, value] for name, value in columns.items()})


def recording(*tables: MadeTable, **of: Any) -> MadeLog:
    rest = MadeTable("/truth/state", [1 * SECOND, 51 * SECOND], {"a": [0, 0]})
    return MadeLog(*tables, rest, kind="mcap", base="simulation", **of)


def recorded_tasks(*rows: tuple[str, str, int, int, int]) -> MadeTable:
    node, task, cycles, missed, skipped = (np.array(each) for each in zip(*rows, strict=True))
    columns = {"node": node, "task": task, "cycles": cycles, "missed": missed, "skipped": skipped}
    return MadeTable("/tasks", SECOND * np.arange(len(rows)), columns | {"rate_hz": np.full(len(rows), 50.0)})


TASKS = recorded_tasks(
    ("PS1", "physics", 20_000, 500, 0), ("LC", "control", 970, 30, 30), ("LC", "log", 90, 2, 0),
    ("HC", "slow", 10, 9, 0),
)  # fmt: skip
LINKS = MadeTable(
    "/links",
    SECOND * np.arange(6),
    {
        "name": np.array(["sensors", "outputs", "empty", "open", "sensors", "outputs"]),
        "sent": [10, 10, 0, 100, 5000, 1000], "lost": [1, 1, 0, -1, 60, 12], "impaired": [0, 0, 0, 0, 40, 5],
    },
)  # fmt: skip
CLOCKS = MadeTable(
    "/clocks",
    SECOND * np.array([1, 1, 1, 51, 51, 51]),
    {
        "node": np.array(["PS1", "LC", "HC"] * 2), "steps": [0, 0, 0, 7, 2, 0],
        "host_ns": SECOND * np.array([100, 900, 0, 160, 0, 0]),
    },
)  # fmt: skip


def test_the_figures_of_a_recording_are_its_last_counts() -> None:
    found = measured(recording(pace(stalls=3, stalled_s=0.3, longest_stall_s=0.2, slipped_s=0.1), TASKS, LINKS, CLOCKS))
    assert found == RealTimeFigures(
        length_s=pytest.approx(60.0),  # by the host's clock
        physics=TaskMissCount("PS1 physics", 20_000, 500),
        control=TaskMissCount("LC control", 1000, 30),  # with those that it skipped; not the companion
        link=LinkLosses("outputs", 1000, 7),  # without those of a fault
        stalls=3, stalled_s=0.3, longest_stall_s=0.2, slipped_s=0.1, clock_steps=(("LC", 2),),
    )  # fmt: skip


def test_without_its_clock_a_run_is_as_long_as_its_simulation_and_the_time_it_was_held() -> None:
    found = measured(recording(pace(slipped_s=2.5)))
    assert found == RealTimeFigures(length_s=pytest.approx(52.5), slipped_s=2.5)
    one_reading = MadeTable("/clocks", [SECOND], {"node": ["PS1"], "host_ns": [5], "steps": [0]})
    found = measured(recording(pace(slipped_s=np.nan, stalls=-1.0), one_reading))
    assert found == RealTimeFigures(length_s=pytest.approx(50.0))
    assert measured(recording()) is None
    assert measured(recording(MadeTable("/pace", np.array([], int), {"stalls": []}))) is None


def test_a_fault_of_the_agent_spares_its_tasks_and_clock(tmp_path: Path) -> None:
    (tmp_path / "profile.yaml").write_text("faults: {busy: {agent: {cpu_load: 0.5}}, cut: {link: {cut: true}}}")
    for name, spared in (("busy", True), ("cut", False)):
        fault = MadeTable("/faults", [SECOND], {"fault": [name], "active": [1]})
        found = measured(recording(pace(), TASKS, CLOCKS, fault, path=str(tmp_path / "run.mcap")))
        assert found is not None
        assert (found.control is None, found.clock_steps == ()) == (spared, spared)
        assert found.physics is not None


def test_a_section_on_real_time_has_each_figure_with_its_evidence() -> None:
    section = analyse(
        recording(pace(stalls=2, stalled_s=1.5, longest_stall_s=1.2345, slipped_s=0.1), TASKS, LINKS, CLOCKS)
    )
    assert section is not None
    (finding,) = section.findings
    assert finding.sentence == (
        "not a real-time run: the host stalled 2 times, 1.5 s in all, the longest 1.2 s; "
        "3.0 % of the agent's cycles missed (LC control: 30 of 1000); the clock of LC stepped 2 times"
    )
    assert finding.evidence == (
        Evidence("/pace", "stalled_s", value="1.50 s"),
        Evidence("/tasks", "missed", value="500 of 20000"),
        Evidence("/tasks", "missed", value="LC control 30 of 1000"),
        Evidence("/links", "lost", value="outputs 7"),
        Evidence("/clocks", "steps", value="LC 2"),
    )
    assert {fact.key: fact.value for fact in section.facts} == {
        "physics_missed": 2.5, "agent_missed": 3.0, "lost": 0.7, "stalls": 2, "stalled_s": 1.5,
        "longest_stall_s": 1.234, "slipped_s": 0.1,
    }  # fmt: skip


def test_a_run_that_kept_real_time_says_so() -> None:
    section = analyse(recording(pace()))
    assert section is not None
    assert [(one.key, one.severity) for one in section.findings] == [("real_time.kept", Severity.OK)]
    assert [fact.key for fact in section.facts] == ["stalls", "stalled_s", "longest_stall_s", "slipped_s"]


@pytest.mark.realtime
def test_a_recording_says_what_its_summary_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The host is held up for 0.4 s, which it makes up for."""
    exchange, held = IdealControl.exchange, []

    def holds_up(self: IdealControl, step: Any) -> None:
        exchange(self, step)
        if not held:
            held.append(step)
            let_pass(0.4)

    monkeypatch.setattr(IdealControl, "exchange", holds_up)
    result = xitl.simulate("mitl", overrides={"clock.mode": "realtime"}, duration_s=1.0, out=tmp_path / "run")
    assert not result.completed
    assert result.verdict["real_time"] is False
    assert 0.4 <= result.verdict["longest_stall_s"] < 0.6
    with result.open_log() as log:
        found = analyse(log)
    assert found is not None
    (finding,) = found.findings
    assert (finding.key, finding.severity) == ("real_time.not_kept", Severity.CRITICAL)
    assert finding.sentence.startswith("not a real-time run: the host stalled once, 0.4")
    assert finding.sentence == result.summary["warnings"][-1]


@pytest.mark.medium
def test_a_recording_in_lockstep_is_not_judged(tmp_path: Path) -> None:
    result = xitl.simulate("mitl", duration_s=0.1, out=tmp_path / "run")
    assert result.verdict["real_time"] is None
    with result.open_log() as log:
        assert analyse(log) is None
