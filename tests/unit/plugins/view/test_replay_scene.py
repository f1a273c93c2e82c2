"""Recordings on a page: the track that grows behind a vessel, and the clock of a served page."""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from eastward_run import run_file

from tests.doubles.view_page import ViewPage
from xitl_cli.plugins.view import timeline
from xitl_cli.plugins.view.drawing import lift_m
from xitl_cli.plugins.view.model import SceneWater
from xitl_cli.plugins.view.recording import LogScene, SceneFinding, open_scene
from xitl_cli.plugins.view.replay import LEAST_PIECE, MOST_PIECES, ReplayDrawing, _WayDrawing, spaced, unseen_server
from xitl_cli.plugins.view.server import ViewAddress
from xitl_cli.plugins.view.timeline import RecordingPage
from xitl_cli.plugins.view.tracks import PoseTrack

WATER = SceneWater(1.5)


def eastward(points: int, step_m: float, up_m: float = 0.0, climb_m: float = 0.0) -> PoseTrack:
    """One step a second."""
    at_s = np.arange(points, dtype=float)
    place = np.column_stack([step_m * at_s, np.zeros(points), up_m + climb_m * at_s])
    return PoseTrack(at_s, place, at_s, np.tile([1.0, 0.0, 0.0, 0.0], (points, 1)))


def test_a_short_track_keeps_a_point_each_0_3_m_and_both_ends() -> None:
    track = eastward(9, 0.125)
    seconds, places = spaced(track.place_s, track.position_enu_m)
    assert seconds.tolist() == [0.0, 3.0, 5.0, 8.0]  # 0, 0.375, 0.625 (beyond 0.6) and the end, 1.0 (beyond 0.9)
    assert places[:, 0].tolist() == [0.0, 0.375, 0.625, 1.0]
    seconds, _ = spaced(track.place_s[:8], track.position_enu_m[:8])
    assert seconds.tolist() == [0.0, 3.0, 5.0, 7.0]  # the end is kept within 0.3 m too


def test_a_long_track_is_thinned_to_two_thousand_points() -> None:
    track = eastward(8001, 0.25)  # 2 km, a point each metre
    seconds, places = spaced(track.place_s, track.position_enu_m)
    assert len(seconds) == 2001
    np.testing.assert_allclose(np.diff(places[:, 0]), 1.0)


def test_a_vessel_at_rest_has_two_points() -> None:
    track = eastward(50, 0.0)
    assert spaced(track.place_s, track.position_enu_m)[0].tolist() == [0.0, 49.0]


def way(page: ViewPage, track: PoseTrack, name: str = "a") -> _WayDrawing:
    return _WayDrawing(page, name, track, WATER, (10, 20, 30))


def test_the_way_lies_on_the_water_and_the_complete_one_below() -> None:
    page = ViewPage()
    way(page, eastward(12, 1.0, up_m=0.5, climb_m=0.01))
    on_water_m = 1.5 + lift_m(WATER)
    whole, first, second, third = page.lines.values()
    assert list(page.lines) == ["/ways/a/whole", "/ways/a/0", "/ways/a/1", "/ways/a/2"]
    assert whole.points.shape == (11, 2, 3)
    np.testing.assert_allclose(whole.points[:, 0], [[n, 0.0, on_water_m - 0.03] for n in range(11)], rtol=1e-6)
    np.testing.assert_allclose(whole.points[:, 1], [[n + 1, 0.0, on_water_m - 0.03] for n in range(11)], rtol=1e-6)
    np.testing.assert_allclose(first.points[:, 1], [[n + 1, 0.0, on_water_m] for n in range(5)], rtol=1e-6)
    assert [len(piece.points) for piece in (first, second, third)] == [5, 5, 1]
    assert (first.colors, first.visible) == ((10, 20, 30), False)


def test_the_way_of_a_vehicle_that_leaves_the_water_has_its_heights() -> None:
    page = ViewPage()
    way(page, eastward(4, 1.0, up_m=0.0, climb_m=2.0))
    heights = page.lines["/ways/a/whole"].points[:, 1, 2] + 0.03 - lift_m(WATER)
    np.testing.assert_allclose(heights, [2.0, 4.0, 6.0], rtol=1e-6)
    page = ViewPage()
    way(page, eastward(4, 1.0, up_m=-3.0, climb_m=2.0))
    heights = page.lines["/ways/a/whole"].points[:, 1, 2] + 0.03 - lift_m(WATER)
    np.testing.assert_allclose(heights, [1.5, 1.5, 3.0], rtol=1e-6)  # never below the water


def test_pieces_appear_when_they_were_sailed_and_vanish_after_a_jump_back() -> None:
    page = ViewPage()
    drawn = way(page, eastward(12, 1.0), "")
    shown = []
    for time_s in (0.0, 4.9, 5.0, 9.9, 11.0, 99.0, 9.0, 5.0, 1.0, 12.0):
        drawn.draw(time_s)
        shown.append([page.lines[f"/ways/vessel/{number}"].visible for number in range(3)].count(True))
    assert shown == [0, 0, 1, 1, 3, 3, 1, 1, 0, 3]


def test_a_long_way_has_no_more_pieces_than_a_browser_can_show() -> None:
    page = ViewPage()
    way(page, eastward(1502, 1.0))
    assert len(page.lines) - 1 == 1501 // 7 + 1 <= MOST_PIECES  # 1501 segments, 7 in a piece
    page = ViewPage()
    way(page, eastward(MOST_PIECES * LEAST_PIECE + 1, 1.0))
    assert len(page.lines) - 1 == MOST_PIECES


def test_a_way_without_length_is_not_drawn() -> None:
    page = ViewPage()
    way(page, eastward(1, 0.0)).draw(5.0)
    assert page.lines == {}


@pytest.fixture
def recording(tmp_path: Path) -> Iterator[LogScene]:
    with open_scene([run_file(tmp_path / "run.mcap")]) as scene:
        yield scene


@pytest.fixture
def address() -> Iterator[tuple[socket.socket, ViewAddress]]:
    listener = socket.create_server(("127.0.0.1", 0))
    yield listener, ViewAddress("127.0.0.1", listener.getsockname()[1])
    listener.close()


@pytest.mark.medium
def test_the_wake_of_an_instant_follows_the_track_of_the_recording(recording: LogScene) -> None:
    pytest.importorskip("viser")
    with unseen_server() as server:
        drawing = ReplayDrawing(server, recording)
        past = drawing._past("", 7.0)
        early = drawing._past("", 0.25)
    assert past[-1] == pytest.approx([14.0, 0.0, 7.0], abs=1.0)
    assert past[:, 0] == pytest.approx(2.0 * past[:, 2])
    assert past[:, 1] == pytest.approx(0.0)
    assert early[0] == pytest.approx([0.0, 0.0, 0.0])
    assert drawing.track_colours == {"": (255, 60, 110)}


@pytest.mark.medium
def test_a_served_recording_plays_while_a_browser_is_there(
    recording: LogScene, address: tuple[socket.socket, ViewAddress], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("viser")
    page = RecordingPage(recording, *address)
    try:
        drawn: list[tuple[float, float | None]] = []
        instant = recording.instant

        def counted(time_s: float, since_s: float | None = None, seen: bool = True) -> Any:
            drawn.append((round(time_s, 3), since_s if since_s is None else round(since_s, 3)))
            return instant(time_s, since_s, seen)

        monkeypatch.setattr(recording, "instant", counted)
        steps = iter([0.0, 0.0, 0.0, 1.0, 1.0, 3.0, 3.0, 4.0, 4.0])
        monkeypatch.setattr(timeline, "time", cast(Any, type("Time", (), {"monotonic": lambda: next(steps)})))
        watched = iter([[], ["browser"], ["browser"], []])
        monkeypatch.setattr(page._server, "get_clients", lambda: next(watched))
        waits: list[float] = []

        class Ended(threading.Event):
            def is_set(self) -> bool:
                return len(waits) == 4

            def wait(self, timeout: float | None = None) -> bool:
                waits.append(timeout or 0.0)
                return False

        page._cameras = page._images = cast(Any, type("Nothing", (), {"update": lambda self, _: None})())
        page.serve(Ended())
        assert drawn == [(1.0, 0.0), (3.0, 1.0)]
        assert page.clock.time_s == 3.0  # the fourth second had no browser
        assert waits == [0.1, 0.05, 0.05, 0.1]
    finally:
        page.close()


@pytest.mark.medium
def test_messages_of_a_jump_are_those_since_the_shown_instant(
    recording: LogScene, address: tuple[socket.socket, ViewAddress], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("viser")
    page = RecordingPage(recording, *address, at_s=2.0)
    try:
        asked: list[float | None] = []
        instant = recording.instant
        monkeypatch.setattr(
            recording, "instant", lambda time_s, since_s: (asked.append(since_s), instant(time_s, since_s))[1]
        )
        for time_s in (2.0, 3.0, 1.0, 61.0, 60.0, 119.5):
            page._draw(time_s, 0.0)
        page._draw_again()
        page._draw(119.5, 0.0)
        assert asked == [2.0, None, None, None, 60.0, None]
    finally:
        page.close()


@pytest.mark.medium
def test_the_findings_of_the_recording_become_buttons(
    recording: LogScene, address: tuple[socket.socket, ViewAddress], monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("viser")
    shown: list[Any] = []
    page = RecordingPage(recording, *address, at_s=2.0)
    try:
        found: list[SceneFinding] = []
        monkeypatch.setattr(recording, "findings", lambda: found)
        monkeypatch.setattr(page.panel, "show_findings", shown.append)
        page.find()
        assert shown == [found]
    finally:
        page.close()
