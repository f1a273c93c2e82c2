"""A companion in a run: it dies and the run goes on; it is none and the run says so."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from tests.child_processes import child_processes
from tests.golden import Golden
from xitl_cli.commands.sim_report import perception_rows
from xitl_cli.errors import UserError
from xitl_cli.profile import load_profile
from xitl_cli.run.nodes import companion as line
from xitl_cli.run.nodes.display import NoDisplay, RunStatus
from xitl_cli.run.session import INCOMPLETE, run

PROFILE = """\
extends: sitl
companion: {{runs: {runs}, link: "{link}", silent_s: 2.0}}
clock: {{mode: {clock}, duration_s: 4.0}}
"""


def profile(folder: Path, runs: str = "process", link: str = "tcp://127.0.0.1:0", clock: str = "lockstep") -> Any:
    file = folder / "boat.yaml"
    file.write_text(PROFILE.format(runs=runs, link=link, clock=clock))
    return load_profile(str(file))


class Killer(NoDisplay):
    """Kills the companion's process when a second has gone by."""

    def __init__(self) -> None:
        self.companion: int | None = None

    def due(self) -> bool:
        return True

    def show(self, status: RunStatus) -> None:
        if status.sim_s > 1.0 and self.companion is not None:
            os.kill(self.companion, signal.SIGKILL)
            self.companion = None


def log_of(folder: Path) -> str:
    with (folder / "run.mcap").open("rb") as file:
        return "\n".join(m.data.decode("latin-1") for _, _, m in make_reader(file).iter_messages(topics=["/log"]))


@pytest.mark.slow
@pytest.mark.parametrize(("clock", "link"), [("lockstep", "tcp://127.0.0.1:0"), ("realtime", "udp://127.0.0.1:0")])
def test_one_that_dies_is_told_and_the_run_goes_on(
    clock: str, link: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    killer = Killer()
    opened = line.open_peer

    def noted(*arguments: Any) -> Any:
        others = child_processes()
        peer = opened(*arguments)
        (killer.companion,) = child_processes() - others
        return peer

    monkeypatch.setattr(line, "open_peer", noted)
    loaded = profile(tmp_path, clock=clock, link=link)
    result = run(loaded, tmp_path / "out", False, lambda: killer)
    assert result.exit_code == INCOMPLETE  # four seconds are no mission
    assert (result.summary["ended"], result.summary["error"]) == ("duration reached", None)
    assert result.summary["duration_s"] == pytest.approx(4.0)
    assert 1.0 < result.summary["companion"]["gone_s"] < 4.0
    told = [
        text for text in result.summary["companion"]["warnings"] if "the run continues without its companion" in text
    ]
    assert len(told) == 1
    assert told[0] in [text for _, text in perception_rows(result.summary)]
    assert "the run continues without its companion" in log_of(tmp_path / "out")
    assert json.loads((tmp_path / "out" / "summary.json").read_text()) == result.summary


@pytest.mark.medium
def test_an_autopilot_in_its_place_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, golden: Golden) -> None:
    opened = line.open_peer

    def autopilot(runs: str, link: str | None, options: Any) -> Any:
        return opened(runs, link, type(options)())

    monkeypatch.setattr(line, "open_peer", autopilot)
    with pytest.raises(UserError) as refused:
        run(profile(tmp_path, runs="in-process"), tmp_path / "out", False, NoDisplay)
    golden("error", refused.value)
    assert not (tmp_path / "out").exists()


def test_a_setting_that_does_not_exist_is_found_before_the_run(tmp_path: Path) -> None:
    file = tmp_path / "boat.yaml"
    file.write_text("extends: sitl\ncompanion: {parameters: {AVD_MARGEN: 3.0}}")
    with pytest.raises(UserError, match="AVD_MARGEN is not a setting of a companion"):
        load_profile(str(file))


@pytest.mark.parametrize(
    ("companion", "said"),
    [
        ("{runs: process}", "companion.link is missing with companion.runs = process"),
        ("{runs: board}", "add one such as udp://192.168.55.1:14661"),
        ("{runs: process, link: 'serial://pty?baud=921600'}", "is too slow for the clouds of sensors.lidar"),
        ("{runs: process, link: nowhere}", "is not a link"),
    ],
)
def test_links_that_cannot_be(companion: str, said: str, tmp_path: Path) -> None:
    file = tmp_path / "boat.yaml"
    file.write_text(f"extends: [sitl, sensors/perception]\ncompanion: {companion}")
    with pytest.raises(UserError, match=said):
        load_profile(str(file))


def test_a_companion_with_nobody_to_serve(tmp_path: Path) -> None:
    file = tmp_path / "boat.yaml"
    file.write_text("extends: mitl\ncompanion: {runs: in-process}")
    with pytest.raises(UserError, match="needs an autopilot to command"):
        load_profile(str(file))
