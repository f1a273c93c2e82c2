"""What a person sees while a run goes on."""

from __future__ import annotations

import io
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from rich.console import Console

from xitl_cli.profile.schema.profile import ClockSpec
from xitl_cli.record.recorder import Recorder
from xitl_cli.run.nodes.display import DisplayNode, LiveDisplay, PlainDisplay, RunStatus


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
