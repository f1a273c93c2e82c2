"""The page of a replay: its data, its instants, and what a report says when there is none."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from eastward_run import run_file

from xitl_cli.errors import UserError
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.sections import Severity
from xitl_cli.plugins.view import replay_page
from xitl_cli.plugins.view.model import Points, VesselInstant, ViewInstant
from xitl_cli.plugins.view.recording import LogScene, SceneFinding, SceneMark, open_scene
from xitl_cli.plugins.view.replay_page import Span, _page_data, _PageInstants, checked_span, replay_html, report_replay

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LogScene]:
    """Goes east at 2 m/s for 20 s; armed after 5 s."""
    with open_scene([run_file(tmp_path_factory.mktemp("run") / "run.mcap")]) as scene:
        yield scene


def finding(time_s: float | None, sentence: str) -> SceneFinding:
    return SceneFinding(time_s, Severity.WARNING, sentence, "look")


def data_of(page: str) -> Any:
    found = re.search(r'<script type="application/json" id="replay-data">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    return json.loads(found[1])


@pytest.mark.medium
def test_a_page_plays_the_span_with_its_events_and_findings(
    recording: LogScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("viser")
    drawn: list[float] = []
    instant = recording.instant
    monkeypatch.setattr(
        recording, "instant", lambda time_s, seen=True: (drawn.append(time_s), instant(time_s, seen=seen))[1]
    )
    monkeypatch.setattr(replay_page, "RATE_HZ", 2.0)
    findings = [finding(4.0, "</script>")]
    page = replay_html(recording, from_s=3.0, to_s=5.2, findings=findings, view="above", at_s=4.5, dark=True)
    assert drawn == pytest.approx([3.0 + 2.2 * step / 5 for step in range(6)])  # at least two a second
    data = data_of(page)
    assert (data["begin_s"], data["duration_s"], data["view"], data["at_s"]) == (3.0, 2.2, "above", 4.5)
    assert data["findings"][0]["sentence"] == "</script>"
    assert "classList.add('replay-dark')" in page
    assert page.rstrip().endswith("</html>")
    assert page.index("replay-data") > page.index("<head>")


@pytest.mark.medium
def test_a_page_without_given_findings_has_those_of_the_analysis(
    recording: LogScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("viser")
    monkeypatch.setattr(recording, "findings", lambda: [finding(4.0, "from the analysis")])
    page = replay_html(recording, from_s=4.0, to_s=4.2)
    assert [entry["sentence"] for entry in data_of(page)["findings"]] == ["from the analysis"]
    assert "classList.add('replay-dark')" not in page
    assert data_of(replay_html(recording, from_s=4.0, to_s=4.2, findings=[]))["findings"] == []


def test_the_data_of_a_page_are_those_of_its_span(recording: LogScene, monkeypatch: pytest.MonkeyPatch) -> None:
    marks = tuple(SceneMark(at_s, f"at {at_s:g}") for at_s in (2.99, 3.0, 7.0, 7.01))
    monkeypatch.setattr(recording, "marks", marks)
    findings = [finding(2.9, "before"), finding(None, "no time"), finding(5.126, "inside"), finding(7.1, "after")]
    data = _page_data(recording, Span(3.0, 7.0), findings, "behind", None)
    assert data["marks"] == [{"time_s": 3.0, "text": "at 3"}, {"time_s": 7.0, "text": "at 7"}]
    assert [(entry["time_s"], entry["severity"], entry["sentence"]) for entry in data["findings"]] == [
        (None, "warning", "no time"),
        (5.13, "warning", "inside"),
    ]
    assert (data["begin_s"], data["duration_s"]) == (3.0, 4.0)
    assert (data["middle_en_m"], data["extent_m"]) == ([20.0, 0.0], 40.0)
    vessel = data["vessels"][0]
    assert (vessel["name"], vessel["path"], vessel["distance_m"]) == ("", "/vessels/vessel", 8.0)
    east, north, up = vessel["behind_m"]
    assert east < 0.0 < up  # behind a boat that heads east
    assert np.hypot(np.hypot(east, north), up) == pytest.approx(7.2, abs=0.02)  # 3.6 lengths


def test_a_page_lists_no_more_events_than_can_be_read(recording: LogScene, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(recording, "marks", tuple(SceneMark(5.0, str(number)) for number in range(500)))
    data = _page_data(recording, Span(3.0, 7.0), [finding(5.0, str(number)) for number in range(500)], "all", 1.0)
    for key in ("marks", "findings"):
        assert len(data[key]) == 400
    assert data["marks"][-1]["text"] == "399"


def test_the_extent_of_a_short_way_is_20_m(recording: LogScene, monkeypatch: pytest.MonkeyPatch) -> None:
    short = SimpleNamespace(pose=SimpleNamespace(position_enu_m=np.array([[1.0, 2.0, 0.0], [4.0, 6.0, 0.0]])))
    monkeypatch.setattr(recording, "track", lambda name: short)
    data = _page_data(recording, Span(0.0, 1.0), [], "all", None)
    assert (data["middle_en_m"], data["extent_m"]) == ([2.5, 4.0], 20.0)


def test_a_span_without_ends_is_the_recording(recording: LogScene) -> None:
    assert checked_span(recording) == Span(0.0, 20.0)
    assert checked_span(recording, -5.0, 19.0) == Span(0.0, 19.0)
    with pytest.raises(UserError, match=r"no data from 5 s to 5 s: the recording is from 0\.00 s to 20\.00 s"):
        checked_span(recording, 5.0, 5.0)


class Seen:
    """A recording with clouds that say at which time they were read. asked: whether an instant had clouds."""

    def __init__(self, points: int = 4) -> None:
        self.asked: list[tuple[float, bool]] = []
        self._points = points

    def instant(self, time_s: float, seen: bool) -> ViewInstant:
        self.asked.append((time_s, seen))
        cloud: Points = np.full((self._points, 3), time_s + 0.01, dtype=np.float32)
        clouds = {"lidar": cloud, "map": cloud} if seen else {}
        return ViewInstant(time_s, {"a": VesselInstant(np.zeros(3), LEVEL, clouds=clouds)})


def shown(instant: ViewInstant, sensor: str) -> float:
    """The time of a cloud, which is rounded to 5 cm."""
    return round(float(instant.vessels["a"].clouds[sensor][0, 0]), 3)


def test_clouds_of_a_page_are_renewed_each_second_and_the_map_twelve_times() -> None:
    recording = Seen()
    instants = _PageInstants(cast(Any, recording), Span(10.0, 34.0))
    clouds = {}
    for time_s in (10.0, 10.5, 10.99, 11.0, 11.9, 12.0, 13.5, 14.0):
        instant = instants.at(time_s)
        clouds[time_s] = shown(instant, "lidar"), shown(instant, "map")
    assert clouds == {
        10.0: (10.0, 10.0),
        10.5: (10.0, 10.0),
        10.99: (10.0, 10.0),
        11.0: (11.0, 10.0),
        11.9: (11.0, 10.0),
        12.0: (12.0, 12.0),
        13.5: (13.5, 12.0),
        14.0: (14.0, 14.0),
    }
    assert [at_s for at_s, seen in recording.asked if seen] == [10.0, 11.0, 12.0, 13.5, 14.0]


def test_the_map_of_a_short_page_is_renewed_each_second_too() -> None:
    instants = _PageInstants(cast(Any, Seen()), Span(0.0, 2.0))
    assert [shown(instants.at(time_s), "map") for time_s in (0.0, 0.9, 1.0, 1.9)] == [0.0, 0.0, 1.0, 1.0]


@pytest.mark.parametrize(("points", "lidar", "of_map"), [(1200, 1200, 1200), (1201, 601, 1201), (8001, 1143, 4001)])
def test_clouds_of_a_page_are_thinned(points: int, lidar: int, of_map: int) -> None:
    clouds = _PageInstants(cast(Any, Seen(points)), Span(0.0, 2.0)).at(0.0).vessels["a"].clouds
    assert (len(clouds["lidar"]), len(clouds["map"])) == (lidar, of_map)


def report_of(*files: tuple[str, str, float], chart: str | None = None) -> Any:
    """A report of files: path, format, and the second of stamp 0 on their time line."""
    listed = [
        SimpleNamespace(path=Path(path), format=kind, time_line=SimpleNamespace(second=lambda _, at_s=at_s: at_s))
        for path, kind, at_s in files
    ]
    overview = SimpleNamespace(chart=None if chart is None else SimpleNamespace(path=Path(chart)))
    return SimpleNamespace(files=listed, overview=overview)


class Opened:
    """Stands in for the scene that a report opens. arguments: of `open_scene`."""

    span_s = (2.5, 9.0)

    def __init__(self, monkeypatch: pytest.MonkeyPatch, page: str = "page") -> None:
        self.arguments: list[Any] = []
        self.keys: dict[str, Any] = {}
        monkeypatch.setattr(replay_page, "VIEW", SimpleNamespace(missing=(), pip_line="pip"))
        monkeypatch.setattr(replay_page, "open_scene", self._open)
        monkeypatch.setattr(replay_page, "replay_html", lambda scene, **keys: (self.keys.update(keys), page)[1])

    def _open(self, *arguments: Any) -> Any:
        self.arguments.append(arguments)
        return self

    def __enter__(self) -> Opened:
        return self

    def __exit__(self, *_: object) -> None: ...

    def findings_of(self, report: object) -> list[str]:
        return ["finding"]

    def lead_second(self, stamp_ns: int) -> tuple[Path, float]:
        return self.arguments[-1][0][0], 100.0 + stamp_ns


def test_a_report_replays_its_run_and_says_how_late_its_own_times_are(monkeypatch: pytest.MonkeyPatch) -> None:
    opened = Opened(monkeypatch)
    report = report_of(
        ("a.bin", "dataflash", 1.0), ("run.mcap", "mcap", 30.0), ("b.mcap", "mcap", 7.0), chart="c.geojson"
    )
    replay = report_replay(report, "ego")
    assert opened.arguments == [([Path("run.mcap")], "ego", Path("c.geojson"))]
    assert opened.keys == {"findings": ["finding"], "at_s": 2.5}
    assert (replay.html, replay.late_s, replay.note) == ("page", 70.0, "")


def test_a_report_without_a_run_replays_its_first_log(monkeypatch: pytest.MonkeyPatch) -> None:
    opened = Opened(monkeypatch)
    assert report_replay(report_of(("a.bin", "dataflash", 1.0), ("b.tlog", "tlog", 2.0)), None).late_s == 99.0
    assert opened.arguments == [([Path("a.bin")], None, None)]


def test_a_replay_that_is_too_large_for_a_report_is_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay_page, "MOST_REPLAY_BYTES", 2_000_000)
    Opened(monkeypatch, 2_000_000 * "x")
    assert report_replay(report_of(("a.bin", "dataflash", 1.0)), None).html
    Opened(monkeypatch, 2_600_000 * "x")
    replay = report_replay(report_of(("a.bin", "dataflash", 1.0)), None)
    assert not replay.html
    assert replay.note == ("the 3D replay is omitted: it has 3 MB, more than 2; `xitl view LOG --html FILE` writes it")


@pytest.mark.parametrize("error", [LogError("a.bin: has no attitude"), UserError("no span")])
def test_a_report_says_why_it_has_no_replay(monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    monkeypatch.setattr(replay_page, "VIEW", SimpleNamespace(missing=(), pip_line="pip"))

    def refuse(*_: object) -> None:
        raise error

    monkeypatch.setattr(replay_page, "open_scene", refuse)
    replay = report_replay(report_of(("a.bin", "dataflash", 1.0)), None)
    assert (replay.html, replay.note) == ("", f"no 3D replay: {error}")


def test_a_report_says_which_package_a_replay_needs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay_page, "VIEW", SimpleNamespace(missing=("viser", "pillow"), pip_line="pip install"))
    note = report_replay(report_of(), None).note
    assert note == "the 3D replay needs viser, pillow, which is not installed; pip install"
