"""The vessel in ROS: its thrusters, gears and rudders with their states, and its URDF.

Hulls are boxes and cylinders, because a remote viewer cannot read a mesh file of this machine.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.frames import quat_to_euler
from sim_core.vessel.spec import Propeller, VesselSpec
from xitl_cli.plugins.ros.frames import FixedFrame, Vector, flu, flu_turn, frame_name, sensor_frames
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.topics import VESSEL_FRAME
from xitl_cli.replay.thrust_log import thruster_names

_WHITE, _DARK, _SENSOR = "0.92 0.93 0.95 1", "0.2 0.22 0.25 1", "0.1 0.4 0.7 1"
_SENSOR_M = 0.03
_GUESS_SHARE = {"air": 0.25, "water": 0.08}
"""Diameter of a propeller without one in its data, as a share of the vessel's length."""
_ANY_EFFORT, _ANY_RATE = "0", "0"


@dataclass(frozen=True, slots=True)
class ThrusterLink:
    """A propeller or a rudder."""

    name: str
    frame: FixedFrame
    """Link at angle zero."""
    propeller: Propeller | None
    speed: int | None
    """Index of its share of full speed in the rotor's state, None without one."""
    angle: int | None
    """Index of its share of full angle in the rotor's state, None without one."""
    limit_rad: float
    """Limit of the angle; 0 if it does not turn."""

    @property
    def joint(self) -> str:
        """Name of its joint in the robot description."""
        return f"{self.name}_joint"

    def turned(self, angle_rad: float) -> FixedFrame:
        """Return its link at an angle, counter-clockwise seen from above."""
        x, y, z, w = self.frame.turn
        cosine, sine = math.cos(0.5 * angle_rad), math.sin(0.5 * angle_rad)
        turn = (x * cosine + y * sine, y * cosine - x * sine, z * cosine + w * sine, w * cosine - z * sine)
        return replace(self.frame, turn=turn)


@dataclass(frozen=True, slots=True)
class ThrusterState:
    """State of a thruster."""

    angle_rad: float
    """Counter-clockwise seen from above."""
    speed_radps: float
    """Speed of the shaft, NaN if unknown."""
    thrust_n: float
    """Thrust at rest."""


def thrusters_of(vehicle: VesselSpec) -> tuple[ThrusterLink, ...]:
    """Return propellers in their order, then rudders.

    A gear turns the thrust to port, counter-clockwise, for the bow to go to starboard.
    """
    links: list[ThrusterLink] = []
    angles = iter(range(len(vehicle.propellers), vehicle.own_commands))
    for number, (name, propeller) in enumerate(zip(thruster_names(vehicle), vehicle.propellers, strict=True)):
        turn = flu_turn(0.0, 0.0, math.radians(propeller.angle_deg))
        frame = FixedFrame(VESSEL_FRAME, f"{name}_link", flu(propeller.position_frd_m), turn)
        gear = propeller.steering
        limit_rad = 0.0 if gear is None else math.radians(gear.max_angle_deg)
        links.append(ThrusterLink(name, frame, propeller, number, None if gear is None else next(angles), limit_rad))
    first = vehicle.own_commands - len(vehicle.rudders)
    for number, rudder in enumerate(vehicle.rudders):
        name = f"rudder_{number}"
        frame = FixedFrame(VESSEL_FRAME, f"{name}_link", flu(rudder.position_frd_m))
        links.append(ThrusterLink(name, frame, None, None, first + number, math.radians(rudder.max_angle_deg)))
    return tuple(links)


def state_of(thruster: ThrusterLink, rotor: Sequence[float], water_density_kgpm3: float) -> ThrusterState:
    """Return the state. rotor: speed of each propeller, then angle of each gear and rudder, as shares of full."""
    angle_rad = 0.0 if thruster.angle is None else rotor[thruster.angle] * thruster.limit_rad
    if thruster.propeller is None or thruster.speed is None:
        return ThrusterState(angle_rad, math.nan, math.nan)
    share = rotor[thruster.speed]
    ahead_n, astern_n = thruster.propeller.static_thrust_n(water_density_kgpm3)
    curve = thruster.propeller.open_water
    speed_radps = math.nan if curve is None else share * curve.max_speed_rps * math.tau
    return ThrusterState(angle_rad, speed_radps, share * abs(share) * (ahead_n if share > 0.0 else astern_n))


def make_robot_description(profile: RunProfile) -> str:
    """Return the XML of the vessel. With several vessels, links and joints have its name."""
    vehicle, vessel = profile.vehicle, profile.vessel
    robot = Element("robot", name=vessel or vehicle.name.replace(" ", "_"))
    base = SubElement(robot, "link", name=frame_name(VESSEL_FRAME, vessel))
    # Products of inertia with one reversed axis change sign
    inertial = SubElement(base, "inertial")
    SubElement(inertial, "origin", xyz=_numbers(flu(vehicle.centre_of_gravity_frd_m)), rpy="0 0 0")
    SubElement(inertial, "mass", value=_number(vehicle.mass_kg))
    ixx, iyy, izz = vehicle.inertia_kgm2
    ixy, ixz, iyz = vehicle.inertia_products_kgm2
    entries = {"ixx": ixx, "ixy": ixy, "ixz": ixz, "iyy": iyy, "iyz": -iyz, "izz": izz}
    SubElement(inertial, "inertia", {name: _number(value) for name, value in entries.items()})
    for hull in vehicle.demi_hulls:
        forward, left, up = flu(hull.keel_frd_m)
        middle = (forward, left, up + 0.5 * hull.height_m)
        if hull.prismatic and hull.section is not None and hull.section.radius_m is not None:
            size = {"radius": _number(hull.section.radius_m), "length": _number(hull.length_m)}
            _shape(base, "cylinder", size, middle, (0.0, 0.5 * math.pi, 0.0), _WHITE)
        else:
            size = {"size": _numbers((hull.length_m, hull.width_m, hull.height_m))}
            _shape(base, "box", size, middle, (0.0, 0.0, 0.0), _WHITE)
    for thruster in thrusters_of(vehicle):
        _thruster(robot, thruster, vehicle, vessel)
    for frame in sensor_frames(profile):
        link = SubElement(robot, "link", name=frame_name(frame.name, vessel))
        _shape(link, "box", {"size": _numbers([_SENSOR_M] * 3)}, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), _SENSOR, solid=False)
        _joint(robot, "fixed", frame.name.replace("_link", "_joint"), frame, vessel)
    indent(robot)
    return '<?xml version="1.0"?>\n' + tostring(robot, encoding="unicode") + "\n"


def _thruster(robot: Element, thruster: ThrusterLink, vehicle: VesselSpec, vessel: str) -> None:
    link = SubElement(robot, "link", name=frame_name(thruster.frame.name, vessel))
    propeller = thruster.propeller
    if propeller is not None:
        diameter_m = propeller.disc_diameter_m or _GUESS_SHARE[propeller.medium] * vehicle.length_m
        size = {"radius": _number(0.5 * diameter_m), "length": _number(0.12 * diameter_m)}
        _shape(link, "cylinder", size, (0.0, 0.0, 0.0), (0.0, 0.5 * math.pi, 0.0), _DARK, solid=False)
    else:
        rudder = vehicle.rudders[int(thruster.name.rpartition("_")[2])]
        chord_m = math.sqrt(rudder.area_m2 / rudder.aspect_ratio)
        size = {"size": _numbers((chord_m, 0.12 * chord_m, rudder.aspect_ratio * chord_m))}
        _shape(link, "box", size, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), _DARK, solid=False)
    if not thruster.limit_rad:
        _joint(robot, "fixed", thruster.joint, thruster.frame, vessel)
        return
    joint = _joint(robot, "revolute", thruster.joint, thruster.frame, vessel)
    SubElement(joint, "axis", xyz="0 0 1")
    limit = _number(thruster.limit_rad)
    SubElement(joint, "limit", lower=f"-{limit}", upper=limit, effort=_ANY_EFFORT, velocity=_ANY_RATE)


def _joint(robot: Element, kind: str, name: str, frame: FixedFrame, vessel: str) -> Element:
    joint = SubElement(robot, "joint", name=frame_name(name, vessel), type=kind)
    SubElement(joint, "parent", link=frame_name(frame.parent, vessel))
    SubElement(joint, "child", link=frame_name(frame.name, vessel))
    x, y, z, w = frame.turn
    roll, pitch, yaw = quat_to_euler(np.array([w, x, y, z])).tolist()  # about fixed axes, as in URDF
    SubElement(joint, "origin", xyz=_numbers(frame.position_m), rpy=_numbers((roll, pitch, yaw)))
    return joint


def _shape(
    link: Element, kind: str, size: dict[str, str], place: Vector, euler: Vector, colour: str, solid: bool = True
) -> None:
    """Add the visual shape and, for a solid, the collision shape."""
    for role in ("visual", "collision") if solid else ("visual",):
        part = SubElement(link, role)
        SubElement(part, "origin", xyz=_numbers(place), rpy=_numbers(euler))
        SubElement(SubElement(part, "geometry"), kind, size)
        if role == "visual":
            SubElement(SubElement(part, "material", name=f"colour {colour}"), "color", rgba=colour)


def _number(value: float) -> str:
    return f"{value + 0.0:.9g}"


def _numbers(values: Vector | list[float]) -> str:
    return " ".join(map(_number, values))
