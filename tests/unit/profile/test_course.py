"""Items of a mission file: places, defaults, and what is a fence or a rally point."""

from __future__ import annotations

import math

import pytest

from xitl_cli.profile.missions.course import FileItem, MissionFileError, mavlink_item, place_of, sorted_course

WAYPOINT, RETURN, CHANGE_SPEED = 16, 20, 178


@pytest.mark.parametrize("place", [(90.0, 180.0), (-90.0, -180.0), (0.0, 0.0)])
def test_the_whole_earth_has_places(place: tuple[float, float]) -> None:
    assert place_of(*place, "item 1") == place


@pytest.mark.parametrize("place", [(90.1, 0.0), (-90.1, 0.0), (0.0, 180.1), (0.0, -180.1), (math.nan, 0.0)])
def test_what_is_not_on_the_earth_is_refused_with_its_line(place: tuple[float, float]) -> None:
    with pytest.raises(
        MissionFileError, match=r"^item 1: latitude .*, longitude .* is not on the Earth; check the order"
    ) as refused:
        place_of(*place, "item 1", 7)
    assert refused.value.line == 7


def test_an_item_has_its_place_and_the_autopilots_defaults() -> None:
    item = mavlink_item(WAYPOINT, 3, (None, math.nan, 2.0, 0.0, 52.0, 13.0, 4.0), "item 2", 9)
    assert item == FileItem(WAYPOINT, (None, None, 2.0, 0.0), (52.0, 13.0), 4.0, 3, "item 2", 9)
    assert not item.is_plain
    plain = mavlink_item(WAYPOINT, 3, (0.0, None, 0.0, math.nan, 52.0, None, None), "item 2")
    assert (plain.place_deg, plain.altitude_m, plain.is_plain) == ((52.0, 0.0), 0.0, True)
    assert mavlink_item(WAYPOINT, 3, (0, 0, 0, 0, 0.0, 13.0, 0), "item 2").place_deg == (0.0, 13.0)


def test_zero_is_no_place() -> None:
    item = mavlink_item(WAYPOINT, 3, (0, 0, 0, 0, 0.0, 0.0, 5.0), "item 2")
    assert (item.place_deg, item.is_plain) == (None, False)
    assert not FileItem(RETURN, place_deg=(1.0, 2.0)).is_plain


def test_a_command_without_a_place_refuses_one() -> None:
    with pytest.raises(
        MissionFileError, match=r"item 3: command 178 \(.+\) has no place, but its parameters 5 and 6 are 1 and 0"
    ):
        mavlink_item(CHANGE_SPEED, 2, (1, 2, 3, 0, 1.0, 0.0, 0), "item 3")
    with pytest.raises(MissionFileError, match=r"item 3: command 60000 has no place"):
        mavlink_item(60_000, 2, (0, 0, 0, 0, 1.0, 0.0, 0), "item 3")
    assert mavlink_item(60_000, 3, (0, 0, 0, 0, 1.0, 0.0, 0), "item 3").place_deg == (1.0, 0.0)


def test_items_are_sorted_by_their_use() -> None:
    items = [FileItem(command) for command in (16, 5000, 5001, 5002, 5003, 5004, 5100, 20)]
    course = sorted_course(items, "waypoint")
    assert [item.command for item in course.items] == [16, 20]
    assert [item.command for item in course.fence] == [5000, 5001, 5002, 5003, 5004]
    assert [item.command for item in course.rally] == [5100]
    with pytest.raises(MissionFileError, match=r"^has no waypoint; draw at least one$"):
        sorted_course([], "waypoint")
