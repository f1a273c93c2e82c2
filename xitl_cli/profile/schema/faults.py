"""`faults`: injected faults and their times; by name, so that profiles with faults can be composed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from sim_core.keys import Bounds, NonNegative, Share, Specification, Vector

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
    """Dropout, freeze and constants added to position and velocity."""

    position_bias_ned_m: Vector = _ZEROS
    velocity_bias_ned_mps: Vector = _ZEROS


@dataclass(frozen=True, slots=True, kw_only=True)
class MagnetometerFault(SensorFault):
    """Dropout, freeze and a constant added to the field."""

    field_bias_frd_gauss: Vector = _ZEROS


@dataclass(frozen=True, slots=True, kw_only=True)
class BarometerFault(SensorFault):
    """Dropout, freeze and a constant added to the pressure."""

    pressure_bias_pa: float = 0.0


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
