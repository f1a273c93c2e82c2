"""The panel next to the picture: plots of the last minute, and the newest messages."""

from __future__ import annotations

import math
import re
from typing import Any, cast

import numpy as np
import pytest

from tests.doubles.view_page import ViewPage
from xitl_cli.plugins.view.model import SceneVessel, VesselInstant, ViewEvent, ViewInstant, ViewScene
from xitl_cli.plugins.view.readouts import COLOURS, PLOT_S, Readouts, events_html

SPEED, OFF = "speed m/s", "estimate off m"


@pytest.fixture
def page() -> ViewPage:
    return ViewPage()


def readouts_of(page: ViewPage, *names: str, notes: tuple[str, ...] = ()) -> Readouts:
    scene = ViewScene("test", vessels={name: SceneVessel(()) for name in names}, notes=notes)
    return Readouts(cast(Any, page), scene)


def instant(time_s: float, events: tuple[ViewEvent, ...] = (), **numbers: dict[str, float]) -> ViewInstant:
    """Of vessels with these numbers."""
    level = np.array([1.0, 0.0, 0.0, 0.0])
    vessels = {name: VesselInstant(np.zeros(3), level, numbers=values) for name, values in numbers.items()}
    return ViewInstant(time_s, vessels, events=events)


def drawn(page: ViewPage, title: str) -> list[list[float]]:
    """Times and values of a plot."""
    return [part.tolist() for part in vars(page[title])["data"]]


def test_a_plot_has_the_values_over_time_in_its_folder(page: ViewPage) -> None:
    readouts = readouts_of(page, "a")
    readouts.update(instant(0.0, a={SPEED: 1.0}), 0.0)
    assert SPEED not in page  # one point is no line
    for time_s, value in ((0.5, 1.5), (1.0, math.nan), (1.5, 2.5)):
        readouts.update(instant(time_s, a={SPEED: value, "battery V": 12.0}), time_s)
    assert drawn(page, SPEED) == [[0.0, 0.5, 1.5], [1.0, 1.5, 2.5]]
    assert page[SPEED].folder == "Plots"
    assert vars(page[SPEED])["series"][1]["stroke"] == COLOURS[0]
    assert "battery V" not in page  # the instruments show it


def test_a_plot_shows_a_minute(page: ViewPage) -> None:
    readouts = readouts_of(page, "a")
    for time_s in (0.0, 10.0, 60.0, 70.0):
        readouts.update(instant(time_s, a={SPEED: 2.0 * time_s}), time_s)
    assert drawn(page, SPEED) == [[10.0, 60.0, 70.0], [20.0, 120.0, 140.0]]


def test_values_of_a_minute_are_thinned_to_five_a_second(page: ViewPage) -> None:
    readouts = readouts_of(page, "a")
    for step in range(9):
        readouts.update(instant(0.125 * step, a={SPEED: float(step)}), 10.0 * step)
    assert drawn(page, SPEED) == [[0.0, 0.25, 0.5, 0.75, 1.0], [0.0, 2.0, 4.0, 6.0, 8.0]]


def test_a_jump_back_begins_a_new_plot(page: ViewPage) -> None:
    readouts = readouts_of(page, "a")
    for now_s, time_s in enumerate((0.0, 1.0, 2.0)):
        readouts.update(instant(time_s, a={SPEED: time_s}), float(now_s))
    readouts.update(instant(1.5, a={SPEED: 7.0}), 3.0)
    assert not page[SPEED].visible  # one point again
    readouts.update(instant(2.0, a={SPEED: 8.0}), 4.0)
    assert page[SPEED].visible
    assert drawn(page, SPEED) == [[1.5, 2.0], [7.0, 8.0]]


def test_the_panel_changes_a_few_times_a_second(page: ViewPage) -> None:
    readouts = readouts_of(page, "a")
    for time_s, now_s in ((0.0, 0.0), (1.0, 0.25), (2.0, 0.35), (3.0, 0.5)):
        readouts.update(instant(time_s, a={SPEED: 1.0}), now_s)
        seen = drawn(page, SPEED)[0] if SPEED in page else []
        assert seen == {0.0: [], 1.0: [0.0, 1.0], 2.0: [0.0, 1.0], 3.0: [0.0, 1.0, 2.0, 3.0]}[time_s]


def test_of_a_fleet_one_vessel_is_plotted(page: ViewPage) -> None:
    readouts = readouts_of(page, "a", "b")
    for time_s in (0.0, 1.0):
        readouts.update(instant(time_s, a={SPEED: 1.0, OFF: 0.5}, b={SPEED: 2.0}), time_s)
    assert drawn(page, SPEED)[1] == [1.0, 1.0]
    page["Vessel"].choose("b")
    readouts.update(instant(1.5, a={SPEED: 1.0}, b={SPEED: 3.0}), 1.0)  # at once
    assert drawn(page, SPEED)[1] == [2.0, 2.0, 3.0]
    assert not page[OFF].visible  # b has none
    assert vars(page[OFF])["series"][1]["stroke"] == COLOURS[2]


def test_a_single_vessel_needs_no_choice_and_may_be_absent(page: ViewPage) -> None:
    readouts = readouts_of(page)
    assert "Vessel" not in page
    for time_s in (0.0, 1.0):
        readouts.update(instant(time_s, other={SPEED: 1.0}), time_s)
    assert SPEED not in page


def test_the_newest_messages_are_first_and_bad_ones_red(page: ViewPage) -> None:
    readouts = readouts_of(page, "a", notes=("<b> is missing",))
    readouts.update(instant(0.0, (ViewEvent(1.25, 4, "low & slow"),), a={}), 0.0)
    readouts.update(instant(1.0, tuple(ViewEvent(2.0 + n, 5, f"text {n}") for n in range(6)), a={}), 1.0)
    shown = re.findall(r">(\d[^<]+)<", vars(page["html"])["content"])
    assert shown == [f"{2 + n}.0 s  text {n}" for n in (5, 4, 3, 2, 1, 0)]  # six are enough
    assert vars(page["markdown"])["content"] == "&lt;b&gt; is missing"


def test_a_warning_is_red_and_a_notice_is_not() -> None:
    warning, notice = (events_html([ViewEvent(0.0, severity, "a < b")]) for severity in (4, 5))
    assert "color:#e03131" in warning
    assert "color" not in notice
    assert "0.0 s  a &lt; b" in notice


def test_the_plot_has_room_for_a_minute_of_values(page: ViewPage) -> None:
    readouts = readouts_of(page, "a")
    for step in range(800):
        readouts.update(instant(0.25 * step, a={SPEED: 1.0}), float(step // 799))
    times = drawn(page, SPEED)[0]
    assert (times[0], times[-1]) == (199.75 - PLOT_S, 199.75)
