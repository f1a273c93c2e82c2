"""Station keeping in wind and current: the embedded autopilot with its sensors and estimate, without links.

The autopilot gets the samples of the simulated sensors directly, at rates that are enough for still water. Protocols,
recording and log are left out, because they do not move the vessel.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np

from agent.fcu.parameters import Parameters
from agent.fcu.vehicle import modes
from agent.fcu.vehicle.autopilot import Autopilot
from agent.navigation.measurements import (
    BarometerMeasurement,
    GnssMeasurement,
    ImuMeasurement,
    MagnetometerMeasurement,
)
from sim_core import simulation as world
from sim_core.environment.environment import Environment
from sim_core.environment.spec import CurrentSpec, EnvironmentSpec, Water, WindSpec
from sim_core.frames import Array
from sim_core.geodesy import normal_gravity_mps2
from sim_core.kinematics import Kinematics
from sim_core.sensors.barometer import Barometer
from sim_core.sensors.gnss import Gnss
from sim_core.sensors.imu import Imu
from sim_core.sensors.magnetometer import Magnetometer
from sim_core.vessel.spec import VesselSpec
from sim_core.vessel.windage import AIR_DENSITY_KGPM3
from xitl_cli.errors import UserError
from xitl_cli.logs.model.sections import Fact, Plot, Section, Trace
from xitl_cli.plugins.studies.manoeuvres.measures import radius_of_95_percent
from xitl_cli.plugins.studies.manoeuvres.track import trial
from xitl_cli.profile import Profile, load_profile
from xitl_cli.profile.schema.agents import AutopilotSpec, MissionSpec
from xitl_cli.run.links.setup import embedded_parameters
from xitl_cli.run.world.world import local_frame, magnetic_field_ned_gauss

ARMED_S, SETTLED_S, ENDS_S = 12.0, 30.0, 60.0
_CYCLE_S = 0.04
"""Period of IMU samples and of control."""
_EVERY = {"gnss": 5, "magnetometer": 5, "barometer": 5}
"""Cycles between two samples of a sensor."""
_NS = 1_000_000_000
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
    model: VesselSpec,
    autopilot: AutopilotSpec | None,
    water: Water,
    top_speed_mps: float,
    thrust_n: float,
    step_s: float = 0.01,
) -> Section:
    """Send the vessel to its own position. The current sets east, the wind blows from the south-west.

    autopilot: from its profile, for its parameters, if it is the embedded one. step_s: step of the simulation.
    """
    current, wind = station_conditions(model, top_speed_mps, thrust_n)
    own = AutopilotSpec() if autopilot is None or autopilot.kind != "embedded" else autopilot
    base, site = (_shipped(name) for name in ("bases/base-sitl", "sites/santo-antonio"))
    profile: Profile = replace(
        base,
        name=f"station-{model.name}",
        site=site.site,
        vehicle=model,
        environment=EnvironmentSpec(
            water=water,
            current=CurrentSpec(speed_mps=current, direction_deg=90.0),
            wind=WindSpec(mean_mps=wind, direction_deg=225.0),
        ),
        mission=MissionSpec(speed_mps=max(0.3 * top_speed_mps, 1.5 * current)),
        autopilot=replace(own, kind="embedded", runs="in-process"),
        world=None,
        graph=None,
    )
    title = "Station keeping in wind and current"
    try:
        north, east, time_s = _way(profile, step_s)
    except UserError as error:
        return Section("station", title, lacks=(f"station keeping: {error}",))
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


@cache
def _shipped(name: str) -> Profile:
    return load_profile(name)


def _way(profile: Profile, step_s: float) -> tuple[Array, Array, Array]:
    """Return north, east and time (K,). Raises UserError if the autopilot refuses to arm."""
    run = profile.runnable()
    environment = Environment.from_spec(run.environment, np.random.default_rng(1))
    simulation = trial(run.vehicle, environment, step_s)
    steps = round(_CYCLE_S / step_s)
    rng = np.random.default_rng(1)
    state = world.initial(simulation, np.zeros((1, 2)), np.zeros(1), rng)
    autopilot = Autopilot(Parameters(embedded_parameters(run)))
    sensors = _Sensors(profile, autopilot)
    site, places = run.site, []
    for cycle in range(round(ENDS_S / _CYCLE_S)):
        now_ns = round(cycle * _CYCLE_S * _NS)
        sensors.feed(cycle, now_ns, state.vessel.motion)
        if cycle == round(ARMED_S / _CYCLE_S):
            refused = [*autopilot.arm(), autopilot.set_mode(modes.GUIDED)]
            refused.append(autopilot.commands.go_to(site.latitude_deg, site.longitude_deg))
            if problems := ", ".join(filter(None, refused)):
                raise UserError(f"the autopilot refuses: {problems}")
        command = np.array([autopilot.control(now_ns).command])
        state = world.step(simulation, state, command, rng, steps)
        places.append(state.vessel.motion.pos_ned_m[0])
    north, east, _ = np.array(places).T
    return north, east, _CYCLE_S * (1.0 + np.arange(len(north), dtype=np.float64))


class _Sensors:
    """The profile's sensors, which feed an autopilot's estimator. GNSS fixes arrive after their latency."""

    def __init__(self, profile: Profile, autopilot: Autopilot) -> None:
        run, estimator = profile.runnable(), autopilot.estimator
        spec, site = run.sensors, run.site
        assert spec is not None
        frame, rng = local_frame(site), np.random.default_rng(1)
        rate_hz = 1.0 / _CYCLE_S
        models: tuple[tuple[str, Any, Callable[[int, Any], object]], ...] = (
            (
                "imu",
                Imu(replace(spec.imu, rate_hz=rate_hz), normal_gravity_mps2(site.latitude_deg, site.altitude_m)),
                lambda stamp_ns, one: estimator.on_imu(
                    ImuMeasurement(stamp_ns, _row(one.gyro_frd_radps), _row(one.accel_frd_mps2))
                ),
            ),
            (
                "magnetometer",
                Magnetometer(
                    replace(spec.magnetometer, rate_hz=rate_hz / _EVERY["magnetometer"]),
                    magnetic_field_ned_gauss(site),
                ),
                lambda stamp_ns, one: estimator.on_magnetometer(
                    MagnetometerMeasurement(stamp_ns, _row(one.field_frd_gauss))
                ),
            ),
            (
                "barometer",
                Barometer(replace(spec.barometer, rate_hz=rate_hz / _EVERY["barometer"]), site.altitude_m),
                lambda stamp_ns, one: estimator.on_barometer(BarometerMeasurement(stamp_ns, float(one.pressure_pa[0]))),
            ),
            ("gnss", Gnss(replace(spec.gnss, rate_hz=rate_hz / _EVERY["gnss"]), frame), self._keep_fix),
        )
        self._rng, self._models = rng, models
        self._states = {name: model.initial(1, rng) for name, model, _ in models}
        self._estimator, self._latency_ns = estimator, round(spec.gnss.latency_s * _NS)
        self._fixes: list[GnssMeasurement] = []

    def feed(self, cycle: int, now_ns: int, motion: Kinematics) -> None:
        """Measure all samples of a cycle, and deliver the fixes that have arrived."""
        for name, model, deliver in self._models:
            if cycle % _EVERY.get(name, 1) == 0:
                self._states[name], sample = model.measure(self._states[name], motion, self._rng)
                deliver(now_ns, sample)
        while self._fixes and now_ns - self._fixes[0].stamp_ns >= self._latency_ns:
            self._estimator.on_gnss(self._fixes.pop(0))

    def _keep_fix(self, stamp_ns: int, one: Any) -> None:
        fix = GnssMeasurement(
            stamp_ns,
            float(one.lat_deg[0]),
            float(one.lon_deg[0]),
            float(one.alt_m[0]),
            _row(one.vel_ned_mps),
            float(one.horizontal_accuracy_m[0]),
            float(one.vertical_accuracy_m[0]),
            float(one.speed_accuracy_mps[0]),
            int(one.fix_type[0]),
            int(one.satellites[0]),
        )
        self._fixes.append(fix)


def _row(values: Array) -> tuple[float, float, float]:
    x, y, z = values[0].tolist()
    return x, y, z
