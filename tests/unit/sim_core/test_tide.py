"""Tide and tidal stream against closed forms, Schureman's approximations, SciPy, and another implementation (UTide)."""

from __future__ import annotations

import math
from datetime import UTC, datetime, timedelta, timezone

import numpy as np
import pytest
from motion import at_rest
from scipy.interpolate import PchipInterpolator
from vessels import FULL

from sim_core import fleet as fleets
from sim_core.environment.constituents import CONSTITUENTS, Arguments
from sim_core.environment.environment import Environment
from sim_core.environment.spec import CurrentSpec, EnvironmentSpec, Water
from sim_core.environment.tide import NO_TIDE, Interpolation, make_tide
from sim_core.environment.tide_spec import ConstituentSpec, StreamConstituentSpec, TidalStreamSpec, TideSpec
from sim_core.environment.transition import Transition
from sim_core.fleet import Fleet
from sim_core.keys import SpecificationError
from sim_core.sensors.optics import WaterSeen
from sim_core.sensors.rangefinder import Rangefinder
from sim_core.sensors.spec import RangefinderSpec, WindVaneSpec
from sim_core.sensors.wind_vane import WindVane
from sim_core.simulation import Simulation, elevation_m, initial, step
from sim_core.world.plan import Capsules
from sim_core.world.river import FlatBed
from sim_core.world.spec import TrafficSpec
from sim_core.world.traffic import ScriptedVessel
from sim_core.world.waterway import OPEN_WATER, Waterway

START = "2026-03-01T06:00:00Z"
HOUR_S = 3600.0
# A tide of 10 minutes' period with high water 0.5 m above the mean level at the start.
QUICK = TideSpec(constituents=(ConstituentSpec("quick", 0.5, 0.0, speed_degph=2160.0),))


def environment(tide: TideSpec | None, stream: TidalStreamSpec | None = None, **current: object) -> Environment:
    keys = CurrentSpec(tide=stream, **current)  # type: ignore[arg-type]
    spec = EnvironmentSpec(water=Water(level_m=0.2, tide=tide), current=keys, start_utc=START)
    return Environment.from_spec(spec, np.random.default_rng(1))


def test_speeds_are_those_of_the_arguments() -> None:
    """Published speeds are rates of the mean longitudes. M1 also turns with the lunar perigee."""
    per_hour = np.array([15.0, 481267.88123421, 36000.76983, 4069.0137287, 1.71946]) / [1, *[876_600.0] * 4]
    for name, constituent in CONSTITUENTS.items():
        rate = float(per_hour @ constituent.argument) + (per_hour[3] if name == "M1" else 0.0)
        assert rate == pytest.approx(constituent.speed_degph, abs=1e-5), name


@pytest.mark.parametrize(
    ("name", "factor", "phase_deg"),
    [
        ("M2", 0.9659, 241.55),
        ("S2", 1.0022, 179.96),
        ("N2", 0.9689, 180.78),
        ("K2", 1.2924, 143.94),
        ("K1", 1.1070, 161.83),
        ("O1", 1.1774, 78.43),
        ("L2", 1.2763, 112.49),
        ("M3", 0.9476, 2.42),
        ("MN4", 0.9358, 62.33),
    ],
)
def test_arguments_agree_with_utide(name: str, factor: float, phase_deg: float) -> None:
    """Reference: f and V + u of UTide 0.4.0 at 45 degrees north. It corrects by satellites, and not by the node."""
    arguments, constituent = Arguments.at(datetime(2026, 3, 1, 6, tzinfo=UTC)), CONSTITUENTS[name]
    assert arguments.factor(constituent) == pytest.approx(factor, abs=0.005)
    difference_rad = arguments.phase_rad(constituent) - math.radians(phase_deg)
    assert abs(math.remainder(difference_rad, math.tau)) < math.radians(0.3)


@pytest.mark.parametrize("year", range(2007, 2026, 2))
def test_nodal_corrections_follow_the_moon_s_node(year: int) -> None:
    """Fourier series of Doodson and Warburg, Admiralty Manual of Tides, 1941."""
    instant = datetime(year, 6, 1, tzinfo=UTC)
    century = (instant - datetime(2000, 1, 1, 12, tzinfo=UTC)).total_seconds() / (36525 * 86400)
    node = math.radians(125.0445 - 1934.1363 * century)
    nodal = Arguments.at(instant).nodal
    for name, (mean, *cosines), sines in (
        ("M2", (1.0004, -0.0373, 0.0002), (-2.14,)),
        ("O1", (1.0089, 0.1871, -0.0147, 0.0014), (10.80, -1.34, 0.19)),
        ("K1", (1.0060, 0.1150, -0.0088, 0.0006), (-8.86, 0.68, -0.07)),
        ("K2", (1.0241, 0.2863, 0.0083, -0.0015), (-17.74, 0.68, -0.04)),
        ("J1", (1.0129, 0.1676, -0.0170, 0.0016), (-12.94, 1.34, -0.19)),
        ("MM", (1.0, -0.1300, 0.0013), ()),
        ("MF", (1.0429, 0.4135, -0.0040), (-23.74, 2.68, -0.38)),
    ):
        f, u = nodal[name]  # type: ignore[index]
        series = mean + sum(part * math.cos(number * node) for number, part in enumerate(cosines, start=1))
        assert f == pytest.approx(series, abs=0.004), name
        turn = sum(part * math.sin(number * node) for number, part in enumerate(sines, start=1))
        assert u == pytest.approx(turn, abs=0.1), name


def test_a_sum_of_constituents_agrees_with_utide() -> None:
    """Reference: sum of f A cos(V + u - g) with f, u and V of UTide 0.4.0."""
    parts = (
        ("M2", 1.35, 331.2),
        ("S2", 0.41, 14.5),
        ("N2", 0.27, 308.0),
        ("K2", 0.11, 12.0),
        ("K1", 0.36, 106.0),
        ("O1", 0.23, 89.5),
    )
    tide = environment(TideSpec(constituents=tuple(ConstituentSpec(*part) for part in parts))).tide
    for hour, height_m in (
        (0, -0.1533),
        (2, 1.0581),
        (4.5, 1.3985),
        (7, -0.2622),
        (10, -2.0578),
        (12.4, -1.1583),
        (18, 1.3313),
        (30, 1.2613),
    ):
        assert tide.height_m(hour * HOUR_S) == pytest.approx(height_m, abs=0.01)


def test_a_constituent_with_its_own_speed_lags_behind_the_start() -> None:
    tide = environment(TideSpec(constituents=(ConstituentSpec("own", 0.8, 30.0, speed_degph=45.0),))).tide
    for hour in (0.0, 0.7, 5.2):
        phase = math.radians(45.0 * hour - 30.0)
        assert tide.height_m(hour * HOUR_S) == pytest.approx(0.8 * math.cos(phase))
        assert tide.rise_mps(hour * HOUR_S) == pytest.approx(-0.8 * math.radians(45.0) / HOUR_S * math.sin(phase))
    assert tide.bounds_m == pytest.approx((-0.8, 0.8))


def test_a_table_is_interpolated_as_by_scipy() -> None:
    rng = np.random.default_rng(2)
    time_s = np.cumsum(rng.uniform(600.0, 20_000.0, 12))
    values = rng.uniform(-2.0, 2.0, 12)
    values[5] = values[4]
    for count in (2, 3, 12):
        curve = Interpolation.through(tuple(time_s[:count]), tuple(values[:count]))
        known = PchipInterpolator(time_s[:count], values[:count])
        at_s = np.linspace(time_s[0], time_s[count - 1], 301)
        np.testing.assert_allclose([curve.value(each) for each in at_s], known(at_s), atol=1e-12)
        np.testing.assert_allclose([curve.rate(each) for each in at_s], known.derivative()(at_s), atol=1e-12)
        fine_s = np.linspace(time_s[0], time_s[count - 1], 40_001)
        assert curve.fastest == pytest.approx(np.abs(known.derivative()(fine_s)).max(), rel=1e-4)


def test_a_table_holds_its_ends_and_has_its_extremes_at_its_rows() -> None:
    rows = (("2026-03-01T06:10:00Z", 1.5), ("2026-03-01T12:20:00Z", -1.1), ("2026-03-01 18:40", 1.4))
    tide = environment(TideSpec(table=rows)).tide
    assert tide.height_m(0.0) == 1.5
    assert tide.rise_mps(0.0) == 0.0
    assert tide.height_m(6 * HOUR_S + 1200.0) == pytest.approx(-1.1)
    assert tide.rise_mps(6 * HOUR_S + 1200.0) == pytest.approx(0.0, abs=1e-12)
    assert tide.height_m(24 * HOUR_S) == 1.4
    assert tide.bounds_m == (-1.1, 1.5)


@pytest.mark.parametrize(("follows", "slack_s", "flood_s"), [("level_rate", 0.0, 450.0), ("level", 450.0, 0.0)])
def test_a_stream_follows_the_level_or_its_rate(follows: str, slack_s: float, flood_s: float) -> None:
    """High water is at the start. A standing wave has slack then; a progressive wave has its strongest flood."""
    stream = TidalStreamSpec(flood_deg=90.0, ebb_deg=250.0, follows=follows, peak_mps=0.8)  # type: ignore[arg-type]
    water = environment(QUICK, stream, speed_mps=0.3, direction_deg=0.0)
    place, state = np.zeros((1, 3)), np.zeros(1)
    north_mps = [0.3, 0.0, 0.0]
    assert water.current_ned_mps(state, slack_s, place)[0] == pytest.approx(north_mps)
    assert water.current_ned_mps(state, flood_s, place)[0] == pytest.approx([0.3, 0.8, 0.0])
    ebb = math.radians(250.0)
    against = [0.3 + 0.8 * math.cos(ebb), 0.8 * math.sin(ebb), 0.0]
    assert water.current_ned_mps(state, flood_s + 300.0, place)[0] == pytest.approx(against)


def test_a_lag_delays_the_stream() -> None:
    on_time, late = (
        environment(QUICK, TidalStreamSpec(flood_deg=0.0, peak_mps=1.0, lag_min=lag_min)).tide for lag_min in (0.0, 2.0)
    )
    for time_s in (0.0, 77.0, 400.0):
        assert late.stream_mps(time_s + 120.0) == pytest.approx(on_time.stream_mps(time_s))


def test_a_stream_has_its_own_constituents() -> None:
    own = TidalStreamSpec(flood_deg=0.0, constituents=(StreamConstituentSpec("own", 0.6, 90.0, speed_degph=360.0),))
    tide = environment(None, own).tide
    assert tide.stream_mps(0.25 * HOUR_S) == pytest.approx(0.6)
    assert tide.height_m(0.0) == 0.0


def test_the_peak_is_that_of_the_springs() -> None:
    pair = tuple(ConstituentSpec(name, 1.0, 0.0, speed_degph=speed) for name, speed in (("a", 28.984), ("b", 30.0)))
    tide = environment(TideSpec(constituents=pair), TidalStreamSpec(flood_deg=0.0, peak_mps=1.2)).tide
    speeds_mps = [abs(tide.stream_mps(minute * 60.0)) for minute in range(0, 15 * 24 * 60, 5)]
    assert max(speeds_mps) == pytest.approx(1.2, rel=0.01)
    assert max(speeds_mps[7 * 288 : 8 * 288]) < 0.3  # neaps


def test_a_stream_slackens_toward_the_banks() -> None:
    stream = TidalStreamSpec(flood_deg=0.0, follows="level", peak_mps=1.0)
    water = environment(QUICK, stream, channel_width_m=100.0, channel_bank_ratio=0.4, channel_bank_exponent=2.0)
    velocity = water.current_ned_mps(np.zeros(1), 0.0, np.array([[0.0, 0.0, 0.0], [5.0, 25.0, 0.0], [0.0, 80.0, 0.0]]))
    assert velocity[:, 0] == pytest.approx([1.0, 1.0 - 0.6 * 0.25, 0.4])


@pytest.mark.medium
def test_a_vessel_keeps_its_draft_while_the_water_falls_under_it() -> None:
    simulation = Simulation.from_spec(FULL, environment(QUICK), 0.01)
    rng = np.random.default_rng(1)
    state = initial(simulation, np.zeros((1, 2)), np.zeros(1), rng)
    for number in range(6000):
        if number % 500 == 0:
            level_m = simulation.environment.level_m(state.time_ns * 1e-9)
            draft_m = float(state.vessel.motion.pos_ned_m[0, 2]) + level_m
            assert draft_m == pytest.approx(simulation.vessel.rest.depth_m, abs=0.004)
        state = step(simulation, state, np.zeros((1, 2)), rng)
    # 0.5 cos(36 degrees) after a minute: it fell by 10 cm.
    assert state.vessel.motion.vel_ned_mps[0, 2] == pytest.approx(
        0.5 * math.tau / 600 * math.sin(math.radians(36)), 0.1
    )
    assert elevation_m(simulation, state)[0] == pytest.approx(0.5 * math.cos(math.radians(36.0)))


@pytest.mark.slow
def test_a_falling_tide_sets_a_vessel_on_the_bed() -> None:
    """It floats 20 cm above the bed at high water, and the tide falls by up to 1 m."""
    water = environment(QUICK)
    rest = Simulation.from_spec(FULL, water, 0.01).vessel.rest
    bed_down_m = rest.draft_m - 0.7 + 0.2
    grounds = Waterway(Capsules.joined(()), FlatBed(bed_down_m))
    rng = np.random.default_rng(1)
    for waterway, sinks_m in ((OPEN_WATER, 0.5 - 0.5 * math.cos(math.radians(90.0))), (grounds, 0.2)):
        simulation = Simulation.from_spec(FULL, water, 0.01, waterway)
        state = initial(simulation, np.zeros((1, 2)), np.zeros(1), rng)
        high_m = float(state.vessel.motion.pos_ned_m[0, 2])
        for _ in range(15_000):
            state = step(simulation, state, np.zeros((1, 2)), rng)
        assert float(state.vessel.motion.pos_ned_m[0, 2]) - high_m == pytest.approx(sinks_m, abs=0.03)
        assert bool(len(state.contacts)) is (waterway is grounds)


def test_a_fleet_and_its_scripted_vessels_float_on_the_tide() -> None:
    water = environment(QUICK)
    barge = ScriptedVessel.from_spec(
        "barge", TrafficSpec(length_m=12.0, beam_m=4.0, track_ned_m=((50.0, 0.0),)), water.water.level_m
    )
    fleet = Fleet.from_spec([FULL, FULL], water, 0.01, names=("a", "b"), traffic=[barge])
    state = fleets.initial(fleet, np.array([[0.0, 0.0], [20.0, 0.0]]), np.zeros(2), np.random.default_rng(1))
    down_m = fleets.joined_motion(fleet, state).pos_ned_m[:, 2]
    rest_m = fleet.of(0).vessel.rest.depth_m
    assert down_m == pytest.approx([rest_m - 0.7, rest_m - 0.7, -0.7])
    state = fleets.step(fleet, state, fleet.by_model([(0.0, 0.0), (0.0, 0.0)]), np.random.default_rng(1))
    assert fleets.state_of(fleet, state, 1).surface.tide_m == pytest.approx(0.5, abs=1e-3)


def test_sensors_meet_the_water_at_its_level_now() -> None:
    water = environment(QUICK)
    assert water.surface_ned_z_m(300.0, np.zeros(2)) == pytest.approx(0.3)
    assert WaterSeen.around(water, 300.0, np.zeros(3)).level_down_m == pytest.approx(0.3)
    down = RangefinderSpec(through="air", position_frd_m=(0.0, 0.0, -2.0))
    unit = Rangefinder(down, bed_down_m=20.0, surface_down_m=-0.2, tide_m=lambda: 0.5)
    assert unit.measure(None, at_rest(), np.random.default_rng(1))[1].range_m[0] == pytest.approx(1.3)
    heights: list[float] = []

    def share(height_m: np.ndarray) -> np.ndarray:
        heights.append(float(height_m[0]))
        return np.ones_like(height_m)

    vane = WindVane(WindVaneSpec(position_frd_m=(0.0, 0.0, -3.0)), share, 0.2, lambda: 0.5)
    rng = np.random.default_rng(1)
    vane.measure(vane.initial(1, rng), at_rest(), np.zeros((1, 3)), rng)
    assert heights == [pytest.approx(2.3)]


def test_a_change_of_weather_keeps_the_tide() -> None:
    before, after = environment(QUICK), environment(QUICK, speed_mps=1.0)
    assert Transition(before, after, 0.0).environment(1.0).tide is before.tide
    assert make_tide(EnvironmentSpec()) is NO_TIDE


def test_a_time_zone_shifts_the_start() -> None:
    m2 = TideSpec(constituents=(ConstituentSpec("M2", 1.0, 40.0),))
    local = datetime.fromisoformat(START).astimezone(timezone(timedelta(hours=3, minutes=30)))
    heights_m = [
        make_tide(EnvironmentSpec(water=Water(tide=m2), start_utc=text)).height_m(0.0)
        for text in (START, "2026-03-01T04:00:00-02:00", "2026-03-01 06:00", local.isoformat())
    ]
    assert heights_m == pytest.approx([heights_m[0]] * 4, abs=1e-12)


@pytest.mark.parametrize(
    ("keys", "sentence"),
    [
        ({}, "give either constituents, or a table or file"),
        ({"table": ((0.0, 1.0),)}, "single row"),
        ({"table": ((0.0, 1.0), (60.0, 2.0), (60.0, 1.0))}, "table.2.0 = 60 is not after 60; sort the rows"),
        ({"table": ((0.0, 1.0), (START, 2.0))}, "is in UTC, unlike row 0"),
        ({"constituents": (ConstituentSpec("M2", 1.0, 0.0),) * 2}, "constituents.1.name = M2 is given twice"),
    ],
)
def test_impossible_tides_are_refused(keys: dict[str, object], sentence: str) -> None:
    with pytest.raises(SpecificationError, match=sentence):
        TideSpec(**keys)  # type: ignore[arg-type]
