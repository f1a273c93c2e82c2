"""Pictures of a recording: their camera, their browser and what is refused. No browser runs here."""

from __future__ import annotations

import io
import math
import os
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from eastward_run import run_file

from sim_core.frames import quat_to_matrix
from xitl_cli.errors import UserError
from xitl_cli.plugins.view import pictures
from xitl_cli.plugins.view.look import DAY, NIGHT, sky_rows
from xitl_cli.plugins.view.pictures import Camera, camera_view, find_browser, moving_picture, picture
from xitl_cli.plugins.view.recording import LogScene, open_scene

image_module = pytest.importorskip("PIL.Image")


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LogScene]:
    """Goes east at 2 m/s for 20 s, 2 m long."""
    with open_scene([run_file(tmp_path_factory.mktemp("run") / "run.mcap")]) as scene:
        yield scene


class Photographs:
    """Stands in for the browser. at_s: instants of its pictures."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.at_s: list[float] = []
        monkeypatch.setattr(pictures, "_photographer", self._photographer)

    @contextmanager
    def _photographer(self, *_: object) -> Iterator[Callable[[float], Any]]:
        yield self._take

    def _take(self, at_s: float) -> Any:
        self.at_s.append(at_s)
        return image_module.new("RGB", (64, 64), (round(10.0 * at_s), 200, 30))


@pytest.mark.parametrize(
    ("look_at", "right", "down", "ahead"),
    [
        ((0.0, 5.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)),  # to the north
        ((-2.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, -1.0), (-1.0, 0.0, 0.0)),  # to the west
        ((0.0, 3.0, -4.0), (1.0, 0.0, 0.0), (0.0, -0.8, -0.6), (0.0, 0.6, -0.8)),  # north and down
        ((0.0, 0.0, -7.0), (1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)),  # straight down, north up
    ],
)
def test_a_camera_looks_at_its_point_with_an_upright_picture(
    look_at: tuple[float, float, float], right: tuple[float, ...], down: tuple[float, ...], ahead: tuple[float, ...]
) -> None:
    camera = Camera((0.0, 0.0, 0.0), look_at)
    np.testing.assert_allclose(quat_to_matrix(camera.attitude_wxyz()).T, [right, down, ahead], atol=1e-12)
    away = (10.0, -20.0, 30.0)
    moved = Camera(away, cast(Any, tuple(np.add(away, look_at))))
    np.testing.assert_allclose(moved.attitude_wxyz(), camera.attitude_wxyz(), atol=1e-12)


def test_the_views_have_the_distances_of_a_boat_of_two_metres(recording: LogScene) -> None:
    instant = recording.instant(7.0)  # at 14 m east
    above, beside, all_of_it = (camera_view(view, recording, instant) for view in ("above", "beside", "all"))  # type: ignore[arg-type]
    assert above.position_enu_m == pytest.approx((14.0, -0.01, 48.0))
    assert above.look_at_enu_m == pytest.approx((14.0, 0.0, 0.0))
    assert beside.position_enu_m == pytest.approx((14.0, -8.0, 2.0))  # to starboard
    assert beside.look_at_enu_m == pytest.approx((14.0, 0.0, 0.0))
    assert all_of_it.position_enu_m == pytest.approx((20.0, -20.0, 40.0))
    assert all_of_it.look_at_enu_m == pytest.approx((20.0, 0.0, 0.0))


@pytest.mark.medium
def test_the_camera_looks_at_the_named_vessel(tmp_path: Path) -> None:
    paths = [run_file(tmp_path / "a.mcap"), run_file(tmp_path / "b.mcap", beside_m=30.0)]
    with open_scene(paths) as recording:
        instant = recording.instant(5.0)
        first, second = recording.names
        places = [camera_view("above", recording, instant, name).look_at_enu_m for name in (None, first, second)]
        assert places == [pytest.approx((10.0, north, 0.0), abs=1e-3) for north in (0.0, 0.0, 30.0)]
        everything = camera_view("all", recording, instant)
        assert everything.look_at_enu_m == pytest.approx((20.0, 15.0, 0.0), abs=1e-3)
        assert everything.position_enu_m == pytest.approx((20.0, 15.0 - 25.0, 50.0), abs=1e-3)  # a diagonal of 50 m


def test_a_picture_shows_an_instant_of_the_recording(recording: LogScene, monkeypatch: pytest.MonkeyPatch) -> None:
    photographs = Photographs(monkeypatch)
    for at_s in (0.0, 20.0):
        with image_module.open(io.BytesIO(picture(recording, at_s))) as shown:
            assert (shown.format, shown.getpixel((3, 5))) == ("PNG", (10.0 * at_s, 200, 30))
    assert photographs.at_s == [0.0, 20.0]
    for at_s in (-0.01, 20.01):
        with pytest.raises(UserError, match=r"no picture at .* the recording is from 0.00 s to 20.00 s"):
            picture(recording, at_s)


def test_a_moving_picture_begins_at_its_start_and_has_its_length(
    recording: LogScene, monkeypatch: pytest.MonkeyPatch
) -> None:
    photographs = Photographs(monkeypatch)
    film = moving_picture(recording, 4.0, 12.0, speed=4.0, rate_hz=2.0)
    assert photographs.at_s == [4.0, 6.0, 8.0, 10.0]
    with image_module.open(io.BytesIO(film)) as shown:
        assert (shown.info["duration"], shown.info["loop"]) == (500, 0)
    photographs.at_s.clear()
    moving_picture(recording, 4.0, 4.1, speed=100.0)
    assert photographs.at_s == [4.0]  # one at least


def test_a_film_of_too_many_pictures_is_refused(recording: LogScene, monkeypatch: pytest.MonkeyPatch) -> None:
    photographs = Photographs(monkeypatch)
    monkeypatch.setattr(pictures, "MOST_FRAMES", 40)
    moving_picture(recording, speed=5.0, rate_hz=10.0)
    assert len(photographs.at_s) == 40
    with pytest.raises(UserError, match=r"20 s at 4\.8 × are 42 pictures, more than 40; choose a shorter span"):
        moving_picture(recording, speed=4.8, rate_hz=10.0)


@pytest.mark.parametrize("size", [(63, 720), (1280, 63), (4097, 720), (1280, 4097)])
def test_a_size_beyond_the_limits_is_refused(recording: LogScene, size: tuple[int, int]) -> None:
    with pytest.raises(UserError, match=f"{size[0]}x{size[1]}: each side of a picture must have 64 to 4096 pixels"):
        picture(recording, 1.0, size=size)


@pytest.mark.medium
def test_a_vessel_that_is_not_recorded_is_refused(recording: LogScene, tmp_path: Path) -> None:
    with pytest.raises(UserError, match="no vessel 'x'; it has a single vessel without a name"):
        picture(recording, 1.0, size=(64, 64), vessel="x")
    paths = [run_file(tmp_path / "a.mcap"), run_file(tmp_path / "b.mcap")]
    with open_scene(paths) as two, pytest.raises(UserError, match=r"no vessel 'x'; it has a.mcap, b.mcap"):
        picture(two, 1.0, size=(4096, 4096), vessel="x")


@pytest.fixture
def programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The only folder of the PATH."""
    folder = tmp_path / "programs"
    folder.mkdir()
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}/bin")
    monkeypatch.setattr(pictures, "BROWSERS", ("this-chromium", "that-chrome"))
    monkeypatch.delenv(pictures.BROWSER_VARIABLE, raising=False)
    return folder


def program(path: Path, lines: str = "") -> Path:
    path.write_text(f"#!/bin/sh\n{lines}\n")
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return path


def test_the_first_browser_of_the_machine_is_taken_unless_another_is_named(
    programs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(UserError, match="needs Chromium, Chrome or Edge, and this machine has none"):
        find_browser()
    chrome = program(programs / "that-chrome")
    assert find_browser() == str(chrome)
    chromium = program(programs / "this-chromium")
    assert find_browser() == str(chromium)
    monkeypatch.setenv(pictures.BROWSER_VARIABLE, "that-chrome")
    assert find_browser() == str(chrome)
    monkeypatch.setenv(pictures.BROWSER_VARIABLE, "other")
    with pytest.raises(UserError, match="XITL_BROWSER=other is not a program"):
        find_browser()


def server_of(clients: dict[int, str]) -> Any:
    return SimpleNamespace(get_port=lambda: 8123, get_clients=lambda: clients)


def test_a_browser_that_ends_is_named_with_its_last_words(programs: Path) -> None:
    browser = str(program(programs / "this-chromium", 'echo first; echo "no display" >&2; exit 1'))
    with (
        pytest.raises(UserError, match=f"^{browser} ended; its last output: no display; try another one"),
        pictures._browser_at(browser, server_of({}), (640, 360)),
    ):
        pass


def test_a_browser_that_opens_no_page_is_ended(programs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    browser = str(program(programs / "this-chromium", "exec sleep 60"))
    monkeypatch.setattr(pictures, "START_S", 0.0)
    with (
        pytest.raises(UserError, match=f"^{browser} did not open the page within 0 s; try another one"),
        pictures._browser_at(browser, server_of({}), (640, 360)),
    ):
        pass


def test_the_browser_opens_the_page_in_the_size_of_the_picture_and_ends_after_it(
    programs: Path, tmp_path: Path
) -> None:
    written = tmp_path / "arguments"
    browser = str(
        program(
            programs / "this-chromium", f'echo $$ "$@" > {written}.part; mv {written}.part {written}; exec sleep 60'
        )
    )

    class Clients:
        """There is one as soon as the browser runs."""

        def __call__(self) -> dict[int, str]:
            return {7: "client"} if written.exists() else {}

    server = SimpleNamespace(get_port=lambda: 8123, get_clients=Clients())
    with pictures._browser_at(browser, cast(Any, server), (640, 360)) as client:
        assert client == "client"
        number, *arguments = written.read_text().split()
        os.kill(int(number), 0)  # it runs
    assert arguments[-2:] == ["--window-size=640,460", "http://127.0.0.1:8123/?look=full"]
    assert "--headless=new" in arguments
    with pytest.raises(ProcessLookupError):
        os.kill(int(number), 0)


class Client:
    """A browser that draws these pictures, one after the other; it raises those that are errors."""

    def __init__(self, *drawn: Any) -> None:
        self._drawn = list(drawn)
        self.asked: list[tuple[tuple[int, int], dict[str, Any]]] = []

    def get_render(self, height: int, width: int, **keys: Any) -> Any:
        self.asked.append(((height, width), keys))
        drawn = self._drawn.pop(0)
        if isinstance(drawn, Exception):
            raise drawn
        return drawn


def test_pictures_begin_when_the_sky_is_drawn() -> None:
    clear, sky = (np.full((16, 16, 4), alpha, dtype=np.uint8) for alpha in (0, 255))
    client = Client(clear, TimeoutError(), RuntimeError(), sky, clear)
    pictures._await_look(client)
    assert len(client.asked) == 4


def test_pictures_begin_without_a_sky_after_a_while(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = iter([0.0, 5.0, 19.9, 20.0, 21.0])
    monkeypatch.setattr(pictures, "time", SimpleNamespace(monotonic=lambda: next(now_s)))
    client = Client(*[np.zeros((16, 16, 4), dtype=np.uint8)] * 3)
    pictures._await_look(client)
    assert len(client.asked) == 2


@pytest.mark.parametrize("dark", [False, True])
def test_the_sky_is_behind_what_the_browser_drew(dark: bool) -> None:
    drawn = np.zeros((6, 4, 4), dtype=np.uint8)
    drawn[2, 1] = (200, 100, 50, 255)
    client = Client(drawn)
    image = np.asarray(pictures._render(client, Camera((1.0, 2.0, 3.0), (1.0, 5.0, 3.0)), (4, 6), dark))
    ((shape, keys),) = client.asked
    assert shape == (6, 4)
    assert keys["position"].tolist() == [1.0, 2.0, 3.0]
    assert keys["fov"] == pytest.approx(math.radians(50.0))
    assert image.shape == (6, 4, 3)
    assert image[2, 1].tolist() == [200, 100, 50]
    sky = sky_rows(NIGHT if dark else DAY)
    np.testing.assert_allclose(image[0, 0], sky[: len(sky) // 6].mean(axis=0), atol=8)
    assert (image[0] == image[0, 0]).all()


def test_a_browser_without_a_picture_is_named() -> None:
    with pytest.raises(UserError, match=r"the browser returned no picture \(lost context\); try a smaller --size"):
        pictures._render(Client(RuntimeError("lost context")), Camera((0.0, 0.0, 0.0), (1.0, 0.0, 0.0)), (4, 6), False)


def test_the_palette_of_a_film_has_the_colours_of_all_its_pictures() -> None:
    colours = [(250, 10, 10), (10, 250, 10), (10, 10, 250)]
    films = [image_module.new("RGB", (8, 8), colour) for colour in colours]
    shown = [image.convert("RGB").getpixel((4, 4)) for image in pictures._with_one_palette(films)]
    for seen, colour in zip(shown, colours, strict=True):
        np.testing.assert_allclose(seen, colour, atol=8)


def test_a_palette_keeps_the_colour_of_a_small_mark() -> None:
    rows = np.linspace(0, 255, 256, dtype=np.uint8)
    sky = np.stack(
        [np.tile(rows[:, None], (1, 64)), np.full((256, 64), 120, np.uint8), np.full((256, 64), 200, np.uint8)], axis=2
    )
    sky[100:102, 30:32] = (10, 250, 10)
    image = image_module.fromarray(sky)
    palette = pictures.palette_of(image, 32)
    assert len(palette.getpalette()) == 3 * 32
    seen = np.asarray(image.quantize(palette=palette, dither=image_module.Dither.NONE).convert("RGB"), dtype=int)
    assert seen[100, 30].tolist() == pytest.approx([10, 250, 10], abs=40)
    assert np.abs(seen - sky.astype(int)).max(axis=2).mean() < 16.0
