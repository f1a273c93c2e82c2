"""The URDF against the vehicle file and against the transforms that are published beside it."""

from __future__ import annotations

import math
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sim_core.vessel.spec import Rudder, SteeringGear
from xitl_cli.plugins.ros.conversion import RosConversion
from xitl_cli.plugins.ros.definitions import deserialize
from xitl_cli.plugins.ros.robot_description import make_robot_description
from xitl_cli.profile.load import load_profile
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.topics import TOPICS


@pytest.fixture(scope="module")
def profile() -> RunProfile:
    return load_profile("sitl-perception").runnable()


@pytest.fixture(scope="module")
def steered(profile: RunProfile) -> RunProfile:
    """With a gear on the second propeller and a rudder, and products of inertia."""
    port, starboard = profile.vehicle.propellers
    geared = replace(starboard, steering=SteeringGear(max_angle_deg=30.0, rate_degps=60.0))
    rudder = Rudder(position_frd_m=(-1.0, 0.3, 0.2), area_m2=0.04, aspect_ratio=1.0, max_angle_deg=35.0)
    vehicle = replace(
        profile.vehicle,
        propellers=(port, geared),
        rudders=(rudder,),
        inertia_products_kgm2=(1.0, 2.0, 3.0),
        centre_of_gravity_frd_m=(0.1, 0.2, 0.3),
    )
    return replace(profile, vehicle=vehicle)


def numbers(text: str | None) -> list[float]:
    return [float(part) for part in (text or "").split()]


def test_joints_lie_where_the_static_transforms_are(profile: RunProfile) -> None:
    robot = ElementTree.fromstring(make_robot_description(profile))
    static = next(iter(RosConversion([profile]).static()))
    transforms = {each.child_frame_id: each for each in deserialize(static.cdr, static.topic.type).transforms}
    joints = {joint.find("child").get("link"): joint for joint in robot.findall("joint")}  # type: ignore[union-attr]
    assert set(joints) == set(transforms) - {"odom"}
    assert {"imu_link", "gnss_link", "lidar_link", "sonar_link", "left_link", "right_link"} <= set(joints)
    for link, joint in joints.items():
        origin, found = joint.find("origin"), transforms[link].transform
        assert origin is not None
        place, turn = found.translation, found.rotation
        assert numbers(origin.get("xyz")) == pytest.approx([place.x, place.y, place.z], abs=1e-9)
        urdf = Rotation.from_euler("xyz", numbers(origin.get("rpy")))  # about fixed axes, as URDF says
        assert (urdf.inv() * Rotation.from_quat([turn.x, turn.y, turn.z, turn.w])).magnitude() < 1e-8


def test_it_is_one_tree_from_base_link(steered: RunProfile) -> None:
    robot = ElementTree.fromstring(make_robot_description(replace(steered, vessel="alpha")))
    links = [link.get("name") for link in robot.findall("link")]
    parents = {joint.find("child").get("link"): joint.find("parent").get("link") for joint in robot.findall("joint")}  # type: ignore[union-attr]
    assert len(set(links)) == len(links)
    assert set(links) - set(parents) == {"alpha/base_link"}
    assert set(parents.values()) == {"alpha/base_link"}


def test_inertia_is_the_bodys_in_axes_forward_left_up(steered: RunProfile) -> None:
    """The tensor of the vehicle file, its products taken off the diagonal, turned into FLU."""
    vehicle = steered.vehicle
    ixx, iyy, izz = vehicle.inertia_kgm2
    frd = np.array([[ixx, -1.0, -2.0], [-1.0, iyy, -3.0], [-2.0, -3.0, izz]])
    flip = np.diag([1.0, -1.0, -1.0])
    inertial = ElementTree.fromstring(make_robot_description(steered)).find("link/inertial")
    assert inertial is not None
    found = {name: float(value) for name, value in inertial.find("inertia").items()}  # type: ignore[union-attr]
    rows = [[found["ixx"], found["ixy"], found["ixz"]], [found["ixy"], found["iyy"], found["iyz"]]]
    assert np.array([*rows, [found["ixz"], found["iyz"], found["izz"]]]) == pytest.approx(flip @ frd @ flip)
    assert numbers(inertial.find("origin").get("xyz")) == pytest.approx([0.1, -0.2, -0.3])  # type: ignore[union-attr]
    assert float(inertial.find("mass").get("value") or 0.0) == vehicle.mass_kg  # type: ignore[union-attr]


def test_gears_and_rudders_turn_and_their_links_with_them(steered: RunProfile) -> None:
    robot = ElementTree.fromstring(make_robot_description(steered))
    turning = {joint.get("name"): joint for joint in robot.findall("joint") if joint.get("type") == "revolute"}
    assert set(turning) == {"right_joint", "rudder_0_joint"}
    limit = turning["right_joint"].find("limit")
    assert limit is not None
    assert numbers(limit.get("upper")) == pytest.approx([math.radians(30.0)])
    encode = TOPICS["/truth/state"].message_type().encode
    zeros = [0.0, 0.0, 0.0]
    payload = encode(0, zeros, zeros, zeros, [1.0, 0.0, 0.0, 0.0], zeros, [0.5, -1.0, 0.5, -1.0])
    conversion = RosConversion([steered])
    found = list(conversion.convert("/truth/state", payload, 0))
    states = {m.topic.name: deserialize(m.cdr, m.topic.type) for m in found}
    assert states["joint_states"].name == ["right_joint", "rudder_0_joint"]
    angles = [math.radians(15.0), -math.radians(35.0)]
    assert states["joint_states"].position.tolist() == pytest.approx(angles)
    for transform, angle in zip(states["/tf"].transforms, angles, strict=True):
        turn = transform.transform.rotation
        euler = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).as_euler("xyz")
        assert euler.tolist() == pytest.approx([0.0, 0.0, angle], abs=1e-12)
    assert list(conversion.convert("/truth/state", payload, 50_000_000)) == []  # 10 Hz


def test_thrust_is_that_of_the_vehicle_file_by_the_square_of_the_speed(steered: RunProfile) -> None:
    port, starboard = steered.vehicle.propellers
    zeros = [0.0, 0.0, 0.0]
    encode = TOPICS["/truth/state"].message_type().encode
    payload = encode(0, zeros, zeros, zeros, [1.0, 0.0, 0.0, 0.0], zeros, [0.5, -1.0, 0.0, 0.0])
    found = {
        m.topic.name: deserialize(m.cdr, m.topic.type)
        for m in RosConversion([steered]).convert("/truth/state", payload, 0)
    }
    left, right = found["thrusters/left/state"], found["thrusters/right/state"]
    assert left.effort.tolist() == pytest.approx([0.25 * (port.max_thrust_n or 0.0)])
    assert right.effort.tolist() == pytest.approx([-(starboard.max_reverse_thrust_n or 0.0)])
    assert math.isnan(left.velocity[0])  # the vehicle file gives no speed of the shaft
    assert math.isnan(found["thrusters/rudder_0/state"].effort[0])


@pytest.mark.parametrize("base", ["vehicles/otter", "vehicles/wamv16", "vehicles/heron", "vehicles/cybership2"])
def test_shipped_vessels_have_a_description(base: str) -> None:
    from xitl_cli.profile.files.catalogue import find_profile
    from xitl_cli.profile.load import load_with_origins

    assert find_profile(base)
    profile = load_with_origins("mitl", parts=[base]).runnable()
    robot = ElementTree.fromstring(make_robot_description(profile))
    assert len(robot.findall("link")) >= 1 + len(profile.vehicle.propellers)
