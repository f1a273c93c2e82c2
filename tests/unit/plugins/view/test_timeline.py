"""The clock of a served recording, and what its page lists."""

from __future__ import annotations

import pytest

from xitl_cli.plugins.view.recording import SceneMark
from xitl_cli.plugins.view.timeline import MOST_SLIDER_MARKS, PlayClock, event_labels, shortened, slider_marks


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
    assert len(set(labels)) == 3
    assert labels[0] == "0:05.0 armed"
    assert len(labels[2]) < 80


def test_a_slider_has_no_more_marks_than_can_be_seen() -> None:
    assert slider_marks([SceneMark(float(at), "") for at in range(3)]) == (0.0, 1.0, 2.0)
    assert len(slider_marks([SceneMark(float(at), "") for at in range(1000)])) <= MOST_SLIDER_MARKS


def test_what_is_cut_short_says_so() -> None:
    assert shortened("a long sentence", 7) == "a long…"
