"""Station keeping in wind and current: a run of the embedded autopilot with its sensors and estimate."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from agent.fcu.parameters import Parameters
from sim_core.environment.spec import CurrentSpec, EnvironmentSpec, Water, WindSpec
from sim_core.vessel.spec import VesselSpec
from sim_core.vessel.windage import AIR_DENSITY_KGPM3
from xitl_cli.errors import UserError
from xitl_cli.logs.model.sections import Fact, Plot, Section, Trace
from xitl_cli.plugins.studies.manoeuvres.measures import radius_of_95_percent
from xitl_cli.profile import Profile, load_profile
from xitl_cli.profile.schema.agents import AutopilotSpec, DriverSpec, MissionSpec, ScriptStep
from xitl_cli.profile.schema.profile import ClockSpec, RecordingSpec
from xitl_cli.run.nodes.display import NoDisplay
from xitl_cli.run.session import run

ARMED_S, SETTLED_S, ENDS_S = 5.0, 30.0, 80.0
CURRENT_OF_SPEED, WIND_OF_THRUST, MOST_WIND_MPS = 0.1, 0.1, 8.0
"""Current of a tenth of the top speed. The wind pushes the side with a tenth of the thrust, at most a breeze."""
ESTIMATE_M = 0.5
"""Allowance for the error of the position estimate, by which the vessel keeps its position."""


def station_conditions(model: VesselSpec, top_speed_mps: float, thrust_n: float) -> tuple[float, float]:
    """Return current and wind, m/s."""
    drag = 0.5 * AIR_DENSITY_KGPM3 * model.wind.sway_coefficient * model.wind.lateral_area_m2
    wind = math.sqrt(WIND_OF_THRUST * thrust_n / drag) if drag > 0 else MOST_WIND_MPS
    return round(CURRENT_OF_SPEED * top_speed_mps, 2), round(min(wind, MOST_WIND_MPS), 1)


def loiter_radius_m(autopilot: AutopilotSpec | None) -> float:
    """Return the loiter radius of the embedded autopilot: its LOIT_RADIUS."""
    radius_m = None if autopilot is None else autopilot.parameters.get("LOIT_RADIUS")
    return float(radius_m if radius_m is not None else Parameters()["LOIT_RADIUS"])


def station_keeping(
    model: VesselSpec, autopilot: AutopilotSpec | None, water: Water, top_speed_mps: float, thrust_n: float
) -> Section:
    """Send the vessel to its own position. The current sets east, the wind blows from the south-west.

    autopilot: from its profile, for its parameters, if it is the embedded one.
    """
    current, wind = station_conditions(model, top_speed_mps, thrust_n)
    own = AutopilotSpec() if autopilot is None or autopilot.kind != "embedded" else autopilot
    base = load_profile("bases/base-sitl")
    profile: Profile = replace(
        base,
        name=f"station-{model.name}",
        site=load_profile("sites/santo-antonio").site,
        vehicle=model,
        environment=EnvironmentSpec(
            water=water,
            current=CurrentSpec(speed_mps=current, direction_deg=90.0),
            wind=WindSpec(mean_mps=wind, direction_deg=225.0),
        ),
        mission=MissionSpec(speed_mps=max(0.3 * top_speed_mps, 1.5 * current)),
        driver=DriverSpec(
            kind="script",
            script=(
                ScriptStep(at_s=ARMED_S, arm=True, mode="GUIDED", goto_ned_m=(0.0, 0.0)),
                ScriptStep(at_s=ENDS_S, end=True),
            ),
        ),
        autopilot=replace(own, kind="embedded", runs="in-process"),
        clock=ClockSpec(duration_s=ENDS_S + 30.0),
        recording=RecordingSpec(truth_rate_hz=10.0, scene=False, dataflash=False),
        world=None,
        graph=None,
    )
    title = "Station keeping in wind and current"
    try:
        with TemporaryDirectory() as folder:
            result = run(profile, Path(folder) / "run", False, NoDisplay)
            if result.summary["error"]:
                raise UserError(str(result.summary["error"]))
            with result.open_log() as log:
                truth = log["/truth/state"]
                time_s = np.asarray(truth.stamp_ns, dtype=float) * 1e-9
                north, east = np.asarray(truth["position_ned_m"], dtype=float)[:, :2].T
    except UserError as error:
        return Section("station", title, lacks=(f"station keeping: {error}",))
    time_s = time_s - time_s[0]
    settled = time_s >= SETTLED_S
    radius = radius_of_95_percent(north[settled], east[settled], (0.0, 0.0))
    facts = (
        Fact("station_current_mps", "current, to the east", current, "m/s"),
        Fact("station_wind_mps", "wind, from the south-west", wind, "m/s"),
        Fact("station_radius_m", "radius settled for 95 % of the time", radius, "m"),
    )
    way = Trace("way", east, north)
    plot = Plot("station", "Way while it keeps its place at 0, 0", "north (m)", (way,), "map", "east (m)")
    return Section("station", title, facts, plots=(plot,))
