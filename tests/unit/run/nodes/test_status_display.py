"""What a person sees while a run goes on."""

from __future__ import annotations

import io
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from rich.console import Console

from xitl_cli.logs import open_log
from xitl_cli.profile.schema.profile import ClockSpec
from xitl_cli.record.recorder import Recorder
from xitl_cli.run.nodes.display import DisplayNode, LiveDisplay, PlainDisplay, RunStatus, StallWarnings


def status(**values: object) -> RunStatus:
    known = {
        "sim_s": 12.3, "duration_s": 60.0, "mode": "AUTO", "armed": True, "waypoints_reached": 1, "waypoints_total": 6,
        "speed_mps": 3.0, "heading_deg": 45.0, "cross_track_m": 0.5, "position_error_m": None, "current_mps": 0.0,
        "wind_mps": 0.0, "motors": (0.1, 0.2),
    }  # fmt: skip
    return RunStatus(**{**known, **values})  # type: ignore[arg-type]


@pytest.mark.parametrize("live", [False, True])
def test_faults_in_force_are_named_as_they_are_written(live: bool) -> None:
    console = Console(width=80, file=io.StringIO(), force_terminal=live, color_system=None, record=True)
    view = LiveDisplay(console, "x") if live else PlainDisplay(console)
    view.show(status(faults=("link-cut", "[bold]odd")))
    view.close()
    assert "fault" in console.file.getvalue()  # type: ignore[attr-defined]
    assert "link-cut, [bold]odd" in console.file.getvalue()  # type: ignore[attr-defined]


def test_without_faults_there_is_nothing_about_them() -> None:
    console = Console(width=200, file=io.StringIO())
    PlainDisplay(console).show(status())
    assert "fault" not in console.file.getvalue()  # type: ignore[attr-defined]


def test_a_warning_stays_to_be_read_in_one_line() -> None:
    for view_of in (PlainDisplay, lambda console: LiveDisplay(console, "sitl")):
        stream = io.StringIO()
        view = view_of(Console(file=stream, width=40))
        view.warn("the mesh [huge] is 4000 m across; if it is in millimetres, give it scale: 0.001")
        view.close()
        assert "warning: the mesh [huge] is 4000 m across; if it is in millimetres, give it scale: 0.001\n" in (
            stream.getvalue()
        )


def test_a_warning_of_the_run_is_shown_when_it_occurs(tmp_path: Path) -> None:
    stream = io.StringIO()
    node = DisplayNode(lambda: PlainDisplay(Console(file=stream, width=80)), ["the hull is long"], ClockSpec(), [])
    recorder = Recorder(tmp_path / "run.mcap", "lz4")
    context: Any = SimpleNamespace(recorder=recorder, pace=None)
    node.begin(context)
    recorder.log(1, 4, "run", "no motor commands from the agent for 0.5 s")
    recorder.log(2, 5, "run", "the agent commands again after 0.70 s")
    recorder.log(3, 4, "autopilot", "PreArm: no position")
    recorder.log(4, 3, "run", "the agent was killed")
    recorder.close()
    assert stream.getvalue() == ("warning: the hull is long\nwarning: no motor commands from the agent for 0.5 s\n")


def stall_warnings(stalls: list[tuple[float, float]], until_s: float) -> list[tuple[float, str]]:
    """Return the warnings with their times. stalls: time and length. The display is polled ten times a second."""
    shown: list[tuple[float, str]] = []
    now_s = [0.0]
    warnings = StallWarnings(lambda text: shown.append((now_s[0], text)), lambda: now_s[0])
    waiting = list(stalls)
    for tenth in range(round(10.0 * until_s) + 1):
        now_s[0] = tenth / 10.0
        if waiting and waiting[0][0] <= now_s[0]:
            length_s = waiting.pop(0)[1]
            warnings.add(length_s, f"paused for {length_s:g} s")
        warnings.poll()
    warnings.flush()
    return shown


def test_the_first_stall_is_shown_at_once_and_later_ones_once_a_minute() -> None:
    often = [(float(second), 0.5 + 0.01 * (second % 10)) for second in range(5, 130, 2)]
    assert stall_warnings(often, 130.0) == [
        (5.0, "paused for 0.55 s"),
        (65.0, "29 more stalls in the last 60 s, the worst 0.59 s"),
        (125.0, "30 more stalls in the last 60 s, the worst 0.59 s"),
        (130.0, "3 more stalls in the last 5 s, the worst 0.59 s"),
    ]


def test_rare_stalls_are_all_shown_when_they_occur() -> None:
    assert stall_warnings([(10.0, 0.6), (80.0, 1.2), (200.0, 0.7)], 300.0) == [
        (10.0, "paused for 0.6 s"), (80.0, "paused for 1.2 s"), (200.0, "paused for 0.7 s")
    ]  # fmt: skip


def test_one_more_stall_is_shown_although_no_other_follows() -> None:
    assert stall_warnings([(10.0, 0.6), (12.0, 1.2)], 100.0) == [
        (10.0, "paused for 0.6 s"), (70.0, "1 more stall in the last 60 s, the worst 1.20 s")
    ]  # fmt: skip


def test_all_stalls_are_in_the_recording_and_few_at_the_terminal(tmp_path: Path) -> None:
    stream = io.StringIO()
    node = DisplayNode(lambda: PlainDisplay(Console(file=stream, width=80)), [], ClockSpec(), [])
    recorder = Recorder(tmp_path / "run.mcap", "lz4")
    context: Any = SimpleNamespace(recorder=recorder, pace=SimpleNamespace(slip_s=0.6))
    node.begin(context)
    for number in range(5):
        recorder.log(number, 4, "pace", f"the world paused (pause {number})")
    node.close()
    recorder.close()
    first, second = stream.getvalue().splitlines()
    assert first == "warning: the world paused (pause 0)"
    assert second == "warning: 4 more stalls in the last 0 s, the worst 0.60 s"
    with open_log(tmp_path / "run.mcap") as log:
        assert list(log["/log"]["message"]) == [f"the world paused (pause {number})" for number in range(5)]
