"""Thrusters, gears and rudders of a vessel for ROS: names, links, joints and states."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from sim_core.vessel.spec import Propeller, VesselSpec
from xitl_cli.plugins.ros.frames import FixedFrame, flu, flu_turn
from xitl_cli.record.topics import VESSEL_FRAME
from xitl_cli.replay.thrust_log import thruster_names


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
    """Return propellers in their order, then rudders."""
    return (*_propellers(vehicle), *_rudders(vehicle))


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


def _propellers(vehicle: VesselSpec) -> Iterator[ThrusterLink]:
    """Yield propellers. A gear turns the thrust to port, counter-clockwise, for the bow to go to starboard."""
    angles = iter(range(len(vehicle.propellers), vehicle.commands))
    for number, (name, propeller) in enumerate(zip(thruster_names(vehicle), vehicle.propellers, strict=True)):
        turn = flu_turn(0.0, 0.0, math.radians(propeller.angle_deg))
        frame = FixedFrame(VESSEL_FRAME, f"{name}_link", flu(propeller.position_frd_m), turn)
        gear = propeller.steering
        limit_rad = 0.0 if gear is None else math.radians(gear.max_angle_deg)
        yield ThrusterLink(name, frame, propeller, number, None if gear is None else next(angles), limit_rad)


def _rudders(vehicle: VesselSpec) -> Iterator[ThrusterLink]:
    first = vehicle.commands - len(vehicle.rudders)
    for number, rudder in enumerate(vehicle.rudders):
        name = f"rudder_{number}"
        frame = FixedFrame(VESSEL_FRAME, f"{name}_link", flu(rudder.position_frd_m))
        yield ThrusterLink(name, frame, None, None, first + number, math.radians(rudder.max_angle_deg))
