"""A run that somebody played with, and the same again from its recording."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import differences, payloads

from xitl_cli.logs import open_log
from xitl_cli.plugins.view.recording import open_scene
from xitl_cli.profile import load_profile
from xitl_cli.run.nodes.display import NoDisplay
from xitl_cli.run.nodes.operator import OperatorNode
from xitl_cli.run.operator.operation import Operation, read_events
from xitl_cli.run.session import run

SECONDS = 24.0


class Player:
    """Asks for each action when simulation time, looked at as often as the run listens, has passed its instant."""

    def __init__(self, *acts: tuple[float, dict[str, Any]]) -> None:
        self.refused: list[str] = []
        self.stood = 0
        self._acts = list(acts)

    def __call__(self, operator: OperatorNode) -> None:
        self._operator = operator
        operator.listen(self._look)

    def _look(self) -> None:
        operator = self._operator
        if operator.paused:
            self.stood += 1
            if self.stood == 3:
                self._ask({"action": "step", "seconds": 0.05})
            if self.stood == 9:
                self._ask({"action": "resume"})
            return
        while self._acts and self._acts[0][0] * 1e9 <= operator.now_ns:
            self._ask(self._acts.pop(0)[1])

    def _ask(self, action: dict[str, Any]) -> None:
        refusal = self._operator.ask(action, "view")
        if refusal is not None:
            self.refused.append(refusal)


@pytest.mark.slow
def test_a_run_that_was_played_with_repeats_byte_for_byte(tmp_path: Path) -> None:
    profile = load_profile("sitl", [f"clock.duration_s={SECONDS}"])
    start = profile.runnable().mission.start
    player = Player(
        (0.0, {"action": "launch", "kind": "trunk", "north_m": start.north_m, "east_m": start.east_m}),
        (2.0, {"action": "wind", "mean_mps": 7, "direction_deg": 80}),
        (3.0, {"action": "launch", "kind": "trunk", "north_m": 14.0, "east_m": 20.0}),
        (4.0, {"action": "waves", "spectrum": "jonswap", "significant_height_m": 0.2}),
        (5.0, {"action": "pause"}),
        (6.0, {"action": "current", "speed_mps": 0.4, "direction_deg": 200}),
        (7.0, {"action": "link", "loss": 0.3}),
        (8.0, {"action": "link"}),
        (9.0, {"action": "fault", "name": "gnss-bias"}),
        (10.0, {"action": "fault", "name": "gnss-bias", "on": False}),
        (12.5, {"action": "goto", "north_m": 10.0, "east_m": -5.0}),
        (15.0, {"action": "mission", "do": "replace", "waypoints_ned_m": [[20.0, 0.0]]}),
        (17.0, {"action": "mission", "do": "start"}),
        (18.0, {"action": "velocity", "speed_mps": 1.0, "turn_rate_radps": 0.1}),
        (20.0, {"action": "mode", "mode": "HOLD"}),
        (21.0, {"action": "arm", "armed": False}),
        (22.0, {"action": "mode", "mode": "FLY"}),
    )
    played = run(profile, tmp_path / "played", False, NoDisplay, operation=Operation(people=(player,)))
    assert [text.split(";")[0] for text in player.refused] == [
        f"launch: a vessel is at {start.north_m:.1f} N {start.east_m:.1f} E",
        "mode = 'FLY' is no mode of this autopilot",
    ]
    events = read_events(played.directory)
    again = run(profile, tmp_path / "again", False, NoDisplay, operation=Operation(events=events))
    one, other = payloads(played.recording), payloads(again.recording)
    assert one.keys() == other.keys()
    assert differences(one, other) == {}

    counts = played.summary["operator"]
    assert counts["refused"] == 2
    assert sum(counts["actions"].values()) == 17
    assert counts["silences"] == 1
    assert again.summary["operator"] == {**counts, "refused": 0, "replayed": 17}
    assert played.summary["debris"]["by"] == {"trunk": 1}
    faults = {fault["name"]: fault for fault in played.summary["faults"]}
    assert faults["link to agent"]["did"]["frames_lost_to_agent"] > 0
    assert faults["gnss-bias"]["did"] == {"gnss_biased": 5}
    # What a replay draws is the sea that the vessel was in, before and after its changes.
    with open_scene([played.recording]) as recording, open_log(played.recording) as log:
        told = log["/environment"]
        for row in np.searchsorted(told.stamp_ns, (3e9, 12e9, 20e9)).tolist():
            at_s = float(told.stamp_ns[row] * 1e-9)
            instant = recording.instant(at_s)
            assert instant.waves is not None
            here_m = float(instant.waves.elevation_m(at_s, instant.vessels[""].position_enu_m[:2]))
            assert here_m == pytest.approx(float(told["surface_elevation_m"][row]), abs=1e-6)
    # It has obeyed: went to GUIDED on the way to the place, sailed another mission, held, and was disarmed.
    said = " ".join(str(payload) for _, payload in one["/log"])
    assert all(word in said for word in ("Mode GUIDED", "Mode HOLD", "Disarmed", "disarm: accepted"))
    assert all(word in said for word in ("replace the mission: accepted", "Mode AUTO", "velocity: in GUIDED"))
    # A second after the velocity nobody had repeated it: outputs are neutral until the mode that is asked for then.
    with open_log(played.recording) as log:
        outputs = log["/actuators"]
        first, last = np.searchsorted(outputs.stamp_ns, (19.2e9, 20e9)).tolist()
        assert np.all(outputs["command"][first:last] == 0.0)


@pytest.mark.slow
def test_a_run_that_nobody_plays_with_is_as_it_is_without_an_operator(tmp_path: Path) -> None:
    profile = load_profile("sitl", ["clock.duration_s=5.0"])
    alone = run(profile, tmp_path / "alone", False, NoDisplay)
    watched = run(profile, tmp_path / "watched", False, NoDisplay, operation=Operation(people=(Player(),)))
    assert payloads(alone.recording) == payloads(watched.recording)
