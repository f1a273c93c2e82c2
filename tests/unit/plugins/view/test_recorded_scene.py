"""What else a run records and a replay shows: missions, debris, seas, events, findings and vessels without a log."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from eastward_run import run_file

from sim_core.frames import euler_to_quat, quat_to_matrix
from sim_core.geodesy import LocalFrame
from sim_core.kinematics import Kinematics
from tests.unit.logs.made_log import MadeLog, MadeTable
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.sections import Severity
from xitl_cli.plugins.view import recording as recordings
from xitl_cli.plugins.view.model import SceneWaves
from xitl_cli.plugins.view.recording import LogScene, SceneFinding, open_scene, scene_of
from xitl_cli.plugins.view.scene import NO_WAVES
from xitl_cli.plugins.view.tracks import HeldValues, MapPlace
from xitl_cli.profile import load_profile
from xitl_cli.profile.resolved import resolved_yaml
from xitl_cli.record.recorder import Recorder
from xitl_cli.record.topics import OperatorAction, SeaComponents
from xitl_cli.registry import PluginError
from xitl_cli.run.world.scene import make_scene
from xitl_cli.scenery import Scenery

S = 1_000_000_000
LEVEL_NED = euler_to_quat(np.zeros((1, 3)))


def seconds(stamp_ns: np.ndarray) -> np.ndarray:
    return np.asarray(stamp_ns) * 1e-9


def sea(amplitude_m: float) -> SeaComponents:
    return SeaComponents(*[np.array([value]) for value in (amplitude_m, 0.1, 0.2, 1.5, 0.25)])  # type: ignore[arg-type]


def add_the_rest(recorder: Recorder) -> None:
    """The surroundings of the profile sitl, debris, a sea, texts, a contact and an action."""
    profile = load_profile("sitl")
    recorder.attach("profile.yaml", "application/yaml", resolved_yaml(profile).encode())
    profile = profile.runnable()
    recorder.scene(make_scene([profile], Scenery(profile)))
    zero = np.zeros((2, 3))
    for second in (3, 5):
        place = np.array([[10.0 * second, 5.0, 0.0], [1.0, 2.0, 0.0]])
        recorder.perception.bodies(
            second * S, ["trunk", "trunk"], np.array([2.0, 3.0]), place, np.tile(LEVEL_NED, (2, 1)), zero
        )
    recorder.write(4 * S, sea(0.5))
    recorder.write(8 * S, sea(0.75))
    recorder.log(6 * S, 3, "agent", " engine failed ")
    recorder.perception.contact(7 * S, "trunk 0", np.zeros(3), 100.0, 0.5, began=True)
    recorder.perception.contact(7 * S + S // 10, "trunk 0", np.zeros(3), 100.0, 0.5, began=False)
    recorder.write(9 * S, OperatorAction('{"action": "wind", "mean_mps": 6}', "view"))
    recorder.perception.contact(30 * S, "after the end", np.zeros(3), 100.0, 0.5, began=True)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run_file(tmp_path_factory.mktemp("run") / "run.mcap", further=add_the_rest)


@pytest.fixture(scope="module")
def recording(run: Path) -> Iterator[LogScene]:
    with open_scene([run]) as scene:
        yield scene


def test_events_of_a_run_are_marks_in_order(recording: LogScene) -> None:
    marks = {mark.text: mark.time_s for mark in recording.marks}
    assert marks["armed"] == 5.0
    assert marks["contact with trunk 0"] == 7.0
    assert marks["by hand: wind mean_mps 6"] == 9.0
    assert "contact with after the end" not in marks
    assert [mark.time_s for mark in recording.marks] == sorted(marks.values())


def test_messages_between_two_instants_are_shown_with_their_severity(recording: LogScene) -> None:
    (event,) = recording.instant(6.0, 5.9).events
    assert (event.time_s, event.severity, event.text) == (6.0, 3, "engine failed")
    assert recording.instant(6.1, 6.0).events == ()
    assert recording.instant(5.99, 5.0).events == ()
    assert recording.instant(6.0).events == ()


def test_debris_is_shown_from_its_first_report_on_and_drifts(recording: LogScene) -> None:
    assert dict(recording.instant(2.99).bodies) == {}
    at_first, between = recording.instant(3.0).bodies, recording.instant(4.0).bodies
    assert sorted(at_first) == [0, 1]
    assert at_first[0].position_enu_m == pytest.approx([5.0, 30.0, 0.0])
    assert between[0].position_enu_m == pytest.approx([5.0, 40.0, 0.0])
    assert between[1].position_enu_m == pytest.approx([2.0, 1.0, 0.0])
    assert between[0].meshes == ()  # no shape of it was recorded


def test_a_sea_holds_until_the_next_one(recording: LogScene) -> None:
    shown = [recording.instant(time_s).waves for time_s in (3.9, 4.0, 7.9, 8.0)]
    assert all(waves is not None for waves in shown)
    before, first, same, second = cast(list[SceneWaves], shown)
    assert first.amplitude_m.tolist() == [0.5]
    assert first.wave_vector_en_radpm.tolist() == [[0.2, 0.1]]
    assert (first.angular_frequency_radps.tolist(), first.phase_rad.tolist()) == ([1.5], [0.25])
    assert same is first
    assert second.amplitude_m.tolist() == [0.75]
    assert before is recording.scene.water.waves or before is NO_WAVES


def test_the_mission_of_the_profile_is_drawn_in_the_map(recording: LogScene) -> None:
    mission = recording.scene.vessels[""].mission_enu_m
    assert len(mission) == 1 + len(load_profile("sitl").mission.waypoints_ned_m)
    instant = recording.instant(1.0).vessels[""]
    assert instant.mission_enu_m is not None
    np.testing.assert_array_equal(instant.mission_enu_m, mission)


def test_paths_of_a_scene_are_opened_for_the_use_alone(recording: LogScene, run: Path) -> None:
    with scene_of(recording) as same:
        assert same is recording
    recording.instant(1.0)  # still open
    with scene_of([run]) as own:
        assert own.names == ("",)
        assert [log.path for log in own.logs] == [run]


def finding(key: str, severity: Severity, sentence: str, *at_ns: int | None) -> Any:
    evidence = [SimpleNamespace(at_ns=each) for each in at_ns]
    return SimpleNamespace(key=key, severity=severity, sentence=sentence, next_step="look", evidence=evidence)


def test_the_findings_of_a_report_are_those_of_the_shown_logs_the_worst_first(recording: LogScene, run: Path) -> None:
    entries = [
        (run, finding("a", Severity.NOTICE, "noted", None, 4 * S, 9 * S)),
        (run, finding("b", Severity.OK, "all is well", 1 * S)),
        (run, finding("c", Severity.CRITICAL, "late", 99 * S)),
        (run, finding("c", Severity.CRITICAL, "late", 4 * S)),
        (run, finding("d", Severity.WARNING, "no time")),
        (run.parent / "other.bin", finding("e", Severity.CRITICAL, "of another file", 1 * S)),
    ]
    findings = [SimpleNamespace(file=SimpleNamespace(path=path, vessel=""), finding=each) for path, each in entries]
    assert recording.findings_of(cast(Any, SimpleNamespace(findings=findings))) == [
        SceneFinding(20.0, Severity.CRITICAL, "late", "look"),
        SceneFinding(None, Severity.WARNING, "no time", "look"),
        SceneFinding(4.0, Severity.NOTICE, "noted", "look"),
    ]
    assert recording.lead_second(3 * S) == (run, 3.0)


@pytest.mark.medium
def test_of_several_vessels_each_sentence_names_its_own(tmp_path: Path) -> None:
    paths = [run_file(tmp_path / "a.mcap", further=add_the_rest), run_file(tmp_path / "b.mcap", further=add_the_rest)]
    with open_scene(paths) as scene:
        first, second = scene.names
        texts = {mark.text for mark in scene.marks}
        assert {f"{first}: armed", f"{second}: armed"} <= texts
        findings = [
            SimpleNamespace(file=SimpleNamespace(path=path, vessel=""), finding=finding("a", Severity.NOTICE, "noted"))
            for path in paths
        ]
        found = scene.findings_of(cast(Any, SimpleNamespace(findings=findings)))
        assert [each.sentence for each in found] == [f"{first}: noted", f"{second}: noted"]
        assert {event.text for event in scene.instant(6.0, 5.0).events} == {
            f"{first}: engine failed",
            f"{second}: engine failed",
        }


def test_the_analysis_of_a_replay_reads_its_logs(
    recording: LogScene, run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    analysed: list[tuple[Any, ...]] = []

    def report(logs: list[Path], analyses: object, *, vessel: str) -> Any:
        analysed.append((logs, analyses, vessel))
        file = SimpleNamespace(path=run, vessel="")
        noted = (finding(key, Severity.NOTICE, "noted", 4 * S) for key in "ab")
        return SimpleNamespace(findings=[SimpleNamespace(file=file, finding=each) for each in noted])

    monkeypatch.setattr("xitl_cli.log_analyses.log_analyses", lambda: "all")
    monkeypatch.setattr("xitl_cli.logs.report.build.build_report", report)
    assert recording.findings() == [SceneFinding(4.0, Severity.NOTICE, "noted", "look")] * 2
    assert analysed == [([run], "all", "")]


def test_a_broken_plugin_of_the_analysis_is_a_finding(recording: LogScene, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse() -> None:
        raise PluginError("plug-in x: no module y")

    monkeypatch.setattr("xitl_cli.log_analyses.log_analyses", refuse)
    assert recording.findings() == [
        SceneFinding(None, Severity.NOTICE, "The logs are not analysed", "plug-in x: no module y")
    ]


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The two vessels of a profile, which go north, 5 m apart. The second one begins a second later."""
    path = tmp_path_factory.mktemp("fleet") / "run.mcap"
    profile = load_profile("fleet-head-on")
    profiles = profile.run_profiles()
    lead, other = (one.vessel for one in profiles)
    recorder = Recorder(path, "lz4", vessel=lead)
    recorder.metadata("xitl", {"profile": "made", "vessels": f"{lead}, {other}"})
    recorder.attach("profile.yaml", "application/yaml", resolved_yaml(profile).encode())
    recorder.scene(make_scene(profiles, Scenery(profiles[0])))
    zero = np.zeros((1, 3))
    for begin, east_m, of_vessel in ((0, 0.0, recorder), (1, 5.0, recorder.of_vessel(other))):
        for second in range(begin, 21):
            place = np.array([[float(second), east_m, 0.0]])
            motion = Kinematics(place, zero, zero, LEVEL_NED, quat_to_matrix(LEVEL_NED), zero, zero)
            of_vessel.truth(second * S, motion, np.zeros((1, 2)))
    recorder.close()
    return path


@pytest.mark.medium
def test_all_vessels_of_a_fleet_are_shown_and_each_has_its_own_times(fleet: Path) -> None:
    with open_scene([fleet]) as scene:
        lead, other = scene.names
        assert scene.span_s == (0.0, 20.0)
        places = {name: vessel.position_enu_m for name, vessel in scene.instant(4.5).vessels.items()}
        assert places == {lead: pytest.approx([0.0, 4.5, 0.0]), other: pytest.approx([5.0, 4.5, 0.0])}
        assert scene.instant(0.5).vessels[other].position_enu_m == pytest.approx([5.0, 1.0, 0.0])
        assert scene.scene.title == f"{lead}, {other}"
        assert len(scene.logs) == 1


@pytest.mark.medium
def test_the_other_vessels_are_shown_around_a_chosen_one(fleet: Path) -> None:
    with open_scene([fleet]) as scene:
        lead, other = scene.names
    for name, around in ((lead, other), (other, lead)):
        with open_scene([fleet], name) as scene:
            assert scene.names == (name,)
            assert set(scene.instant(3.0).vessels) == set(scene.scene.vessels) == {lead, other}
            north_m = scene.instant(3.0).vessels[around].position_enu_m[1]
            assert north_m == pytest.approx(3.0)
    with pytest.raises(LogError, match="x"):
        open_scene([fleet], "x")


def test_a_vessel_of_a_run_with_one_vessel_cannot_be_chosen(run: Path) -> None:
    with pytest.raises(LogError, match="boat"):
        open_scene([run], "boat")


def test_a_scene_needs_a_log() -> None:
    with pytest.raises(LogError, match=r"no log; name a \.bin, a \.tlog or an \.mcap"):
        open_scene([])


def test_poses_need_both_columns_and_a_row() -> None:
    values = {"position_ned_m": [[1.0, 2.0, 3.0]] * 3, "quaternion_ned_frd": np.tile(LEVEL_NED, (3, 1))}
    table = MadeTable("/truth/state", [0, 2 * S, 1 * S], values)
    pose = recordings._poses(table, np.arange(3), seconds)
    assert pose is not None
    assert pose.place_s.tolist() == pose.turn_s.tolist() == [0.0, 2.0]  # a time that steps back is left out
    assert pose.position_enu_m.tolist() == [[2.0, 1.0, -3.0]] * 2
    assert recordings._poses(table, np.arange(0), seconds) is None
    for column in values:
        less = MadeTable("/truth/state", [0] * 3, {column: values[column]})
        assert recordings._poses(less, np.arange(3), seconds) is None


def test_a_stream_flows_east_and_north() -> None:
    stream = HeldValues(np.array([1.0]), np.array([[3.0, 4.0, 9.0]]))
    assert recordings._flow(stream, 1.0) == (4.0, 3.0)
    assert recordings._flow(stream, 0.9) == (0.0, 0.0)
    assert recordings._flow(None, 1.0) == (0.0, 0.0)
    assert recordings._flow(HeldValues(np.array([1.0]), np.array([[np.nan, 4.0, 9.0]])), 1.0) == (0.0, 0.0)


def test_shorter_seas_are_padded_in_the_table() -> None:
    nan = np.nan
    columns = {
        "amplitude_m": [[0.5, nan], [0.1, 0.2]],
        "wave_number_north_radpm": [[1.0, nan], [2.0, 3.0]],
        "wave_number_east_radpm": [[4.0, nan], [5.0, 6.0]],
        "angular_frequency_radps": [[7.0, nan], [8.0, 9.0]],
        "phase_rad": [[0.0, nan], [0.5, 0.75]],
    }
    lead = cast(
        Any, SimpleNamespace(seconds=seconds, log=MadeLog(MadeTable("/environment/waves", [S, 2 * S], columns)))
    )
    seas = recordings._seas(lead, None)
    assert seas is not None
    assert seas.at(0.9) is NO_WAVES
    assert seas.at(1.0).wave_vector_en_radpm.tolist() == [[4.0, 1.0]]
    assert seas.at(2.0).wave_vector_en_radpm.tolist() == [[5.0, 2.0], [6.0, 3.0]]
    assert seas.at(2.0).phase_rad.tolist() == [0.5, 0.75]
    del columns["phase_rad"]
    lead.log = MadeLog(MadeTable("/environment/waves", [S, 2 * S], columns))
    assert recordings._seas(lead, None) is None
    lead.log = MadeLog()
    assert recordings._seas(lead, None) is None


def test_missions_of_a_run_are_shifted_into_the_map_of_another(monkeypatch: pytest.MonkeyPatch) -> None:
    own, other = (48.0, 11.0, 500.0), (48.001, 11.0, 500.0)
    entities = [SimpleNamespace(name="/mission", lines_m=(np.array([[1.0, 2.0, 0.0], [3.0, 4.0, 0.0]]),))]
    drawn = ((2 * S, entities), (3 * S, []))
    made = cast(Any, SimpleNamespace(drawn=drawn))
    log = SimpleNamespace(vessel="")
    monkeypatch.setattr(recordings, "_origin", lambda log: own)

    def drawn_in(place: MapPlace) -> Any:
        vessel = SimpleNamespace(log=log, place=place, second=lambda stamp_ns: stamp_ns * 1e-9)
        return recordings._drawn_missions(made, cast(Any, vessel))

    (alone,) = drawn_in(MapPlace(own, (10.0, 20.0, 30.0)))
    assert alone.from_s == 2.0
    assert alone.places_enu_m.tolist() == [[11.0, 22.0, 30.0], [13.0, 24.0, 30.0]]
    (moved,) = drawn_in(MapPlace(other, (10.0, 20.0, 30.0)))
    north_m = float(LocalFrame(*other).ned(np.array([48.0]), np.array([11.0]), np.array([500.0]))[0, 0])
    assert north_m == pytest.approx(-111.2, abs=0.1)  # a thousandth of a degree of latitude
    np.testing.assert_allclose(moved.places_enu_m[:, :2], [[11.0, 22.0 + north_m], [13.0, 24.0 + north_m]], atol=1e-6)
    entities[0].lines_m = (np.array([[1.0, 2.0, 0.0]]),)
    assert drawn_in(MapPlace(own)) == ()  # a start without waypoints


@pytest.mark.parametrize("text", ["[1, 2]", "7", "null", '"a"', "[" * 100_000])
def test_an_action_that_is_no_object_is_shown_as_it_is(text: str) -> None:
    assert recordings.action_text(text) == text


def test_an_action_without_a_name_is_marked() -> None:
    assert recordings.action_text('{"north_m": 2, "vessel": "", "on": false}') == "? north_m 2 on False"
