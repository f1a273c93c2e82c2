"""Water, current, waves and wind as data. The defaults are still water and still air."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from sim_core.dataclass import dataclass
from sim_core.environment.tide_spec import TidalStreamSpec, TideSpec, problem_of_instant
from sim_core.keys import (
    Bounds,
    Direction,
    IfGiven,
    NonNegative,
    Place,
    Positive,
    Share,
    Specification,
    SpecificationError,
    ValueProblem,
)

GRAVITY_MPS2 = 9.80665  # standard gravity; weight and buoyancy use the same, so floatation does not depend on it
FEWEST_COMPONENTS = 8


@dataclass(frozen=True, slots=True)
class Water(Specification):
    """The still water."""

    density_kgpm3: Positive = 997.8
    level_m: Annotated[float, "water surface above the local origin, up positive; with a tide: its mean level"] = -0.01
    depth_m: Annotated[
        float, Bounds(at_least=0.1, at_most=12_000), "water depth at level_m, used by waves and rangefinders"
    ] = 20.0
    tide: Annotated[TideSpec | None, IfGiven(), "heights added to level_m; null: no tide"] = None


@dataclass(frozen=True, slots=True)
class CurrentSpec(Specification):
    """A current with a speed that follows a first-order Gauss-Markov process, optionally in a channel with two banks.

    With c the distance from the channel's middle line and r the bank ratio, the uniform speed is multiplied by `r +
    (1 - r) (1 - |2 c / width|^exponent)`. Beyond the banks it is multiplied by r.
    """

    speed_mps: Annotated[float, Bounds(at_least=0, at_most=20), "mean speed"] = 0.0
    direction_deg: Annotated[Direction, "direction towards which the water flows"] = 0.0
    deviation_mps: Annotated[NonNegative, "standard deviation of the speed"] = 0.0
    correlation_s: Annotated[Positive, "time constant of the deviation"] = 60.0
    channel_width_m: Annotated[
        Positive | None, "distance between two straight banks along the current; null: no banks"
    ] = None
    channel_centre_ned_m: Annotated[Place, "a point of the channel's middle line, north and east"] = (0.0, 0.0)
    channel_bank_ratio: Annotated[Share, "share of the speed that remains at the banks"] = 0.3
    channel_bank_exponent: Annotated[
        Positive, "steepness of the decrease; a larger value concentrates it near the banks"
    ] = 4.0
    tide: Annotated[TidalStreamSpec | None, IfGiven(), "tidal stream added to the current; null: none"] = None

    @property
    def mean_ne_mps(self) -> tuple[float, float]:
        """Mean velocity north and east, in the middle of a channel: what carries the pattern of the waves."""
        course_rad = math.radians(self.direction_deg)
        return self.speed_mps * math.cos(course_rad), self.speed_mps * math.sin(course_rad)


@dataclass(frozen=True, slots=True, kw_only=True)
class WaveWall(Specification):
    """A long upright wall that reflects waves, such as a dam. The water is on the left of its heading."""

    through_ne_m: Annotated[Place, "a point of the wall's face at the water"]
    heading_deg: Annotated[Direction, "direction along the face, with the water on the left"]
    reflection: Annotated[Share, "height of the reflected waves over that of the waves that meet the wall"] = 0.9


@dataclass(frozen=True, slots=True)
class WaveSpec(Specification):
    """A random sea, or a regular wave."""

    spectrum: Literal["none", "regular", "pierson-moskowitz", "jonswap"] = "none"
    significant_height_m: Annotated[
        float, Bounds(at_least=0, at_most=30), "significant height; of a regular wave: trough to crest"
    ] = 0.0
    peak_period_s: Annotated[float, Bounds(at_least=0.1, at_most=60), "peak period; of a regular wave: its period"] = (
        3.0
    )
    direction_deg: Annotated[Direction, "direction towards which the waves travel"] = 0.0
    gamma: Annotated[float, Bounds(at_least=1, at_most=20), "peak enhancement factor of jonswap"] = 3.3
    spreading: Annotated[
        Annotated[float, Bounds(above=0, at_most=200)] | None, "exponent s of cos²ˢ(angle / 2); null: long crests"
    ] = None
    components: Annotated[int, Bounds(at_least=1, at_most=4096), f"{FEWEST_COMPONENTS} or more in a random sea"] = 32
    wall: Annotated[
        WaveWall | None, IfGiven(), "wall that reflects the waves: [seas.md](seas.md#waves-at-a-wall); null: none"
    ] = None

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
    deviation_mps: Annotated[
        NonNegative, "standard deviation; 0 with npd, davenport or harris: the value of the spectrum"
    ] = 0.0
    correlation_s: Annotated[Positive, "time constant of ornstein-uhlenbeck"] = 5.0


@dataclass(frozen=True, slots=True)
class DiscreteGust(Specification):
    """A single gust that rises as (1 - cos), holds and falls in the same way (shape of EASA CS-25.341, in time)."""

    start_s: Annotated[NonNegative, "start in simulation time"]
    rise_s: Positive
    hold_s: NonNegative
    fall_s: Positive
    speed_mps: Annotated[float, "added to the mean wind"]


@dataclass(frozen=True, slots=True)
class WindSpec(Specification):
    """A mean wind with slow changes of direction, and random and discrete gusts along it; all speeds grow with height.

    With h the height above the water and r the reference height, the profile power is `(h / r)^exponent`, and
    logarithmic is `ln(h / roughness) / ln(r / roughness)`. A vessel feels the wind at the height of its areas,
    `wind.height_m`.
    """

    mean_mps: Annotated[float, Bounds(at_least=0, at_most=100), "mean speed at the reference height"] = 0.0
    direction_deg: Annotated[Direction, "direction from which the wind blows"] = 0.0
    direction_deviation_deg: Annotated[
        float, Bounds(at_least=0, at_most=180), "standard deviation of the direction"
    ] = 0.0
    direction_correlation_s: Annotated[Positive, "time constant of the direction's deviation"] = 60.0
    gust: GustSpec = GustSpec()
    discrete_gusts: tuple[DiscreteGust, ...] = ()
    reference_height_m: Annotated[Positive, "height above the water for all speeds of this group, including gusts"] = (
        10.0
    )
    profile: Annotated[Literal["power", "logarithmic", "uniform"], "change of the speed with height"] = "power"
    exponent: Annotated[float, Bounds(above=0, at_most=1), "exponent of power: 1/7, or 0.11 over the open sea"] = (
        1.0 / 7.0
    )
    roughness_m: Annotated[
        float,
        Bounds(above=0, at_most=0.03),
        "roughness length of logarithmic: 0.0001 for calm to 0.01 for rough open water",
    ] = 0.0002

    def check(self) -> None:
        if self.gust.spectrum not in ("none", "ornstein-uhlenbeck") and self.mean_mps == 0:
            raise SpecificationError(
                ("mean_mps",),
                f"= 0 does not fit the gust spectrum {self.gust.spectrum}, which scales with it; "
                "use a mean above 0, or gust.spectrum: none or ornstein-uhlenbeck",
            )


@dataclass(frozen=True, slots=True)
class LightSpec(Specification):
    """Sun and clouds, for cameras. By default the sun is where `start_utc` and the site put it."""

    sun_elevation_deg: Annotated[
        Annotated[float, Bounds(at_least=-90, at_most=90)] | None,
        "height over the horizon; null: by start_utc, without it 35",
    ] = None
    sun_azimuth_deg: Annotated[Direction | None, "null: by start_utc, without it 140"] = None
    clouds: Annotated[Share, "share of the sky; 1 is overcast"] = 0.3


@dataclass(frozen=True, slots=True)
class EnvironmentSpec(Specification):
    """Water, current, waves, wind, rain and visibility around the vessel."""

    water: Water = Water()
    current: CurrentSpec = CurrentSpec()
    waves: WaveSpec = WaveSpec()
    wind: WindSpec = WindSpec()
    visibility_m: Annotated[
        Annotated[float, Bounds(at_least=5)] | None, "meteorological visibility; null: clear air"
    ] = None
    water_reflectivity: Annotated[
        float,
        Bounds(at_least=0, at_most=0.5),
        "share of a lidar's light in the water that suspended particles scatter back",
    ] = 0.05
    rain_mmph: Annotated[
        float, Bounds(at_least=0, at_most=300), IfGiven(), "rain, seen by a radar; 4 is light, 16 is heavy"
    ] = 0.0
    start_utc: Annotated[
        str | None,
        ValueProblem(problem_of_instant),
        IfGiven(),
        "UTC at the start of the run, for tides and the light, such as 2026-03-01T06:00:00Z",
    ] = None
    light: Annotated[LightSpec, IfGiven()] = LightSpec()

    def check(self) -> None:
        level, stream = self.water.tide, self.current.tide
        for group, tide in (("water", level), ("current", stream)):
            if self.start_utc is None and tide is not None and tide.needs_start:
                raise SpecificationError(
                    (group, "tide"), "needs environment.start_utc; add it in UTC, such as 2026-03-01T06:00:00Z"
                )
        if stream is not None and stream.peak_mps is not None and level is None:
            raise SpecificationError(
                ("current", "tide", "follows"),
                f"= {stream.follows} needs environment.water.tide; add it, or give current.tide.constituents",
            )
