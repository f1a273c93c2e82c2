"""`environment`: water, current, waves and wind. The defaults are still water and still air."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from xitl_cli.profile.schema.group import Direction, Group, NonNegative, Positive


class Water(Group):
    """The still water; `level_m` is up-positive above the local origin."""

    density_kgpm3: Positive = 997.8
    level_m: float = -0.01
    depth_m: Annotated[float, Field(ge=0.1, le=12_000)] = 20.0


class Current(Group):
    """A current toward `direction_deg`, its speed a first-order Gauss-Markov process.

    With a `channel_width_m` it slackens to `channel_bank_ratio` of its speed toward two straight banks along it.
    """

    speed_mps: Annotated[float, Field(ge=0, le=20)] = 0.0
    direction_deg: Direction = 0.0
    deviation_mps: NonNegative = 0.0
    correlation_s: Positive = 60.0
    channel_width_m: Positive | None = None
    channel_centre_ned_m: tuple[float, float] = (0.0, 0.0)
    channel_bank_ratio: Annotated[float, Field(ge=0, le=1)] = 0.3
    channel_bank_exponent: Positive = 4.0


class Waves(Group):
    """A random sea toward `direction_deg`."""

    spectrum: Literal["none", "regular", "pierson-moskowitz", "jonswap"] = "none"
    significant_height_m: Annotated[float, Field(ge=0, le=30)] = 0.0
    peak_period_s: Annotated[float, Field(ge=0.1, le=60)] = 3.0
    direction_deg: Direction = 0.0
    gamma: Annotated[float, Field(ge=1, le=20)] = 3.3
    spreading: Annotated[float, Field(gt=0, le=200)] | None = None
    components: Annotated[int, Field(ge=1, le=4096)] = 32


class Gust(Group):
    """Gusts along the mean wind."""

    spectrum: Literal["none", "ornstein-uhlenbeck", "npd", "davenport", "harris"] = "none"
    deviation_mps: NonNegative = 0.0
    correlation_s: Positive = 5.0


class DiscreteGust(Group):
    """One gust that rises, holds and falls (1 - cos)."""

    start_s: NonNegative
    rise_s: Positive
    hold_s: NonNegative
    fall_s: Positive
    speed_mps: float


class Wind(Group):
    """Wind from `direction_deg` at the reference height."""

    mean_mps: Annotated[float, Field(ge=0, le=100)] = 0.0
    direction_deg: Direction = 0.0
    direction_deviation_deg: Annotated[float, Field(ge=0, le=180)] = 0.0
    direction_correlation_s: Positive = 60.0
    gust: Gust = Gust()
    discrete_gusts: tuple[DiscreteGust, ...] = ()
    reference_height_m: Positive = 10.0


class Environment(Group):
    """All that surrounds the vessel.

    `visibility_m`: the meteorological one, null for clear air. `water_reflectivity`: what the silt scatters back of a
    lidar's light that is in the water.
    """

    water: Water = Water()
    current: Current = Current()
    waves: Waves = Waves()
    wind: Wind = Wind()
    visibility_m: Annotated[float, Field(ge=5)] | None = None
    water_reflectivity: Annotated[float, Field(ge=0, le=0.5)] = 0.05
