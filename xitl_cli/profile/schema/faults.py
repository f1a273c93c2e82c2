"""`faults`: injected faults and their times; by name, so that profiles with faults can be composed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from sim_core.keys import Bounds, Direction, NonNegative, Share, Specification, Vector

AgentName = Literal["agent", "standby", "companion"]
Delay = Annotated[float, Bounds(at_least=0, at_most=60)]
_ZEROS = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkFault(Specification):
    """A bad link to an agent, frame by frame."""

    which: Annotated[AgentName, "whose link"] = "agent"
    direction: Annotated[Literal["both", "sensors", "actuators"], "sensors: to the agent; actuators: from it"] = "both"
    delay_s: Annotated[Delay, "of every frame"] = 0.0
    jitter_s: Annotated[Delay, "up to so much more"] = 0.0
    loss: Annotated[Share, "of the frames"] = 0.0
    duplicate: Annotated[Share, "of the frames"] = 0.0
    reorder: Annotated[Share, "of the frames"] = 0.0
    cut: Annotated[bool, "lets nothing through"] = False


@dataclass(frozen=True, slots=True, kw_only=True)
class AgentFault(Specification):
    """A bad computer."""

    which: Annotated[AgentName, "whose"] = "agent"
    cpu_load: Annotated[Share, "of every processor that is kept busy"] = 0.0
    clock_offset_s: Annotated[float, Bounds(at_least=0, at_most=100_000), "by which its clock is ahead"] = 0.0
    clock_skew_ppm: Annotated[float, Bounds(at_least=-10_000, at_most=10_000), "by which it runs fast"] = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorFault(Specification):
    """What can befall every sensor: samples that do not come, values that stand still."""

    dropout: Annotated[Share, "of the samples that do not come"] = 0.0
    freeze: Annotated[bool, "values stand still"] = False


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuFault(SensorFault):
    """Dropout, freeze and constants added to what the IMU measures."""

    gyro_bias_frd_radps: Vector = _ZEROS
    accel_bias_frd_mps2: Vector = _ZEROS


@dataclass(frozen=True, slots=True, kw_only=True)
class GnssFault(SensorFault):
    """Dropout, freeze, constants added to position and velocity, and a position that drifts away.

    The drift begins at zero with the fault. It leaves the velocity alone, which a receiver measures by Doppler.
    """

    position_bias_ned_m: Vector = _ZEROS
    velocity_bias_ned_mps: Vector = _ZEROS
    drift_mps: Annotated[NonNegative, "of the position"] = 0.0
    drift_bearing_deg: Annotated[Direction, "where it drifts to, from true north"] = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class MagnetometerFault(SensorFault):
    """Dropout, freeze and a constant added to the field."""

    field_bias_frd_gauss: Vector = _ZEROS


@dataclass(frozen=True, slots=True, kw_only=True)
class BarometerFault(SensorFault):
    """Dropout, freeze and a constant added to the pressure."""

    pressure_bias_pa: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PropellerFault(Specification):
    """A propeller that gives less thrust, does not obey, or turns the wrong way."""

    which: Annotated[str, "by its name, `propeller 0` and so on; `port` or `starboard` for the only one there"] = (
        "propeller 0"
    )
    thrust_loss: Annotated[Share, "of its thrust, as with weed or a broken blade"] = 0.0
    stuck: Annotated[bool, "goes on at the speed that it has"] = False
    stuck_at: Annotated[
        Annotated[float, Bounds(at_least=-1, at_most=1)] | None, "this command in place of what it is given"
    ] = None
    reversed: Annotated[bool, "turns against its command"] = False


@dataclass(frozen=True, slots=True, kw_only=True)
class RudderFault(Specification):
    """A rudder, or the gear that turns a propeller, that no longer moves."""

    which: Annotated[str | None, "by its name, `rudder 0` or `steering 0`; null: the first"] = None
    jam: Annotated[bool, "stays at the angle that it has"] = False
    jam_angle_deg: Annotated[
        Annotated[float, Bounds(at_least=-180, at_most=180)] | None,
        "goes there and stays; positive turns the bow to starboard",
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class BatteryFault(Specification):
    """A battery with less voltage than it should have, so that the propellers turn more slowly."""

    added_resistance_ohm: Annotated[NonNegative, "in series, as of a bad contact"] = 0.0
    failed_cells: Annotated[int, Bounds(at_least=0, at_most=1000), "of those in series"] = 0
    voltage_drop_v: Annotated[NonNegative, "whatever the current"] = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultSpec(Specification):
    """What goes wrong, and when, in simulation time: [faults.md](faults.md).

    Another autopilot simulates its own GNSS, magnetometer and barometer unless it has `autopilot.bridge.sensors`.
    """

    from_s: NonNegative = 0.0
    until_s: Annotated[NonNegative | None, "to before this instant; null: to the end"] = None
    link: LinkFault | None = None
    agent: AgentFault | None = None
    imu: ImuFault | None = None
    gnss: GnssFault | None = None
    magnetometer: MagnetometerFault | None = None
    barometer: BarometerFault | None = None
    propeller: PropellerFault | None = None
    rudder: RudderFault | None = None
    battery: BatteryFault | None = None


FAULT_GROUPS = ("link", "agent", "imu", "gnss", "magnetometer", "barometer", "propeller", "rudder", "battery")
"""What can go wrong, by the keys of FaultSpec."""
