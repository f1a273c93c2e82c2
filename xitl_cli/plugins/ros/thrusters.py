"""Thrusters, gears and rudders of a vessel as ROS has them: names, links, joints and states."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

from sim_core.vessel.spec import Propeller, VesselSpec
from xitl_cli.plugins.ros.frames import FixedFrame, flu, flu_turn
from xitl_cli.record.topics import VESSEL_FRAME
from xitl_cli.replay.thruster_topics import thruster_names


@dataclass(frozen=True, slots=True)
class ThrusterLink:
    """A propeller or a rudder. speed, angle: where its share of full is in the rotor's state, None where it has none.

    limit_rad: of the angle; 0 where it does not turn. frame: its link, as it is at angle zero.
    """

    name: str
    frame: FixedFrame
    propeller: Propeller | None
    speed: int | None
    angle: int | None
    limit_rad: float

    @property
    def joint(self) -> str:
        """Of the robot description."""
        return f"{self.name}_joint"

    def turned(self, angle_rad: float) -> FixedFrame:
        """Its link at an angle, counter-clockwise seen from above."""
        x, y, z, w = self.frame.turn
        cosine, sine = math.cos(0.5 * angle_rad), math.sin(0.5 * angle_rad)
        turn = (x * cosine + y * sine, y * cosine - x * sine, z * cosine + w * sine, w * cosine - z * sine)
        return replace(self.frame, turn=turn)


@dataclass(frozen=True, slots=True)
class ThrusterState:
    """angle_rad: counter-clockwise seen from above. speed_radps: of the shaft, NaN unknown. thrust_n: as at rest."""

    angle_rad: float
    speed_radps: float
    thrust_n: float


def thrusters_of(vehicle: VesselSpec) -> tuple[ThrusterLink, ...]:
    """Propellers in their order, then rudders."""
    return (*_propellers(vehicle), *_rudders(vehicle))


def state_of(thruster: ThrusterLink, rotor: Sequence[float], water_density_kgpm3: float) -> ThrusterState:
    """From the rotor's state: speed of each propeller, then angle of each gear and rudder, share of full."""
    angle_rad = 0.0 if thruster.angle is None else rotor[thruster.angle] * thruster.limit_rad
    if thruster.propeller is None or thruster.speed is None:
        return ThrusterState(angle_rad, math.nan, math.nan)
    share = rotor[thruster.speed]
    ahead_n, astern_n = thruster.propeller.static_thrust_n(water_density_kgpm3)
    curve = thruster.propeller.open_water
    speed_radps = math.nan if curve is None else share * curve.max_speed_rps * math.tau
    return ThrusterState(angle_rad, speed_radps, share * abs(share) * (ahead_n if share > 0.0 else astern_n))


def _propellers(vehicle: VesselSpec) -> Iterator[ThrusterLink]:
    """A gear's angle turns the thrust to port for the bow to go to starboard, which is counter-clockwise."""
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
