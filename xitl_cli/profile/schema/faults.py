"""`faults`: what goes wrong on purpose, and when; by name, so that profiles with faults can be put together."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from xitl_cli.profile.schema.group import Group, NonNegative, Vector

Share = Annotated[float, Field(ge=0, le=1)]
_ZEROS = (0.0, 0.0, 0.0)


class LinkFault(Group):
    """A bad link, to `which` agent. `direction`: to the agent (sensors), from it (actuators), or both.

    Every frame is kept back for `delay_s` and up to `jitter_s` more; `loss`, `duplicate` and `reorder` are shares of
    the frames; `cut` lets nothing through.
    """

    which: Literal["agent", "standby", "companion"] = "agent"
    direction: Literal["both", "sensors", "actuators"] = "both"
    delay_s: Annotated[float, Field(ge=0, le=60)] = 0.0
    jitter_s: Annotated[float, Field(ge=0, le=60)] = 0.0
    loss: Share = 0.0
    duplicate: Share = 0.0
    reorder: Share = 0.0
    cut: bool = False


class AgentFault(Group):
    """A bad computer, that of `which` agent.

    A share of every processor is kept busy; the clock is ahead by an offset, and runs fast.
    """

    which: Literal["agent", "standby", "companion"] = "agent"
    cpu_load: Share = 0.0
    clock_offset_s: Annotated[float, Field(ge=0, le=100_000)] = 0.0
    clock_skew_ppm: Annotated[float, Field(ge=-10_000, le=10_000)] = 0.0


class SensorFault(Group):
    """What can befall every sensor: samples that do not come, values that stand still."""

    dropout: Share = 0.0
    freeze: bool = False


class ImuFault(SensorFault):
    """The same, and constants added to what it measures."""

    gyro_bias_frd_radps: Vector = _ZEROS
    accel_bias_frd_mps2: Vector = _ZEROS


class GnssFault(SensorFault):
    """The same, and constants added to position and velocity."""

    position_bias_ned_m: Vector = _ZEROS
    velocity_bias_ned_mps: Vector = _ZEROS


class MagnetometerFault(SensorFault):
    """The same, and a constant added to the field."""

    field_bias_frd_gauss: Vector = _ZEROS


class BarometerFault(SensorFault):
    """The same, and a constant added to the pressure."""

    pressure_bias_pa: float = 0.0


class Fault(Group):
    """What goes wrong from `from_s` to before `until_s` (null: to the end), in simulation time."""

    from_s: NonNegative = 0.0
    until_s: NonNegative | None = None
    link: LinkFault | None = None
    agent: AgentFault | None = None
    imu: ImuFault | None = None
    gnss: GnssFault | None = None
    magnetometer: MagnetometerFault | None = None
    barometer: BarometerFault | None = None
