"""`faults`: injected faults and their times; by name, so that profiles with faults can be composed."""

from __future__ import annotations

from typing import Annotated, Literal

from sim_core.dataclass import dataclass
from sim_core.keys import Bounds, Direction, NonNegative, Share, Specification, Vector

AgentName = Literal["agent", "standby", "companion"]
Delay = Annotated[float, Bounds(at_least=0, at_most=60)]
_ZEROS = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkFault(Specification):
    """A bad link to an agent, frame by frame."""

    which: Annotated[AgentName, "name of the link"] = "agent"
    direction: Annotated[
        Literal["both", "sensors", "actuators"], "sensors: to the agent; actuators: from the agent"
    ] = "both"
    delay_s: Annotated[Delay, "delay of every frame"] = 0.0
    jitter_s: Annotated[Delay, "largest additional random delay"] = 0.0
    loss: Annotated[Share, "share of lost frames"] = 0.0
    duplicate: Annotated[Share, "share of duplicated frames"] = 0.0
    reorder: Annotated[Share, "share of reordered frames"] = 0.0
    cut: Annotated[bool, "no frame passes"] = False


@dataclass(frozen=True, slots=True, kw_only=True)
class AgentFault(Specification):
    """An overloaded computer, or a wrong clock."""

    which: Annotated[AgentName, "name of the agent"] = "agent"
    cpu_load: Annotated[Share, "share of every processor that is kept busy"] = 0.0
    clock_offset_s: Annotated[float, Bounds(at_least=0, at_most=100_000), "the clock is ahead by this time"] = 0.0
    clock_skew_ppm: Annotated[float, Bounds(at_least=-10_000, at_most=10_000), "the clock runs fast by this rate"] = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorFault(Specification):
    """Faults that can affect every sensor: missing samples and frozen values."""

    dropout: Annotated[Share, "share of missing samples"] = 0.0
    freeze: Annotated[bool, "values do not change"] = False


@dataclass(frozen=True, slots=True, kw_only=True)
class ImuFault(SensorFault):
    """Dropout, freeze and constant offsets of the IMU's measurements."""

    gyro_bias_frd_radps: Vector = _ZEROS
    accel_bias_frd_mps2: Vector = _ZEROS


@dataclass(frozen=True, slots=True, kw_only=True)
class GnssFault(SensorFault):
    """Dropout, freeze, constant offsets of position and velocity, and a position that drifts away.

    The drift begins at zero with the fault. It does not change the velocity, which a receiver measures by Doppler.
    """

    position_bias_ned_m: Vector = _ZEROS
    velocity_bias_ned_mps: Vector = _ZEROS
    drift_mps: Annotated[NonNegative, "speed of the position's drift"] = 0.0
    drift_bearing_deg: Annotated[Direction, "direction of the drift, from true north"] = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class MagnetometerFault(SensorFault):
    """Dropout, freeze and a constant offset of the field."""

    field_bias_frd_gauss: Vector = _ZEROS


@dataclass(frozen=True, slots=True, kw_only=True)
class BarometerFault(SensorFault):
    """Dropout, freeze and a constant offset of the pressure."""

    pressure_bias_pa: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PropellerFault(Specification):
    """A propeller that gives less thrust, does not follow its command, or turns the wrong way."""

    which: Annotated[
        str, "name, `propeller 0` and so on; `port` or `starboard` for the only propeller on that side"
    ] = "propeller 0"
    thrust_loss: Annotated[Share, "share of lost thrust, as with weed or a broken blade"] = 0.0
    stuck: Annotated[bool, "keeps its present speed"] = False
    stuck_at: Annotated[
        Annotated[float, Bounds(at_least=-1, at_most=1)] | None, "follows this command instead of the given one"
    ] = None
    reversed: Annotated[bool, "turns opposite to its command"] = False


@dataclass(frozen=True, slots=True, kw_only=True)
class RudderFault(Specification):
    """A rudder, or the gear that turns a propeller, that does not move."""

    which: Annotated[str | None, "name, `rudder 0` or `steering 0`; null: the first"] = None
    jam: Annotated[bool, "keeps its present angle"] = False
    jam_angle_deg: Annotated[
        Annotated[float, Bounds(at_least=-180, at_most=180)] | None,
        "moves to this angle and stays there; positive turns the bow to starboard",
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class BatteryFault(Specification):
    """A battery with too little voltage, which makes the propellers turn more slowly."""

    added_resistance_ohm: Annotated[NonNegative, "added resistance in series, as from a bad contact"] = 0.0
    failed_cells: Annotated[int, Bounds(at_least=0, at_most=1000), "number of failed cells among those in series"] = 0
    voltage_drop_v: Annotated[NonNegative, "voltage drop at any current"] = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultSpec(Specification):
    """A fault and its start and end in simulation time: [faults.md](faults.md).

    Another autopilot simulates its own GNSS, magnetometer and barometer unless it has `autopilot.bridge.sensors`.
    """

    from_s: NonNegative = 0.0
    until_s: Annotated[NonNegative | None, "ends before this instant; null: lasts to the end"] = None
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
