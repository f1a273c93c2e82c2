"""`ros.topics`: what a user calls otherwise, leaves out and adds."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from agent.wire import dialect
from agent.wire.codec import Packer
from xitl_cli.errors import UserError
from xitl_cli.plugins.ros.conversion import RosConversion
from xitl_cli.plugins.ros.definitions import deserialize
from xitl_cli.plugins.ros.outputs import check_topics
from xitl_cli.profile.load import load_profile
from xitl_cli.profile.schema import RunProfile
from xitl_cli.profile.schema.ros import RosSpec, RosTopicSpec
from xitl_cli.record.topics import TOPICS


@pytest.fixture(scope="module")
def profile() -> RunProfile:
    return load_profile("sitl").runnable()


def converting(profile: RunProfile, **topics: RosTopicSpec) -> RosConversion:
    return RosConversion([replace(profile, ros=RosSpec(topics=topics))])


def environment(conversion: RosConversion) -> dict[str, Any]:
    payload = TOPICS["/environment"].message_type().encode(0, [0.5, 0.0, 0.0], [3.0, -4.0, 0.0], 0.25)
    found = conversion.convert("/environment", payload, 0)
    return {message.topic.full_name(message.vessel): deserialize(message.cdr, message.topic.type) for message in found}


def test_a_topic_is_called_otherwise(profile: RunProfile) -> None:
    found = environment(converting(profile, wind=RosTopicSpec(name="weather/wind")))
    assert set(found) == {"/weather/wind", "/current"}


def test_a_topic_is_left_out(profile: RunProfile) -> None:
    conversion = converting(profile, wind=RosTopicSpec(publish=False), mission=RosTopicSpec(publish=False))
    assert set(environment(conversion)) == {"/current"}
    assert not {"wind", "mission"} & {topic.name for topic, _ in conversion.topics()}
    assert "mission" not in {message.topic.name for message in conversion.static()}


def test_a_field_of_a_recorded_message_is_a_topic(profile: RunProfile) -> None:
    conversion = converting(
        profile,
        waterline=RosTopicSpec(of="/environment", field="surface_elevation_m"),
        **{"wind/east": RosTopicSpec(of="/environment", field="wind_ned_mps[1]", type="std_msgs/msg/Float32")},
        all_of_it=RosTopicSpec(of="/environment", field="wind_ned_mps", type="std_msgs/msg/Float64MultiArray"),
    )
    found = environment(conversion)
    assert (found["/waterline"].data, found["/wind/east"].data) == (0.25, -4.0)
    assert found["/all_of_it"].data.tolist() == [3.0, -4.0, 0.0]
    assert {"/wind", "/current"} <= set(found)
    assert "waterline" in {topic.name for topic, _ in conversion.topics()}


def test_a_recorded_message_goes_out_as_it_is(profile: RunProfile) -> None:
    found = environment(converting(profile, surroundings=RosTopicSpec(of="/environment")))
    assert found["/surroundings"].surface_elevation_m == 0.25


def test_a_field_within_a_field_and_of_mavlink(profile: RunProfile) -> None:
    conversion = converting(
        profile,
        speed=RosTopicSpec(of="/link/agent/rx", message="VFR_HUD", field="groundspeed"),
        north=RosTopicSpec(of="/truth/odometry", field="pose.pose.position.y"),
    )
    encode = TOPICS["/link/{link}/rx"].message_type().encode
    hud, beat = (
        encode(0, Packer(1, 1).pack(message))
        for message in (
            dialect.MAVLink_vfr_hud_message(0.0, 2.5, 90, 0, 0.0, 0.0),
            dialect.MAVLink_system_time_message(0, 0),
        )
    )
    (message,) = conversion.convert("/link/agent/rx", hud, 0)
    assert deserialize(message.cdr, message.topic.type).data == 2.5
    assert list(conversion.convert("/link/agent/rx", beat, 0)) == []
    zeros = [0.0] * 36
    odometry = (
        TOPICS["/truth/odometry"]
        .message_type()
        .encode(0, "map", "base_link", [1.0, 2.0, 3.0], [0.0, 0.0, 0.0, 1.0], zeros, [0.0] * 6, zeros)
    )
    found = {m.topic.name: m for m in conversion.convert("/truth/odometry", odometry, 0)}
    assert deserialize(found["north"].cdr, "std_msgs/msg/Float64").data == 2.0


def test_an_element_that_is_not_there_is_no_message(profile: RunProfile) -> None:
    assert "/far" not in environment(converting(profile, far=RosTopicSpec(of="/environment", field="wind_ned_mps[7]")))


@pytest.mark.parametrize(
    ("name", "asked", "words"),
    [
        ("imu/dat", RosTopicSpec(rate_hz=1.0), "did you mean 'imu/data'"),
        ("wind", RosTopicSpec(field="x"), "with `of`"),
        ("wind", RosTopicSpec(of="/environment"), "omit `of`"),
        ("wind", RosTopicSpec(name="current"), "already exists"),
        ("wind", RosTopicSpec(name="3d"), "is not a name of ROS"),
        ("mine", RosTopicSpec(of="/tf"), "is not a recorded topic"),
        ("mine", RosTopicSpec(of="/environment", field="speed"), "use current_ned_mps, wind_ned_mps"),
        (
            "mine",
            RosTopicSpec(of="/environment", field="wind_ned_mps[", type="std_msgs/msg/Float64"),
            "is not a field of",
        ),
        (
            "mine",
            RosTopicSpec(of="/environment", field="wind_ned_mps", type="nav_msgs/msg/Path"),
            "is not a type for a field",
        ),
        ("mine", RosTopicSpec(of="/link/agent/rx", message="VFR_HUT", field="x"), "did you mean VFR_HUD"),
        ("mine", RosTopicSpec(of="/link/agent/rx", message="VFR_HUD"), "needs a field"),
        ("mine", RosTopicSpec(of="/environment", message="VFR_HUD"), "is for the frames of a link"),
        ("range/{rangefinder}", RosTopicSpec(name="depth"), "cannot be renamed"),
    ],
)
def test_what_cannot_be_is_refused_by_its_key(name: str, asked: RosTopicSpec, words: str) -> None:
    with pytest.raises(UserError, match=r"ros\.topics\.") as refusal:
        check_topics(RosSpec(topics={name: asked}))
    assert words in str(refusal.value)


def test_one_of_several_is_a_topic_that_a_run_has() -> None:
    check_topics(RosSpec(topics={"range/rangefinder_1": RosTopicSpec(rate_hz=2.0)}))


def test_what_moves_base_link_is_chosen(profile: RunProfile) -> None:
    zeros = [0.0] * 36
    payload = (
        TOPICS["/truth/odometry"]
        .message_type()
        .encode(10**9, "map", "base_link", [1.0, 2.0, 3.0], [0.0, 0.0, 0.0, 1.0], zeros, [0.0] * 6, zeros)
    )
    moved = {}
    for chosen in ("auto", "estimate", "truth", "none"):
        conversion = RosConversion([replace(profile, ros=RosSpec(tf=chosen))])  # type: ignore[arg-type]
        moved[chosen] = [
            topic
            for topic in ("/truth/odometry", "/estimate/odometry")
            if any(message.topic.name == "/tf" for message in conversion.convert(topic, payload, 10**9))
        ]
    estimate, truth = ["/estimate/odometry"], ["/truth/odometry"]
    assert moved == {"auto": estimate, "estimate": estimate, "truth": truth, "none": []}
