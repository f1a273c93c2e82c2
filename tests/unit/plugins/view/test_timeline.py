"""The clock of a served recording, and what its page lists."""

from __future__ import annotations

import math
from typing import Any, cast

import pytest

from tests.doubles.view_page import ViewPage
from xitl_cli.logs.model.sections import Severity
from xitl_cli.plugins.view.recording import SceneFinding, SceneMark
from xitl_cli.plugins.view.timeline import (
    MOST_SLIDER_MARKS,
    PlayClock,
    TimelinePanel,
    event_labels,
    shortened,
    slider_marks,
)

MARKS = (SceneMark(2.0, "armed"), SceneMark(4.5, "mode AUTO"), SceneMark(9.0, "waypoint 1 reached"))


@pytest.fixture
def page() -> ViewPage:
    return ViewPage()


def panel_of(page: ViewPage, clock: PlayClock, marks: tuple[SceneMark, ...] = MARKS) -> TimelinePanel:
    return TimelinePanel(cast(Any, page), clock, marks)


def test_it_plays_at_its_speed_and_stands_at_the_end() -> None:
    clock = PlayClock((10.0, 20.0))
    assert clock.advance(1.0) == pytest.approx(11.0)
    clock.run_at(5.0)
    assert clock.advance(1.0) == pytest.approx(16.0)
    assert clock.advance(1.0) == 20.0
    assert not clock.playing
    clock.play(True)  # from the start
    assert clock.advance(0.0) == 10.0


def test_a_jump_stands_still_and_stays_inside() -> None:
    clock = PlayClock((10.0, 20.0))
    clock.jump(15.0)
    assert (clock.advance(3.0), clock.playing) == (15.0, False)
    clock.jump(99.0)
    assert clock.time_s == 20.0


def test_it_begins_at_an_instant_that_was_asked_for_and_stands_there() -> None:
    clock = PlayClock((10.0, 20.0), at_s=12.0)
    assert (clock.advance(5.0), clock.playing) == (12.0, False)


def test_every_event_has_a_label_of_its_own() -> None:
    marks = [SceneMark(5.0, "armed"), SceneMark(5.0, "armed"), SceneMark(65.0, "x" * 200)]
    labels = event_labels(marks)
    assert labels[:2] == ["0:05.0 armed", "0:05.0 armed "]
    assert labels[2] == "1:05.0 " + 59 * "x" + "…"


def test_a_slider_has_no_more_marks_than_can_be_seen() -> None:
    assert slider_marks([SceneMark(float(at), "") for at in range(3)]) == (0.0, 1.0, 2.0)
    assert slider_marks([SceneMark(float(at), "") for at in range(1000)]) == tuple(17.0 * at for at in range(59))
    assert len(slider_marks([SceneMark(float(at), "") for at in range(MOST_SLIDER_MARKS)])) == MOST_SLIDER_MARKS
    assert slider_marks([SceneMark(1.2345, "")]) == (1.23,)


def test_what_is_cut_short_says_so() -> None:
    assert shortened("a long sentence", 7) == "a long…"
    assert shortened("a long sentence", 8) == "a long…"
    assert shortened("a long sentence", 15) == "a long sentence"
    assert len(shortened("x" * 91)) == 90


def test_the_button_plays_and_pauses_and_is_named_by_what_it_does(page: ViewPage) -> None:
    clock = PlayClock((10.0, 20.0))
    panel = panel_of(page, clock)
    button = page["Pause"]
    button.press()
    assert not clock.playing
    panel.update(0.0)
    assert button.label == "Play"
    button.press()
    panel.update(0.1)
    assert (clock.playing, button.label) == (True, "Pause")


def test_a_paused_page_begins_with_play_and_its_time(page: ViewPage) -> None:
    panel_of(page, PlayClock((10.0, 20.0), at_s=12.346))
    slider = page["Time (s)"]
    assert "Play" in page
    assert (slider.min, slider.max, slider.value) == (10.0, 20.0, 12.35)
    assert vars(slider)["marks"] == (2.0, 4.5, 9.0)


def test_the_slider_of_a_recording_of_one_instant_has_a_length(page: ViewPage) -> None:
    panel_of(page, PlayClock((10.0, 10.0)))
    assert (page["Time (s)"].min, page["Time (s)"].max) == (10.0, 10.05)


def test_the_slider_follows_the_clock_a_few_times_a_second_and_does_not_stop_it(page: ViewPage) -> None:
    clock = PlayClock((0.0, 20.0))
    panel = panel_of(page, clock)
    slider = page["Time (s)"]
    shown = []
    for now_s in (0.0, 0.1, 0.2, 0.35, 0.45):
        clock.advance(1.001)
        panel.update(now_s)
        shown.append(slider.value)
    assert shown == [1.0, 1.0, 3.0, 3.0, 5.0]
    assert clock.playing
    slider.choose(7.0)
    assert (clock.time_s, clock.playing) == (7.0, False)


def test_the_slider_stays_within_half_a_step_of_the_clock(page: ViewPage) -> None:
    clock = PlayClock((0.0, 20.0))
    panel = panel_of(page, clock)
    clock.advance(0.025)
    panel.update(0.0)
    assert page["Time (s)"].value == 0.0
    clock.advance(0.005)
    panel.update(0.0)
    assert page["Time (s)"].value == 0.03


def test_the_speed_is_chosen(page: ViewPage) -> None:
    clock = PlayClock((0.0, 20.0))
    panel_of(page, clock)
    page["Speed"].choose("0.25 ×")
    assert clock.advance(2.0) == 0.5


def test_an_event_of_the_list_is_jumped_to(page: ViewPage) -> None:
    clock = PlayClock((0.0, 20.0))
    panel_of(page, clock)
    events = page["Event"]
    assert vars(events)["options"] == ("–", "0:02.0 armed", "0:04.5 mode AUTO", "0:09.0 waypoint 1 reached")
    events.choose("0:04.5 mode AUTO")
    assert (clock.time_s, clock.playing) == (4.5, False)
    clock.jump(1.0)
    events.choose("–")
    events.value = "0:09.0 waypoint 1 reached"  # not by a user
    assert clock.time_s == 1.0


def test_events_are_stepped_through_in_both_directions_and_end_at_the_last(page: ViewPage) -> None:
    clock = PlayClock((0.0, 20.0), at_s=3.0)
    panel_of(page, clock)
    steps = page["Go to"]
    seen = []
    for step in ("event ▶", "event ▶", "event ▶", "◀ event", "◀ event", "◀ event"):
        steps.press(step)
        seen.append((clock.time_s, page["Event"].value.split()[1]))
    assert seen == [
        (4.5, "mode"),
        (9.0, "waypoint"),
        (9.0, "waypoint"),
        (4.5, "mode"),
        (2.0, "armed"),
        (2.0, "armed"),
    ]


def test_without_events_there_is_nothing_to_choose(page: ViewPage) -> None:
    panel_of(page, PlayClock((0.0, 20.0)), ())
    assert "Event" not in page
    assert "Go to" not in page


def test_findings_are_buttons_that_jump_to_a_second_before_them(page: ViewPage) -> None:
    clock = PlayClock((0.0, 100.0))
    panel = panel_of(page, clock)
    panel.show_findings(
        [
            SceneFinding(70.0, Severity.CRITICAL, "The vessel ran aground", "Look at the chart"),
            SceneFinding(None, Severity.WARNING, "No battery is recorded", "Connect it"),
        ]
    )
    assert "Findings (2)" in page
    aground, battery = page["1:10.0 The vessel ran aground"], page["No battery is recorded"]
    assert vars(aground)["hint"] == "The vessel ran aground. Look at the chart"
    assert (vars(aground)["color"], vars(battery)["color"]) == ("red", "orange")
    assert (aground.disabled, battery.disabled) == (False, True)
    aground.press()
    assert clock.time_s == 69.0
    battery.press()
    assert clock.time_s == 69.0


def test_an_analysis_without_findings_says_so(page: ViewPage) -> None:
    panel_of(page, PlayClock((0.0, 100.0))).show_findings([])
    assert "Findings (0)" in page
    assert not vars(page["Findings (0)"])["expand_by_default"]
    assert vars(page["markdown"])["content"] == "The log analysis has no findings."


def test_a_clock_does_not_play_before_its_begin_and_without_its_speed() -> None:
    clock = PlayClock((10.0, 20.0), at_s=-math.inf)
    assert (clock.time_s, clock.playing) == (10.0, False)
    clock.play(True)
    clock.run_at(0.0)
    assert clock.advance(5.0) == 10.0
    clock.play(False)
    clock.run_at(1.0)
    assert clock.advance(5.0) == 10.0
