"""Actions as they are read: names, keys and bounds, each refusal a sentence; and files of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from sim_core.environment.spec import WindSpec
from xitl_cli.errors import UserError
from xitl_cli.run.operator.actions import ActionError, ImpairLink, read_action
from xitl_cli.run.operator.operation import TimedAction, read_events


@pytest.mark.parametrize(
    ("action", "problem"),
    [
        (3, "is a JSON object"),
        ({"action": "wnd"}, "did you mean 'wind'"),
        ({"action": ["wind"]}, "is not one"),
        ({"action": "wind"}, "changes nothing"),
        ({"action": "wind", "mean": 6}, "did you mean 'mean_mps'"),
        ({"action": "wind", "mean_mps": 200}, "mean_mps = 200 is too large; use a value of at most 100 in m/s"),
        ({"action": "wind", "gust": {"spectrum": "npd"}}, "does not fit the gust spectrum npd"),
        (
            {"action": "launch", "kind": "tree", "north_m": 1, "east_m": 2},
            "use trunk, branch, plants, animal, plank or plastic",
        ),
        ({"action": "launch", "north_m": 1}, "needs 'east_m'"),
        ({"action": "goto", "north_m": float("nan"), "east_m": 1}, "is not finite"),
        ({"action": "pace", "factor": 0}, "is too small"),
        ({"action": "velocity", "speed_mps": 1e6, "turn_rate_radps": 0}, "speed_mps = 1000000.0 is too large"),
        ({"action": "velocity", "speed_mps": 1}, "needs 'turn_rate_radps'"),
        ({"action": "motor", "number": 0, "command": 1.5}, "command = 1.5 is too large"),
        ({"action": "mission", "do": "replace"}, "waypoints_ned_m is empty"),
        ({"action": "mission", "waypoints_ned_m": [[1, 2]]}, "is for do: replace alone"),
        ({"action": "mission", "do": "replace", "waypoints_ned_m": [[1e9, 0]]}, "is too large"),
        ({"action": "mission", "do": "replace", "waypoints_ned_m": "here"}, "is not a list"),
        ({"action": "step", "seconds": -1}, "use a value above 0"),
        ({"action": "pause", "now": True}, "it has no keys"),
        ({"action": "arm", "armed": 1}, "write true or false"),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(action: Any, problem: str) -> None:
    with pytest.raises(ActionError, match=problem) as refused:
        read_action(action, WindSpec() if isinstance(action, dict) and action["action"] == "wind" else None)
    assert "\n" not in str(refused.value)


def test_a_key_of_the_environment_leaves_the_others_as_they_are() -> None:
    before = WindSpec(mean_mps=4.0, direction_deg=30.0)
    gusty = read_action({"action": "wind", "gust": {"deviation_mps": 1.0}}, before)
    assert isinstance(gusty, WindSpec)
    assert (gusty.mean_mps, gusty.direction_deg, gusty.gust.deviation_mps) == (4.0, 30.0, 1.0)


def test_a_link_without_faults_is_a_good_one() -> None:
    assert ImpairLink(link="agent", direction="sensors").fault() is None
    cut = ImpairLink(cut=True).fault()
    assert cut is not None
    assert cut.cut


def test_a_file_gives_actions_by_their_instants(tmp_path: Path) -> None:
    file = tmp_path / "played.jsonl"
    file.write_text('{"time_s": 4.5, "action": "resume"}\n\n{"time_s": 2, "action": "pause", "source": "view"}\n')
    assert read_events(file) == (
        TimedAction(2_000_000_000, {"action": "pause"}, "view"),
        TimedAction(4_500_000_000, {"action": "resume"}, "file"),
    )


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("{", r"events\.jsonl:1: no JSON"),
        ('{"action": "pause"}', r"events\.jsonl:1: time_s is missing or invalid"),
        ('{"time_s": true, "action": "pause"}', "time_s is missing or invalid"),
        ('\n{"time_s": 1, "action": "paus"}', r"events\.jsonl:2: .*did you mean 'pause'"),
        ("[]", "time_s is missing or invalid"),
        ("", "contains no actions"),
    ],
)
def test_a_bad_file_is_refused_with_its_line(tmp_path: Path, text: str, problem: str) -> None:
    file = tmp_path / "events.jsonl"
    file.write_text(text)
    with pytest.raises(UserError, match=problem):
        read_events(file)


@pytest.mark.parametrize("name", ["nothing.mcap", "empty"])
def test_a_recording_that_is_not_there_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / "empty").mkdir()
    with pytest.raises(UserError, match="does not exist"):
        read_events(tmp_path / name)


def test_a_file_that_is_no_recording_is_refused(tmp_path: Path) -> None:
    (tmp_path / "run.mcap").write_bytes(b"nothing of the kind" * 20)
    with pytest.raises(UserError, match="cannot be read"):
        read_events(tmp_path)
