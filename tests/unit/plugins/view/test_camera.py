"""Where a camera looks from, with a browser in its place that moves as it is told."""

from __future__ import annotations

import math
import tracemalloc
from collections.abc import Callable
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from xitl_cli.plugins.view.camera import ABOVE, FOLLOW, FREE, HANDS_OFF_S, ORBIT, TURN_RADPS, Cameras, usual_pose
from xitl_cli.plugins.view.model import SceneVessel, VesselInstant, ViewInstant, ViewScene

EAST, NORTH = np.array([1.0, 0.0, 0.0, 0.0]), np.array([math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)])
FRAME_S = 0.05


class Dropdown:
    """Of a page: `choose` is what its user does."""

    def __init__(self, value: str) -> None:
        self.value = value

    def on_update(self, changed: Callable[[object], None]) -> None:
        self._changed = changed

    def choose(self, value: str) -> None:
        self.value = value
        self._changed(None)


class Camera:
    """Of a browser, as viser has it: where it was told, or said, to be last. shown: all places, one after the other."""

    def __init__(self) -> None:
        self._places = np.zeros((2, 3))
        self.update_timestamp = 0.0
        self.shown: list[np.ndarray] = []

    @property
    def position(self) -> np.ndarray:
        return self._places[0]

    @position.setter
    def position(self, place: np.ndarray) -> None:
        along = place - self.position
        self._places = np.array([place, self.look_at])
        self._aim(self.look_at + along)

    @property
    def look_at(self) -> np.ndarray:
        return self._places[1]

    @look_at.setter
    def look_at(self, place: np.ndarray) -> None:
        self._aim(place)
        self.shown.append(self._places)

    def report(self, places: np.ndarray) -> None:
        """What comes from the browser: position and what it looks at, (2, 3)."""
        self._places = places
        self.update_timestamp += 1.0

    def _aim(self, place: np.ndarray) -> None:
        if not np.isfinite(place).all():
            raise ValueError("Camera look_at must be finite")
        self.report(np.array([self.position, place]))


class Browser:
    """One that looks at `cameras`, with a clock of its own. It reports a place `late` frames after it was told."""

    def __init__(self, scene: ViewScene) -> None:
        self.late, self._reported = 1, 0
        self.dropdowns: dict[str, Dropdown] = {}
        self.client_id = 3
        self.camera = Camera()
        self.gui = SimpleNamespace(add_dropdown=self._add)
        self.atomic = nullcontext
        self.now_s = 0.0
        server: Any = SimpleNamespace(
            initial_camera=SimpleNamespace(),
            get_clients=lambda: {self.client_id: self},
            on_client_connect=lambda joined: setattr(self, "join", joined),
            on_client_disconnect=lambda left: None,
        )
        self.cameras = Cameras(server, scene, lambda: self.now_s)
        self.aimed = server.initial_camera
        self.join(self)

    def _add(self, label: str, choices: object, initial_value: str, order: float) -> Dropdown:
        return self.dropdowns.setdefault(label, Dropdown(initial_value))

    def look(self, seconds: float, **places: tuple[float, float, np.ndarray]) -> np.ndarray:
        """At vessels that stand there. Returns the offset of the camera from what it looks at."""
        vessels = {
            name: VesselInstant(np.array([east, north, 0.0]), turn) for name, (east, north, turn) in places.items()
        }
        for _ in range(max(round(seconds / FRAME_S), 1)):
            self.now_s += FRAME_S
            while len(self.camera.shown) - self._reported >= self.late:
                self.camera.report(self.camera.shown[self._reported])
                self._reported += 1
            self.cameras.update(ViewInstant(self.now_s, vessels))
        return self.camera.position - self.camera.look_at


@pytest.fixture
def browser() -> Browser:
    vessels = {"alpha": SceneVessel((), length_m=4.0), "beta": SceneVessel((), length_m=2.0)}
    return Browser(ViewScene("test", vessels=vessels))


def bearing(offset: np.ndarray) -> float:
    return math.atan2(offset[1], offset[0])


def test_it_follows_from_behind_and_turns_after_the_heading(browser: Browser) -> None:
    first = browser.look(0.0, alpha=(10.0, 20.0, EAST))
    assert browser.camera.look_at[:2] == pytest.approx([10.0, 20.0])
    assert np.linalg.norm(first) == pytest.approx(3.6 * 4.0)
    assert first[0] < 0.0 < first[2]
    turned = browser.look(60.0, alpha=(10.0, 20.0, NORTH))
    assert math.remainder(bearing(turned) - bearing(first), math.tau) == pytest.approx(0.5 * math.pi, abs=0.01)
    browser.look(5.0, alpha=(40.0, 20.0, NORTH))
    assert browser.camera.look_at[:2] == pytest.approx([40.0, 20.0], abs=0.01)


def test_it_goes_round_the_vessel_whatever_that_heads_for(browser: Browser) -> None:
    browser.dropdowns["Camera"].choose(ORBIT)
    first = browser.look(0.0, alpha=(0.0, 0.0, EAST))
    later = browser.look(10.0, alpha=(0.0, 0.0, NORTH))
    assert math.remainder(bearing(later) - bearing(first), math.tau) == pytest.approx(10.0 * TURN_RADPS, abs=0.01)
    assert np.linalg.norm(later) == pytest.approx(np.linalg.norm(first))


def test_from_above_north_is_up(browser: Browser) -> None:
    browser.dropdowns["Camera"].choose(ABOVE)
    offset = browser.look(5.0, alpha=(0.0, 0.0, EAST))
    assert np.hypot(*offset[:2]) < 0.05 * offset[2]
    assert offset[1] < 0.0  # it leans to the south by a little, so that the picture has north at its top
    assert offset[2] > 5.0 * usual_pose(FOLLOW, 4.0).distance_m * 0.99


def test_what_the_mouse_did_is_kept_and_a_free_camera_is_left_alone(browser: Browser) -> None:
    browser.look(1.0, alpha=(0.0, 0.0, EAST))
    by_hand = np.array([0.0, 30.0, 10.0])
    browser.camera.shown.append(np.array([browser.camera.look_at + by_hand, browser.camera.look_at]))
    browser.look(0.5 * HANDS_OFF_S, alpha=(1.0, 0.0, EAST))
    assert browser.look(5.0, alpha=(6.0, 0.0, EAST)) == pytest.approx(by_hand, abs=0.01)
    assert browser.camera.look_at[0] == pytest.approx(6.0, abs=0.01)
    browser.dropdowns["Camera"].choose(FREE)
    browser.look(1.0, alpha=(60.0, 0.0, EAST))
    assert browser.camera.look_at[0] == pytest.approx(6.0, abs=0.01)


@pytest.mark.medium
@pytest.mark.parametrize("late", [1, 20, 200])
def test_a_slow_browser_that_reports_old_places_is_nobodys_hand(browser: Browser, late: int) -> None:
    browser.late = late
    for place in ([[3.0, 3.0, 3.0], [0.0, 0.0, 0.0]], [[-5.0, 0.0, 0.0], [0.0, 0.0, 0.0]]):  # before it is told any
        browser.camera.report(np.array(place))
        browser.look(0.0, alpha=(0.0, 0.0, EAST))
    for turn in np.linspace(0.0, math.pi, 300):
        attitude = np.array([math.cos(0.5 * turn), 0.0, 0.0, math.sin(0.5 * turn)])
        offset = browser.look(0.0, alpha=(3.0 * turn, turn, attitude))
    offset = browser.look(60.0, alpha=(3.0 * turn, turn, attitude))
    usual = usual_pose(FOLLOW, 4.0)
    assert np.linalg.norm(offset) == pytest.approx(usual.distance_m)
    assert offset == pytest.approx(usual.offset_m(math.pi), abs=0.05)


def test_a_browser_that_tells_no_numbers_is_led_on(browser: Browser) -> None:
    first = browser.look(1.0, alpha=(0.0, 0.0, EAST))
    for _ in range(3):
        browser.camera.shown.append(np.full((2, 3), math.nan))
        offset = browser.look(0.0, alpha=(0.0, 0.0, EAST))
    assert offset == pytest.approx(first)
    assert browser.camera.look_at[:2] == pytest.approx([0.0, 0.0])


def test_a_vessel_that_is_nowhere_is_not_followed(browser: Browser) -> None:
    first = browser.look(1.0, alpha=(0.0, 0.0, EAST))
    assert browser.look(1.0, alpha=(math.nan, 0.0, EAST)) == pytest.approx(first)
    assert browser.look(1.0, alpha=(0.0, 0.0, np.full(4, math.nan))) == pytest.approx(first)
    browser.look(5.0, alpha=(9.0, 0.0, EAST))
    assert browser.camera.look_at[0] == pytest.approx(9.0, abs=0.01)


def test_another_vessel_may_be_looked_at(browser: Browser) -> None:
    here, there = (0.0, 0.0, EAST), (300.0, 5.0, EAST)
    browser.look(1.0, alpha=here, beta=there)
    browser.dropdowns["of"].choose("beta")
    offset = browser.look(0.0, alpha=here, beta=there)
    assert browser.camera.look_at[:2] == pytest.approx([300.0, 5.0])
    assert np.linalg.norm(offset) == pytest.approx(3.6 * 2.0)


@pytest.mark.medium
def test_the_memory_of_a_camera_does_not_grow(browser: Browser) -> None:
    def traced_bytes(seconds: int) -> int:
        for _ in range(seconds):
            browser.look(1.0, alpha=(0.0, 0.0, EAST))
            browser.camera.shown.clear()
            browser._reported = 0
        return tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    try:
        traced_bytes(2)
        before = traced_bytes(2)
        after = traced_bytes(30)
    finally:
        tracemalloc.stop()
    assert after - before < 30 * round(1.0 / FRAME_S)  # less than a byte for each frame
