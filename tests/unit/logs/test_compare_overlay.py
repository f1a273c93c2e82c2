"""Analyses and events of two logs, side by side."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from made_log import MadeLog, MadeTable
from made_vessel import vessel

from xitl_cli.logs.compare.comparison import channel_section, compare, overlay
from xitl_cli.logs.compare.pairing import event_section, pair_logs
from xitl_cli.logs.compare.trajectories import off_path_m, thinned_path
from xitl_cli.logs.model.analysis import LogAnalysis
from xitl_cli.logs.model.sections import Fact, Plot, Section, Trace


def scheduler(sections: Mapping[str, Section | None]) -> LogAnalysis:
    return LogAnalysis("scheduler", lambda log: sections[log.path.name])


def loops(longest: float | None, board: str, further: tuple[Fact, ...] = ()) -> Section:
    lines = (Trace("longest", np.array([0, 10**9]), np.array([1.0, 2.0])),)
    return Section(
        "scheduler",
        "Scheduler",
        (Fact("longest_us", "Longest", longest, "us"), Fact("board", "Board", board), *further),
        plots=(Plot("longest", "Longest", "us", lines),),
        lacks=("no Load.",),
    )


def test_facts_and_plots_of_both_stand_side_by_side() -> None:
    a, b = vessel("a"), vessel("b")
    sections = {
        "a.bin": loops(20.0, "black"),
        "b.bin": loops(25.5, "blue", (Fact("misses", "Misses", 3),)),
    }
    missed = Plot("misses", "Misses", "ms", (Trace("misses", np.array([0]), np.array([4.0]), "points"),))
    sections["b.bin"] = replace(sections["b.bin"], plots=(*sections["b.bin"].plots, missed))
    found = overlay(scheduler(sections), a, b, pair_logs(a, b, shift_s=2.0))
    assert found is not None
    assert {grid.key: grid.rows for grid in found.grids} == {
        "scheduler.both": (("Longest", "us", 20.0, 25.5, 5.5),),
        "scheduler.alone": (("Misses", "", None, 3),),
    }
    assert found.facts == (Fact("board", "Board", "A: black; B: blue"),)
    (plot, alone) = found.plots
    assert [trace.name for trace in alone.traces] == ["B · misses"]
    assert alone.traces[0].x.tolist() == [2 * 10**9]
    assert [trace.name for trace in plot.traces] == ["A · longest", "B · longest"]
    assert plot.traces[1].x.tolist() == [2 * 10**9, 3 * 10**9]
    assert found.lacks == ("A: no Load.", "B: no Load.")


def test_what_can_be_judged_of_one_alone_is_said() -> None:
    a, b = vessel("a"), vessel("b")
    found = overlay(scheduler({"a.bin": None, "b.bin": loops(1.0, "blue")}), a, b, pair_logs(a, b, shift_s=0.0))
    assert found is not None
    assert found.lacks == ("Scheduler can be judged for B only.",)
    assert overlay(scheduler({"a.bin": None, "b.bin": None}), a, b, pair_logs(a, b, shift_s=0.0)) is None


def rc_out(**channels: list[float]) -> MadeTable:
    return MadeTable(
        "RCOU", (5 + np.arange(20)) * 10**9, {name: np.resize(each, 20) for name, each in channels.items()}
    )


def test_channels_that_nothing_moves_are_one_line() -> None:
    still = {f"C{channel}": [1500.0] for channel in (2, 3, 4, 6)}
    a = vessel("a", further=(rc_out(C1=[1500.0, 1600.0], C5=[1500.0], C9=[1100.0], **still),))
    b = vessel("b", further=(rc_out(C1=[1500.0, 1620.0], C5=[1510.0], C8=[1100.0], **still),))
    found = channel_section(a, b, pair_logs(a, b, shift_s=0.0))
    assert found is not None
    assert [fact.value for fact in found.facts] == ["2 to 4, 6"]
    rows = {str(row[0]): row for row in found.grids[0].rows}
    assert sorted(rows) == ["output 1", "output 5"]
    assert rows["output 5"][3:6] == (10.0, 10.0, 10.0)  # held at another value: RMS, most, mean
    assert found.lacks == ("Output 9 is in A alone.", "Output 8 is in B alone.")


def test_the_nth_event_of_a_kind_is_beside_the_nth() -> None:
    def said(*texts: tuple[float, str]) -> MadeTable:
        return MadeTable(
            "STATUSTEXT", [round((5.0 + at) * 1e9) for at, _ in texts], {"text": [text for _, text in texts]}
        )

    a = vessel("a", armed_s=2.0, further=(said((10.0, "Reached waypoint #1"), (20.0, "Reached waypoint #1")),))
    b = vessel("b", armed_s=2.5, further=(said((11.0, "Reached waypoint 1"), (30.0, "Mission Complete")),))
    laid = pair_logs(a, b, "armed")
    found = event_section(a, b, laid, 0 if laid.zero_ns is None else laid.zero_ns)
    assert found is not None
    assert found.grids[0].rows == (
        ("armed", 0.0, 0.0, 0.0),
        ("waypoint 1 reached", 8.0, 8.5, 0.5),
        ("waypoint 1 reached", 18.0, None, None),
        ("mission complete", None, 27.5, None),
    )


def test_a_mode_that_heartbeats_tell_began_when_it_was_said() -> None:
    stamps = (5 + np.arange(20)) * 10**9
    beats = MadeTable(
        "HEARTBEAT",
        stamps,
        {
            "autopilot": np.full(20, 3),
            "type": np.full(20, 11),
            "base_mode": np.where(np.arange(20) < 4, 1, 129),
            "custom_mode": np.where(np.arange(20) < 8, 0, 10),
        },
    )
    texts = MadeTable("STATUSTEXT", [12_200_000_000], {"text": ["Mode AUTO"]})
    log = MadeLog(beats, texts, kind="tlog", base="utc", path="/made/a.tlog")
    assert pair_logs(log, vessel("b", armed_s=3.0, auto_s=6.0), "mission").zero_ns == 12_200_000_000


def test_the_distance_from_a_path_is_that_from_its_line() -> None:
    path = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0]])
    points = np.array([[5.0, 2.0], [13.0, 5.0], [-3.0, -4.0], [10.0, 10.0]])
    assert off_path_m(points, path) == pytest.approx([2.0, 3.0, 5.0, 0.0])
    assert off_path_m(points, path[:1]) == pytest.approx(np.hypot(*points.T))


def test_a_vessel_at_rest_adds_no_points_to_a_path() -> None:
    away = np.stack([np.arange(101.0), np.zeros(101)], axis=1)
    path = np.concatenate([np.zeros((1000, 2)), away, np.repeat(away[-1:], 1000, axis=0)])
    found = thinned_path(path)
    assert len(found) <= 102
    assert found[0].tolist() == [0.0, 0.0]
    assert found[-1].tolist() == [100.0, 0.0]
    assert len(thinned_path(np.zeros((50, 2)))) == 1


def test_heights_far_apart_are_a_notice() -> None:
    a, b = vessel("a"), vessel("b")
    table = b.tables["POS"]
    values = {name: table.values(name) + (30.0 if name == "Alt" else 0.0) for name in table.columns}
    b.tables["POS"] = MadeTable("POS", table.stamp_ns, values)
    found = compare(a, b, shift_s=0.0)
    (notice,) = [each for each in found.sections[0].findings if each.key == "trajectory.heights"]
    assert "30.0 m" in notice.sentence
    assert "--armed" in notice.next_step
