"""Declarations of nodes: needs are met by type, in any order, and what does not fit is one sentence."""

from __future__ import annotations

from contextlib import ExitStack

import pytest

from xitl_cli.run.composition.parts import CompositionError, Part, Parts, Place, made_parts, part
from xitl_cli.run.composition.vessel import VESSEL_PARTS
from xitl_cli.run.composition.world import WORLD_PARTS
from xitl_cli.run.core.node import RunNode


class Boat(RunNode):
    closed = False

    def close(self) -> None:
        self.closed = True


class Antenna(RunNode):
    closed = False

    def close(self) -> None:
        self.closed = True


class Radar(RunNode):
    def __init__(self, boat: Boat) -> None:
        self.boat = boat
        self.antenna = Antenna()


class Chart(RunNode):
    def __init__(self, radar: Radar | None) -> None:
        self.radar = radar


@part(Place.CONTROL)
def boat() -> Boat:
    return Boat()


@part(Place.COLLISIONS, also_at={Place.TICK: "antenna"})
def radar(boat: Boat) -> Radar:
    return Radar(boat)


@part(Place.TRACK)
def chart(radar: Radar | None) -> Chart:
    return Chart(radar)


def made(*declared: Part) -> Parts:
    with ExitStack() as opened:
        return made_parts(declared, {}, None, opened.pop_all())


def test_a_need_is_made_before_the_node_that_has_it_whatever_the_order_of_the_list() -> None:
    parts = made(chart, radar, boat)
    assert parts.need(Chart).radar is parts.need(Radar)
    assert parts.need(Radar).boat is parts.need(Boat)


def test_nodes_and_their_parts_are_called_in_the_order_of_their_places() -> None:
    parts = made(chart, boat, radar)
    found = parts.need(Radar)
    assert parts.nodes() == (found, found.antenna, parts.need(Boat), parts.need(Chart))
    assert parts.nodes(before=Place.CONTROL) == (found, found.antenna)
    assert parts.nodes(after=Place.CONTROL) == (parts.need(Chart),)


def test_a_node_and_its_parts_are_closed() -> None:
    with ExitStack() as opened:
        parts = made_parts((boat, radar), {}, None, opened)
    assert parts.need(Boat).closed
    assert parts.need(Radar).antenna.closed


def test_the_edges_of_the_graph_are_those_of_the_parts_that_were_made() -> None:
    buoy = Part("buoy", Boat, provides=("Chart",), edges=(("PS1", "M"),))
    absent = Part("absent", Boat, provides=("Radar",), when=lambda setup: False, edges=(("D", "M"),))
    nothing = Part("nothing", lambda: None, edges=(("D", "PS1"),))
    assert made(boat, buoy, absent, nothing).edges == (("PS1", "M"),)


def test_an_optional_need_may_be_absent() -> None:
    assert made(chart).need(Chart).radar is None


def test_a_missing_need_two_providers_and_a_circle_are_one_sentence_each() -> None:
    with pytest.raises(CompositionError, match=r"^radar needs Boat, which no node of this run provides$"):
        made(radar)

    @part(Place.CONTROL)
    def second_boat() -> Boat:
        return Boat()

    with pytest.raises(CompositionError, match=r"^second boat and boat both provide Boat; leave one out$"):
        made(boat, second_boat)

    @part(Place.CONTROL)
    def towed_boat(chart: Chart) -> Boat:
        return Boat()

    with pytest.raises(CompositionError, match=r"circle: towed boat → chart → radar → towed boat$"):
        made(towed_boat, radar, chart)


def test_a_part_that_the_setup_does_not_want_is_not_made_and_provides_nothing() -> None:
    @part(Place.CONTROL, when=lambda setup: setup is not None)
    def absent() -> Boat:
        raise AssertionError

    assert made(absent, boat).get(Boat) is not None


def test_what_was_made_is_closed_when_another_part_cannot_be() -> None:
    built: list[Boat] = []

    @part(Place.CONTROL)
    def kept() -> Boat:
        built.append(Boat())
        return built[0]

    with pytest.raises(CompositionError), ExitStack() as opened:
        made_parts((kept, radar_without_boat), {}, None, opened)
    assert built[0].closed


class Missing(RunNode):
    """Nobody provides it."""


@part(Place.TRACK)
def radar_without_boat(missing: Missing) -> Radar:
    raise AssertionError


def test_every_need_of_the_shipped_declarations_has_a_provider_among_them() -> None:
    for declared, given in ((VESSEL_PARTS, {"VesselSetup"}), (WORLD_PARTS, {"RunSetup", "AllVessels"})):
        provided = given | {kind for one in declared for kind in one.provides}
        assert {need.kind for one in declared for need in one.needs} <= provided
