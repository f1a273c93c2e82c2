"""Sentences longer than one STATUSTEXT, from the agent's own chunks to the host's picture of it."""

from __future__ import annotations

import numpy as np
import pytest

from agent.mavlink.commands import StatusTextSender
from agent.wire import dialect
from agent.wire.codec import Packer, decode
from sim_core.geodesy import LocalFrame
from xitl_cli.record.topics import MotionEstimate
from xitl_cli.run.links.agent_view import AgentView


@pytest.mark.parametrize("length", [1, 49, 50, 51, 99, 100, 101, 250])
def test_a_sentence_arrives_whole_whatever_its_length(length: int) -> None:
    said: list[tuple[int, str]] = []
    view = AgentView(LocalFrame(-8.8, -63.95, 70.0), lambda *words: said.append(words), lambda *_: None)
    sentence = "".join(np.random.default_rng(length).choice(list("abcdef"), length))
    texts, packer = StatusTextSender(), Packer(1, 1)
    for text in (sentence, "and the next"):
        for message in texts.messages(4, text):
            view.handle(decode(packer.pack(message)))
    assert said == [(4, sentence), (4, "and the next")]
    assert list(view.texts) == [sentence, "and the next"]


@pytest.mark.parametrize(
    ("pair_ms", "older_ms", "told"), [(0, 0, True), (0, 20, False), (50, 50, True), (50, 51, False), (50, -20, False)]
)
def test_a_position_makes_an_estimate_with_an_attitude_that_is_not_too_old(
    pair_ms: int, older_ms: int, told: bool
) -> None:
    estimates: list[int] = []
    view = AgentView(LocalFrame(-8.8, -63.95, 70.0), lambda *_: None, lambda stamp_us, _: estimates.append(stamp_us))
    view.pair_ms = pair_ms
    assert not view.has_origin
    view.handle(dialect.MAVLink_gps_global_origin_message(-88000000, -639500000, 70000))
    assert view.has_origin
    view.handle(dialect.MAVLink_attitude_quaternion_message(1000 - older_ms, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    view.handle(dialect.MAVLink_local_position_ned_message(1000, 1.0, 2.0, 0.0, 0.0, 0.0, 0.0))
    assert estimates == ([1_000_000] if told else [])


def test_the_desired_heading_lasts_until_the_mode_changes() -> None:
    view = AgentView(LocalFrame(-8.8, -63.95, 70.0), lambda *_: None, lambda *_: None)

    def tell(mode: int, bearing_deg: int, distance_m: int) -> float | None:
        view.handle(dialect.MAVLink_heartbeat_message(10, 3, 0, mode, 4, 3))
        view.handle(dialect.MAVLink_nav_controller_output_message(0.0, 0.0, bearing_deg, 0, distance_m, 0.0, 0.0, 0.0))
        return view.desired_heading_deg

    auto, hold = 10, 4
    assert tell(auto, -90, 12) == 270.0
    assert tell(auto, 0, 12) == 0.0
    assert tell(auto, 0, 0) is None  # Rover's zeros without a target
    assert tell(auto, 45, 0) == 45.0
    view.handle(dialect.MAVLink_heartbeat_message(10, 3, 0, hold, 4, 3))
    assert view.desired_heading_deg is None


def test_the_deviation_of_the_heading_goes_with_the_estimate() -> None:
    estimates: list[MotionEstimate] = []
    view = AgentView(LocalFrame(-8.8, -63.95, 70.0), lambda *_: None, lambda _, estimate: estimates.append(estimate))
    packer = Packer(1, 1)
    view.handle(dialect.MAVLink_gps_global_origin_message(-88000000, -639500000, 70000))
    for values in ({}, {b"other": 0.5}, {b"yaw_std": 0.25}):
        for name, value in values.items():
            view.handle(decode(packer.pack(dialect.MAVLink_named_value_float_message(900, name, value))))
        view.handle(dialect.MAVLink_attitude_quaternion_message(1000, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
        view.handle(dialect.MAVLink_local_position_ned_message(1000, 1.0, 2.0, 0.0, 0.0, 0.0, 0.0))
    assert [estimate.yaw_deviation_rad for estimate in estimates] == [None, None, 0.25]


@pytest.mark.parametrize(("next_ms", "told"), [(1040, True), (1050, True), (1051, False)])
def test_a_position_without_an_attitude_before_it_takes_the_next(next_ms: int, told: bool) -> None:
    """PX4's streams come each at its own instants: two of 10 Hz may lie 100 ms apart."""
    estimates: list[int] = []
    view = AgentView(LocalFrame(-8.8, -63.95, 70.0), lambda *_: None, lambda stamp_us, _: estimates.append(stamp_us))
    view.pair_ms = 50
    view.handle(dialect.MAVLink_gps_global_origin_message(-88000000, -639500000, 70000))
    view.handle(dialect.MAVLink_attitude_quaternion_message(940, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    view.handle(dialect.MAVLink_local_position_ned_message(1000, 1.0, 2.0, 0.0, 0.0, 0.0, 0.0))
    assert estimates == []
    view.handle(dialect.MAVLink_attitude_quaternion_message(next_ms, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    view.handle(dialect.MAVLink_attitude_quaternion_message(next_ms + 10, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert estimates == ([1_000_000] if told else [])


# What ArduRover 4.7-dev sent at one and the same instant: GPS_GLOBAL_ORIGIN, GLOBAL_POSITION_INT, LOCAL_POSITION_NED.
SAID_AT_ONCE = [
    ((509999575, 69999997), (510002995, 70002772), (38.0642, 19.4468)),
    ((509999575, 69999997), (509999344, 70005738), (-2.5753, 40.2183)),
    ((-87998926, -639501502), (-87999096, -639500506), (-1.8938, 10.9629)),
    ((-87998926, -639501502), (-87990300, -639492721), (96.0253, 96.6094)),
]
GRAIN_M = 0.011  # of 1e-7 degrees


@pytest.mark.parametrize(("origin", "place", "local_m"), SAID_AT_ONCE)
def test_an_ardupilot_on_the_earth_is_where_it_says_in_degrees(
    origin: tuple[int, int], place: tuple[int, int], local_m: tuple[float, float]
) -> None:
    site = LocalFrame(origin[0] * 1e-7, origin[1] * 1e-7, 70.0)
    expected = site.ned(*np.array([[place[0] * 1e-7], [place[1] * 1e-7], [70.0]]))[0, :2]
    found = {}
    for sphere_metres in (False, True):
        estimates: list[MotionEstimate] = []
        view = AgentView(site, lambda *_: None, lambda _, estimate, into=estimates: into.append(estimate))
        view.sphere_metres = sphere_metres
        view.handle(dialect.MAVLink_gps_global_origin_message(*origin, 70000))
        view.handle(dialect.MAVLink_attitude_quaternion_message(1000, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
        view.handle(dialect.MAVLink_local_position_ned_message(1000, *local_m, 0.0, 0.0, 0.0, 0.0))
        found[sphere_metres] = estimates[0].pos_ned_m[:2]
    # Either end is rounded to the grain, and the filter told both from one state.
    assert found[True] == pytest.approx(expected, abs=2 * GRAIN_M)
    assert found[False] == pytest.approx(local_m, abs=1e-4)  # metres of a simulator's own world stay as they are
