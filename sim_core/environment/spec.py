"""Water, current, waves and wind as data. The defaults are still water and still air."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

from sim_core.keys import Bounds, Direction, NonNegative, Place, Positive, Share, Specification, SpecificationError

GRAVITY_MPS2 = 9.80665  # standard gravity; weight and buoyancy use the same, so floatation does not depend on it
FEWEST_COMPONENTS = 8


@dataclass(frozen=True, slots=True)
class Water(Specification):
    """The still water."""

    density_kgpm3: Positive = 997.8
    level_m: Annotated[float, "of its surface above the local origin, up positive"] = -0.01
    depth_m: Annotated[float, Bounds(at_least=0.1, at_most=12_000), "for waves and rangefinders"] = 20.0


@dataclass(frozen=True, slots=True)
class CurrentSpec(Specification):
    """A current whose speed is a first-order Gauss-Markov process; with a channel it slackens toward two banks.

    With c the distance from the channel's middle line, the speed is the uniform one times
    `r + (1 - r) (1 - |2 c / width|^exponent)`, r being the bank ratio, and r times it beyond the banks.
    """

    speed_mps: Annotated[float, Bounds(at_least=0, at_most=20), "mean"] = 0.0
    direction_deg: Annotated[Direction, "where the water goes"] = 0.0
    deviation_mps: Annotated[NonNegative, "of the speed"] = 0.0
    correlation_s: Annotated[Positive, "time constant of the deviation"] = 60.0
    channel_width_m: Annotated[Positive | None, "between two straight banks along the current; null: no banks"] = None
    channel_centre_ned_m: Annotated[Place, "a point of the channel's middle line, north and east"] = (0.0, 0.0)
    channel_bank_ratio: Annotated[Share, "of the speed that is left at the banks"] = 0.3
    channel_bank_exponent: Annotated[Positive, "how suddenly the current slackens"] = 4.0

    @property
    def mean_ne_mps(self) -> tuple[float, float]:
        """Mean velocity north and east, in the middle of a channel: what carries the pattern of the waves."""
        course_rad = math.radians(self.direction_deg)
        return self.speed_mps * math.cos(course_rad), self.speed_mps * math.sin(course_rad)


@dataclass(frozen=True, slots=True)
class WaveSpec(Specification):
    """A random sea, or a regular wave."""

    spectrum: Literal["none", "regular", "pierson-moskowitz", "jonswap"] = "none"
    significant_height_m: Annotated[float, Bounds(at_least=0, at_most=30), "of a regular wave: trough to crest"] = 0.0
    peak_period_s: Annotated[float, Bounds(at_least=0.1, at_most=60), "of a regular wave: its period"] = 3.0
    direction_deg: Annotated[Direction, "where the waves go"] = 0.0
    gamma: Annotated[float, Bounds(at_least=1, at_most=20), "peak enhancement of jonswap"] = 3.3
    spreading: Annotated[
        Annotated[float, Bounds(above=0, at_most=200)] | None, "the s of cos²ˢ(angle / 2); null: long crests"
    ] = None
    components: Annotated[int, Bounds(at_least=1, at_most=4096), f"{FEWEST_COMPONENTS} or more in a random sea"] = 32

    def check(self) -> None:
        if self.spectrum not in ("none", "regular") and self.components < FEWEST_COMPONENTS:
            raise SpecificationError(
                ("components",),
                f"= {self.components} is too few for an irregular sea; "
                f"use {FEWEST_COMPONENTS} or more, or spectrum: regular",
            )


@dataclass(frozen=True, slots=True)
class GustSpec(Specification):
    """Random gusts along the mean wind."""

    spectrum: Literal["none", "ornstein-uhlenbeck", "npd", "davenport", "harris"] = "none"
    deviation_mps: Annotated[NonNegative, "0 with npd, davenport or harris: the spectrum's own"] = 0.0
    correlation_s: Annotated[Positive, "time constant of ornstein-uhlenbeck"] = 5.0


@dataclass(frozen=True, slots=True)
class DiscreteGust(Specification):
    """A single gust that rises as (1 - cos), holds and falls the same way (EASA CS-25.341's shape, in time)."""

    start_s: Annotated[NonNegative, "in simulation time"]
    rise_s: Positive
    hold_s: NonNegative
    fall_s: Positive
    speed_mps: Annotated[float, "added to the mean wind"]


@dataclass(frozen=True, slots=True)
class WindSpec(Specification):
    """A mean wind that veers slowly, with random and discrete gusts along it; all of it grows with height.

    With h the height above the water and r the reference height: power is `(h / r)^exponent`, logarithmic is
    `ln(h / roughness) / ln(r / roughness)`. A vessel feels the wind at the height of its areas, `wind.height_m`.
    """

    mean_mps: Annotated[float, Bounds(at_least=0, at_most=100), "at the reference height"] = 0.0
    direction_deg: Annotated[Direction, "where the wind comes from"] = 0.0
    direction_deviation_deg: Annotated[float, Bounds(at_least=0, at_most=180), "by which it veers"] = 0.0
    direction_correlation_s: Annotated[Positive, "time constant of that"] = 60.0
    gust: GustSpec = GustSpec()
    discrete_gusts: tuple[DiscreteGust, ...] = ()
    reference_height_m: Annotated[Positive, "above the water, of all speeds here, gusts among them"] = 10.0
    profile: Annotated[Literal["power", "logarithmic", "uniform"], "over the height"] = "power"
    exponent: Annotated[float, Bounds(above=0, at_most=1), "of power: 1/7, or 0.11 over the open sea"] = 1.0 / 7.0
    roughness_m: Annotated[
        float, Bounds(above=0, at_most=0.03), "of logarithmic: 0.0001 of calm to 0.01 of rough open water"
    ] = 0.0002

    def check(self) -> None:
        if self.gust.spectrum not in ("none", "ornstein-uhlenbeck") and self.mean_mps == 0:
            raise SpecificationError(
                ("mean_mps",),
                f"= 0 gives the gust spectrum {self.gust.spectrum} nothing to scale with; "
                "use a mean above 0, or gust.spectrum: none or ornstein-uhlenbeck",
            )


@dataclass(frozen=True, slots=True)
class EnvironmentSpec(Specification):
    """All that surrounds the vessel."""

    water: Water = Water()
    current: CurrentSpec = CurrentSpec()
    waves: WaveSpec = WaveSpec()
    wind: WindSpec = WindSpec()
    visibility_m: Annotated[Annotated[float, Bounds(at_least=5)] | None, "meteorological; null: clear air"] = None
    water_reflectivity: Annotated[
        float, Bounds(at_least=0, at_most=0.5), "what silt scatters back of a lidar's light that is in the water"
    ] = 0.05
