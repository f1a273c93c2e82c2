"""The radar against the radar equation, published clutter, closed forms of its receiver, and two-ray interference."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from lidar_scenes import moving
from sea_clutter_tables import FREQUENCIES_GHZ, NATHANSON_DB, X_BAND

from sim_core.environment.spec import WaveSpec
from sim_core.keys import SpecificationError
from sim_core.sensors.radar import TWO_WAY_SHARE, MarineRadar, RadarSector, RadarSurroundings
from sim_core.sensors.radar_clutter import (
    rain_attenuation_dbpkm,
    rain_reflectivity_per_m,
    sea_reflectivity_db,
    sea_state,
    spike_shape,
    wind_factor_db,
)
from sim_core.sensors.radar_plots import cfar_factor, detections, find_plots
from sim_core.sensors.radar_targets import (
    ScatterPoints,
    mesh_points,
    reflector_points,
    vessel_points,
    vessel_section_m2,
)
from sim_core.sensors.spec import LIGHT_MPS, REFLECTOR_SECTIONS_M2, SECTORS, MarineRadarSpec, RadarReflectorSpec
from sim_core.world.geometry import CONCRETE, EARTH, box, moved

FREE_SPACE = {"multipath": False, "heading_noise_deg": 0.0}


def point(north_m: float, east_m: float, section_m2: float, height_m: float = 3.0) -> ScatterPoints:
    return reflector_points(np.array([[north_m, east_m, -height_m]]), np.array([section_m2]))


def turns(
    radar: MarineRadar, around: RadarSurroundings, count: int = 1, seed: int = 1, **motion: tuple[float, float, float]
) -> tuple[np.ndarray, list[RadarSector]]:
    """Return the powers (turns, spokes, bins) and all sectors of a vessel that starts at the origin, heading north."""
    rng, state, sectors = np.random.default_rng(seed), radar.initial(), []
    seconds = count * SECTORS * radar.sector_s
    track = moving(steps=math.ceil(seconds / 0.0025), **motion)
    for number in range(count * SECTORS):
        state, sector = radar.scan(state, track, number * radar.sector_s, around, rng)
        sectors.append(sector)
    power = np.concatenate([sector.power for sector in sectors])
    return power.reshape(count, radar.spec.spokes, radar.spec.bins), sectors


def spoke_at(radar: MarineRadar, bearing_deg: float) -> int:
    """Return the number of the spoke at a bearing from the bow. The first one is astern."""
    return round((bearing_deg + 180.0) / 360.0 * radar.spec.spokes) % radar.spec.spokes


# The radar equation


def test_the_figures_of_a_radar_give_its_signal() -> None:
    """By hand: 4 kW, 24.1 dB of gain twice, 3.19 cm, 290 K, 12.5 MHz, 6 dB and 4 dB, 10 m² at 1 km."""
    radar = MarineRadar(MarineRadarSpec())
    gain_db = 10.0 * math.log10(26_000.0 / (4.0 * 25.0))
    level_db = (
        10.0 * math.log10(4000.0) + 2.0 * gain_db + 20.0 * math.log10(LIGHT_MPS / 9.41e9) + 10.0 - 120.0
        - 30.0 * math.log10(4.0 * math.pi) - 4.0
    )  # fmt: skip
    noise_db = -228.5992 + 10.0 * math.log10(290.0) + 10.0 * math.log10(12.5e6) + 6.0
    ratio = radar.signal_to_noise(np.array([10.0]), np.array([1000.0]))
    assert 10.0 * math.log10(ratio[0]) == pytest.approx(level_db - noise_db, abs=1e-3)


@pytest.mark.medium
def test_a_point_has_the_power_of_the_radar_equation() -> None:
    radar = MarineRadar(MarineRadarSpec(**FREE_SPACE))
    power, _ = turns(radar, RadarSurroundings(points=(point(400.0, 0.0, 10.0), point(0.0, -200.0, 1.0))))
    for bearing_deg, range_m, section_m2 in ((0.0, 400.0, 10.0), (270.0, 200.0, 1.0)):
        spoke = spoke_at(radar, bearing_deg)
        number = int(range_m / radar.bin_m)
        expected = radar.signal_to_noise(np.array([section_m2]), np.array([range_m]))[0]
        assert 10.0 * math.log10(power[0, spoke, number] / expected) == pytest.approx(0.0, abs=0.1)


@pytest.mark.medium
def test_the_range_of_first_detection_is_that_of_the_radar_equation() -> None:
    """A steady echo is detected half of the time where the quantile of the non-central F distribution says so."""
    stats = pytest.importorskip("scipy.stats")
    optimize = pytest.importorskip("scipy.optimize")
    spec = MarineRadarSpec(
        **FREE_SPACE, range_m=6000.0, bins=500, prf_hz=2100.0, spokes=240, false_alarm_rate=1e-4, cfar="noise"
    )
    radar = MarineRadar(spec)
    assert radar.pulse_bins == 1
    m, n = radar.pulses, spec.cfar_cells
    factor = stats.f.isf(1e-4, 2 * m, 2 * m * n)
    assert cfar_factor(1e-4, m, n) == pytest.approx(factor, rel=1e-6)
    ratio = optimize.brentq(lambda s: stats.ncf.sf(factor, 2 * m, 2 * m * n, 2 * m * s) - 0.5, 0.01, 100.0)
    expected_m = (radar.signal_m2 * 0.1 / ratio) ** 0.25
    # The share of detections in the spokes that point at 24 echoes, over two turns at each range, from near to far
    ranges_m, shares = expected_m * 10.0 ** (np.arange(-2.0, 2.1, 1.0) / 40.0), []
    for range_m in ranges_m.tolist():
        centre_m = (int(range_m / radar.bin_m) + 0.5) * radar.bin_m
        places = [(math.cos(a) * centre_m, math.sin(a) * centre_m) for a in np.arange(24) * math.tau / 24]
        section_m2 = 0.1 * (centre_m / range_m) ** 4  # as strong in the middle of the sample as at this range
        around = RadarSurroundings(points=tuple(point(north, east, section_m2) for north, east in places))
        power, _ = turns(radar, around, count=2, seed=7)
        found = [detections(radar, turn)[::10, int(range_m / radar.bin_m)] for turn in power]
        shares.append(float(np.mean(found)))
    half_m = np.interp(0.5, shares[::-1], ranges_m[::-1])
    assert shares[0] > 0.7
    assert shares[-1] < 0.3
    assert 40.0 * abs(math.log10(half_m / expected_m)) < 1.0


@pytest.mark.medium
def test_a_point_is_as_wide_as_the_beam() -> None:
    """Out and back, a beam of half-power width b is a quarter of its power b / 2 to each side."""
    for beam_deg in (2.0, 4.0, 6.0):
        radar = MarineRadar(MarineRadarSpec(**FREE_SPACE, beam_deg=beam_deg, spokes=1440, prf_hz=4000.0))
        power, _ = turns(radar, RadarSurroundings(points=(point(0.0, 300.0, 100.0),)))
        image = power[0, :, int(300.0 / radar.bin_m)]
        wide = np.flatnonzero(image > 0.25 * image.max())
        assert len(wide) * 360.0 / 1440 == pytest.approx(beam_deg, abs=0.3)
        assert np.mean(wide) * 0.25 == pytest.approx(270.0, abs=0.15)  # from astern


@pytest.mark.medium
def test_a_point_is_as_long_as_the_pulse() -> None:
    radar = MarineRadar(MarineRadarSpec(**FREE_SPACE, pulse_us=0.3))
    power, _ = turns(radar, RadarSurroundings(points=(point(0.0, 300.0, 1000.0),)))
    image = power[0, spoke_at(radar, 90.0)]
    assert np.count_nonzero(image > 0.25 * image.max()) * radar.bin_m == pytest.approx(45.0, abs=radar.bin_m)


@pytest.mark.medium
def test_two_paths_over_flat_water_interfere() -> None:
    """F⁴ = 16 sin⁴(2 pi h H / (lambda R)) over a smooth sea (Skolnik 2001, 8.2), and 1 over a rough one."""
    radar = MarineRadar(MarineRadarSpec(position_frd_m=(0.0, 0.0, -3.0), beam_height_deg=60.0))
    for range_m in (215.3, 402.8, 698.0):
        number = int(range_m / radar.bin_m)
        power = {}
        for height_m in (0.0, 8.0):
            around = RadarSurroundings(points=(point(range_m, 0.0, 100.0, 2.0),), wave_height_m=height_m)
            power[height_m] = turns(radar, around)[0][0, spoke_at(radar, 0.0), number]
        slant_m = math.hypot(range_m, 1.0)
        single = radar.signal_to_noise(np.array([100.0]), np.array([slant_m]))[0]
        lobes = 16.0 * math.sin(math.tau * 3.0 * 2.0 / (radar.wavelength_m * slant_m)) ** 4
        assert power[0.0] / single == pytest.approx(lobes, rel=0.05, abs=0.01)
        assert power[8.0] / single == pytest.approx(1.0, rel=0.05)


# Clutter


@pytest.mark.parametrize(("polarisation", "points", "published_db"), [("horizontal", 179, 2.3), ("vertical", 193, 2.2)])
def test_the_sea_has_the_published_deviation_from_the_tables(
    polarisation: str, points: int, published_db: float
) -> None:
    """The mean deviation of the model from Nathanson's tables up to 10 degrees is in table 2 of the NRL report."""
    off_db = [
        abs(float(sea_reflectivity_db(np.array(grazing_deg), ghz, state, polarisation)) - measured_db)
        for grazing_deg, table in NATHANSON_DB[polarisation].items()
        if grazing_deg <= 10.0
        for state, row in enumerate(table)
        for ghz, measured_db in zip(FREQUENCIES_GHZ, row, strict=True)
        if measured_db
    ]
    assert len(off_db) == points
    assert np.mean(off_db) == pytest.approx(published_db, abs=0.05)


@pytest.mark.medium
@pytest.mark.parametrize("state", [2.0, 3.0, 4.0, 5.0])
def test_the_image_of_the_sea_has_the_level_of_the_tables(state: float) -> None:
    """At 1 degree: within 0.3 dB of the model, and within the model's published 2.2 dB plus that of the table."""
    spec = MarineRadarSpec(**FREE_SPACE, polarisation="vertical", spokes=240, prf_hz=110.0, bins=256)
    radar = MarineRadar(spec)
    power, _ = turns(radar, RadarSurroundings(sea_state=state), count=15)
    range_m = 3.0 / math.sin(math.radians(1.0))
    number = int(range_m / radar.bin_m)
    some = slice(number - 12, number + 13)
    area_m2 = radar.middle_m[some] * math.radians(4.0) * TWO_WAY_SHARE * radar.pulse_m
    ratio = radar.signal_to_noise(area_m2, radar.middle_m[some])
    elevation = np.degrees(np.arcsin(3.0 / radar.middle_m[some])) / spec.beam_height_deg
    ratio *= np.exp(-8.0 * math.log(2.0) * elevation**2)
    measured_db = 10.0 * math.log10(np.mean((power[:, :, some].mean(axis=(0, 1)) - 1.0) / ratio))
    grazing_deg = np.degrees(np.arcsin(3.0 / radar.middle_m[some]))
    by_wind = np.mean(10.0 ** (0.1 * wind_factor_db(np.linspace(0, math.tau, 360), 1.0, radar.wavelength_m)))
    model = np.mean(10.0 ** (0.1 * sea_reflectivity_db(grazing_deg, 9.41, state, "vertical")))
    assert measured_db == pytest.approx(10.0 * math.log10(model * by_wind), abs=0.3)
    table_db = NATHANSON_DB["vertical"][1.0][int(state)][X_BAND]
    assert measured_db - 10.0 * math.log10(by_wind) == pytest.approx(table_db, abs=3.0)


@pytest.mark.slow
def test_the_sea_is_brighter_against_the_wind() -> None:
    radar = MarineRadar(MarineRadarSpec(**FREE_SPACE, spokes=240, prf_hz=110.0, bins=128))
    around = RadarSurroundings(sea_state=4.0, wind_from_rad=math.radians(90.0), waves_from_rad=math.radians(90.0))
    power, _ = turns(radar, around, count=60)
    mean = power[:, :, 15:60].mean(axis=(0, 2)) - 1.0
    against, across, along = (
        mean[spoke_at(radar, bearing_deg) + np.arange(-10, 11)].mean() for bearing_deg in (90.0, 0.0, -90.0)
    )
    expected_db = float(wind_factor_db(np.array(0.0), np.array(1.0), radar.wavelength_m))
    assert 10.0 * math.log10(against / across) == pytest.approx(expected_db, abs=0.7)
    assert 10.0 * math.log10(along / across) == pytest.approx(-expected_db, abs=0.7)


@pytest.mark.medium
def test_resolution_cells_of_the_sea_are_gamma_variables_of_the_shape() -> None:
    """A gamma variable of mean 1 has the variance 1 / shape. Shapes vary with the angle from the waves."""
    spec = MarineRadarSpec(**FREE_SPACE, polarisation="vertical", spokes=240, prf_hz=110.0, bins=128)
    radar, rng = MarineRadar(spec), np.random.default_rng(5)
    around, track, state, cells = RadarSurroundings(sea_state=4.0), moving(steps=10), radar.initial(), []
    for _ in range(50 * SECTORS):
        state, _ = radar.scan(state, track, 0.0, around, rng)
        cells.extend(state.texture[[-1, -4, -7]])  # a cell is three of the ten spokes of a sector
    drawn = np.array(cells)
    for number in (10, 40, 100):
        range_m = float(radar.middle_m[number - number % radar.pulse_bins])
        grazing_deg = math.degrees(math.asin(3.0 / range_m))
        cell_m2 = range_m * math.radians(4.0) * TWO_WAY_SHARE * radar.pulse_m
        angles = np.linspace(0.0, math.tau, 90, endpoint=False)
        shape = spike_shape(np.full(90, grazing_deg), np.full(90, cell_m2), angles, "vertical")
        assert drawn[:, number].mean() == pytest.approx(1.0, abs=0.06)
        assert drawn[:, number].var() == pytest.approx(float(np.mean(1.0 / shape)), rel=0.25)


def test_sea_states_follow_waves_and_wind() -> None:
    calm, waves = WaveSpec(), WaveSpec(spectrum="jonswap", significant_height_m=1.0)
    assert sea_state(calm, 0.0) is None
    assert sea_state(calm, 3.16) == pytest.approx(1.0)
    assert sea_state(waves, 0.0) == pytest.approx(9.6 ** (1.0 / 2.1))
    assert sea_state(waves, 20.0) == 6.0


@pytest.mark.medium
def test_the_image_of_rain_has_the_level_of_marshall_and_palmer() -> None:
    """Skolnik 2001, 7.6: eta = 7e-12 f^4 r^1.6 m²/m³, with f in GHz and r in mm/h."""
    radar = MarineRadar(MarineRadarSpec(**FREE_SPACE, spokes=240, prf_hz=110.0, bins=256))
    eta = rain_reflectivity_per_m(16.0, radar.wavelength_m)
    assert 10.0 * math.log10(eta / (7e-12 * 9.41**4 * 16.0**1.6)) == pytest.approx(0.0, abs=0.1)
    power, _ = turns(radar, RadarSurroundings(rain_mmph=16.0), count=20)
    number = int(300.0 / radar.bin_m)
    range_m = float(radar.middle_m[number])
    beam_sr = math.radians(4.0) * math.radians(25.0) * math.pi / (8.0 * math.log(2.0))
    volume_m3 = 0.5 * range_m**2 * beam_sr * radar.pulse_m
    expected = radar.signal_to_noise(np.array([eta * volume_m3]), np.array([range_m]), 16.0)[0]
    assert 10.0 * math.log10((power[:, :, number].mean() - 1.0) / expected) == pytest.approx(0.0, abs=0.3)


@pytest.mark.parametrize(("ghz", "k", "alpha"), [(9.0, 0.007535, 1.3155), (10.0, 0.01217, 1.2571)])
def test_rain_attenuates_as_in_table_5_of_p838(ghz: float, k: float, alpha: float) -> None:
    for rain_mmph in (1.0, 16.0, 100.0):
        assert rain_attenuation_dbpkm(rain_mmph, ghz) == pytest.approx(k * rain_mmph**alpha, rel=1e-3)
    assert rain_attenuation_dbpkm(0.0, ghz) == 0.0


# Objects


@pytest.mark.medium
def test_a_wall_hides_what_is_behind_and_not_what_is_beside_or_above() -> None:
    """Of 4 m: it hides a reflector of 3 m from an antenna at 3 m, and not one of 20 m."""
    radar = MarineRadar(MarineRadarSpec(**FREE_SPACE))
    wall = mesh_points(moved(box((4.0, 60.0, 8.0), CONCRETE), (200.0, 0.0, 0.0), np.eye(3)), 2.0)
    behind, beside = point(300.0, 0.0, 1000.0), point(300.0, 150.0, 1000.0)
    mast, north = point(400.0, 0.0, 1000.0, 20.0), spoke_at(radar, 0.0)
    diagonal = spoke_at(radar, math.degrees(math.atan2(150.0, 300.0)))
    image = turns(radar, RadarSurroundings(points=(wall, behind, beside, mast)))[0][0]
    assert image[north, int(198.0 / radar.bin_m)] > 1e5
    assert image[north, int(300.0 / radar.bin_m)] < 10.0
    assert image[diagonal, int(math.hypot(300.0, 150.0) / radar.bin_m)] > 1e3
    assert image[north, int(math.hypot(400.0, 17.0) / radar.bin_m)] > 1e2
    assert turns(radar, RadarSurroundings(points=(behind,)))[0][0, north, int(300.0 / radar.bin_m)] > 1e3


@pytest.mark.medium
def test_a_wall_hides_the_sea() -> None:
    radar = MarineRadar(MarineRadarSpec(**FREE_SPACE))
    wall = mesh_points(moved(box((4.0, 60.0, 8.0), CONCRETE), (100.0, 0.0, 0.0), np.eye(3)), 2.0)
    power, _ = turns(radar, RadarSurroundings(points=(wall,), sea_state=5.0), count=3)
    far = slice(int(140.0 / radar.bin_m), int(200.0 / radar.bin_m))
    ahead, abeam = (spoke_at(radar, bearing_deg) + np.arange(-10, 11) for bearing_deg in (0.0, 90.0))
    assert power[:, ahead, far].mean() == pytest.approx(1.0, abs=0.05)
    assert power[:, abeam, far].mean() > 100.0


@pytest.mark.medium
def test_nothing_is_seen_beyond_the_horizon_of_the_water() -> None:
    """4.12 km (sqrt h + sqrt H) with 4/3 of the Earth's radius: 3 m and 1 m see each other over 11.2 km."""
    spec = MarineRadarSpec(
        **FREE_SPACE, range_m=16_000.0, bins=1024, spokes=240, peak_power_w=1e6, cfar="noise", pulse_us=0.5
    )
    radar = MarineRadar(spec)
    for range_m, seen in ((10_500.0, True), (12_500.0, False)):
        power, _ = turns(radar, RadarSurroundings(points=(point(range_m, 0.0, 1e4, 1.0),)))
        assert (power[0, spoke_at(radar, 0.0), int(range_m / radar.bin_m)] > 30.0) == seen


def test_a_flat_wall_has_the_gamma_of_its_material() -> None:
    for material, gamma in ((CONCRETE, 1.0), (EARTH, 10.0**-1.5)):
        points = mesh_points(box((10.0, 4.0, 2.0), material), 0.5)
        toward = np.tile([0.0, math.cos(0.5), math.sin(0.5)], (len(points), 1))
        section_m2 = points.cross_section_m2(toward).sum()
        expected = 10.0 * 2.0 * math.cos(0.5) + 10.0 * 4.0 * math.sin(0.5)
        assert section_m2 == pytest.approx(gamma * expected, rel=1e-9)


@pytest.mark.parametrize(("length_m", "published_m2"), [(3.0, 0.02), (7.6, 2.0), (10.0, 2.5), (13.7, 10.0)])
def test_a_boat_has_the_published_cross_section_on_average(length_m: float, published_m2: float) -> None:
    points = vessel_points(box((length_m, 0.3 * length_m, 2.0), CONCRETE), 0.5)
    headings = np.radians(np.arange(360.0))
    sections = [
        points.cross_section_m2(np.tile([math.cos(a), math.sin(a), 0.0], (len(points), 1))).sum()
        for a in headings.tolist()
    ]
    assert np.mean(sections) == pytest.approx(published_m2, rel=1e-3)
    assert sections[90] / sections[0] == pytest.approx(
        1.0 / 0.3, rel=0.05
    )  # broadside; the cut at the water is that of the points


def test_a_ship_has_the_cross_section_of_skolnik() -> None:
    """52 f^0.5 D^1.5 of a Mariner of 17 kt at 9410 MHz."""
    expected = 52.0 * math.sqrt(9410.0) * 17.0**1.5
    assert 10.0 * math.log10(float(vessel_section_m2(161.0)) / expected) == pytest.approx(0.0, abs=0.1)
    lengths_m = np.geomspace(1.0, 400.0, 50)
    assert np.all(np.diff(vessel_section_m2(lengths_m)) > 0.0)


def test_reflectors_are_those_of_imo() -> None:
    assert REFLECTOR_SECTIONS_M2["buoy"] == (5.0, 3.5)
    assert REFLECTOR_SECTIONS_M2["small-vessel"] == (2.5, 2.0)
    assert RadarReflectorSpec(place_ne_m=(1.0, 2.0)).cross_section_m2 is None


# Motion


@pytest.mark.medium
def test_a_turning_vessel_sees_an_object_at_its_bearing_in_each_turn() -> None:
    """At 20 degrees per second, the true bearing is the sum of the heading at the spoke and its angle."""
    radar = MarineRadar(MarineRadarSpec(**FREE_SPACE))
    around = RadarSurroundings(points=(point(200.0, 200.0, 100.0),))
    power, sectors = turns(radar, around, count=3, turning_degps=(0.0, 0.0, 20.0))
    number = int(math.hypot(200.0, 200.0) / radar.bin_m)
    for turn in (1, 2):
        spoke = int(np.argmax(power[turn, :, number]))
        seconds = (turn * radar.spec.spokes + spoke) * radar.spoke_s
        assert math.fmod(20.0 * seconds + 180.0 + 0.5 * spoke, 360.0) == pytest.approx(45.0, abs=0.6)
        sector = sectors[turn * SECTORS + spoke // radar.sector_spokes]
        expected_deg = 20.0 * (turn * SECTORS + spoke // radar.sector_spokes) * radar.sector_s
        assert math.degrees(sector.heading_rad) == pytest.approx(expected_deg % 360.0, abs=0.05)


@pytest.mark.medium
def test_a_moving_vessel_sees_the_range_at_each_turn() -> None:
    radar = MarineRadar(MarineRadarSpec(**FREE_SPACE))
    power, _ = turns(
        radar, RadarSurroundings(points=(point(300.0, 0.0, 100.0),)), count=4, velocity_ned_mps=(10.0, 0.0, 0.0)
    )
    for turn in range(1, 4):
        plots = find_plots(radar, power[turn])
        (plot,) = [plot for plot in plots if plot.strength_db > 30.0]
        seconds = turn * 60.0 / radar.spec.rpm + plot.spoke * radar.spoke_s
        assert plot.range_m == pytest.approx(300.0 - 10.0 * seconds, abs=1.0)


@pytest.mark.medium
def test_a_seed_repeats_and_another_does_not() -> None:
    radar = MarineRadar(MarineRadarSpec(sea_state=3.0))
    around = RadarSurroundings(points=(point(300.0, 0.0, 10.0),), sea_state=3.0, rain_mmph=4.0)
    first, again, other = (turns(radar, around, seed=seed)[0].tobytes() for seed in (1, 1, 2))
    assert first == again != other


# Receiver and plots


def test_levels_are_quantised_in_decibels() -> None:
    radar = MarineRadar(MarineRadarSpec(min_range_m=0.0, floor_db=0.0, span_db=51.0))
    level_db = np.linspace(-10.0, 70.0, radar.spec.bins)
    video = radar.video(10.0 ** (0.1 * level_db)[None])
    np.testing.assert_array_equal(video[0], np.clip(np.rint(level_db * 5.0), 0, 255))


def test_stc_takes_the_power_law_away() -> None:
    radar = MarineRadar(MarineRadarSpec(min_range_m=0.0, stc_range_m=300.0, stc_exponent=3.0, span_db=51.0))
    law = (300.0 / radar.middle_m) ** 3 * 1e2
    video = radar.video(law[None])[0]
    assert np.all(video[: int(300.0 / radar.bin_m)] == 100)
    assert video[-1] == round((20.0 - 30.0 * math.log10(radar.middle_m[-1] / 300.0)) * 5.0)


def test_ftc_takes_constant_levels_away_and_keeps_edges() -> None:
    radar = MarineRadar(MarineRadarSpec(min_range_m=0.0, ftc_m=50.0, span_db=51.0))
    level = np.full(radar.spec.bins, 1e2)
    level[300:] = 1e5
    video = radar.video(level[None])[0].astype(int)
    assert set(video[:300]) == {0}
    assert video[300] == 150
    assert set(video[300 + round(50.0 / radar.bin_m) :]) == {0}


@pytest.mark.medium
@pytest.mark.parametrize("rate", [1e-2, 1e-3])
@pytest.mark.parametrize(("cfar", "rain_mmph"), [("noise", 0.0), ("clutter", 20.0)])
def test_the_false_alarm_rate_is_that_of_the_key(rate: float, cfar: str, rain_mmph: float) -> None:
    """In noise, and in rain, whose echo is a Rayleigh variable.

    Samples are independent along a spoke, as they are longer than a pulse. The echo of rain is the same over a beam.
    """
    spec = MarineRadarSpec(
        **FREE_SPACE, range_m=3000.0, bins=128, spokes=720, peak_power_w=1e6, false_alarm_rate=rate, cfar=cfar
    )
    radar = MarineRadar(spec)
    power, _ = turns(radar, RadarSurroundings(rain_mmph=rain_mmph), count=6, seed=3)
    far = slice(60, 110)
    alarms = np.array([detections(radar, turn)[:, far] for turn in power])
    independent = alarms.size / (1.0 if not rain_mmph else 8.0)
    deviation = math.sqrt(rate / independent)
    assert alarms.mean() == pytest.approx(rate, abs=4.0 * deviation)


@pytest.mark.medium
def test_noise_as_long_as_a_pulse_has_the_false_alarm_rate_too() -> None:
    radar = MarineRadar(MarineRadarSpec(cfar="noise", false_alarm_rate=1e-3))
    assert radar.pulse_bins == 8
    power, _ = turns(radar, RadarSurroundings(), count=4)
    alarms = np.mean([detections(radar, turn)[:, radar.first_bin :] for turn in power])
    assert alarms == pytest.approx(1e-3, rel=0.2)


@pytest.mark.medium
def test_plots_have_range_bearing_strength_and_size() -> None:
    radar = MarineRadar(MarineRadarSpec(**FREE_SPACE))
    around = RadarSurroundings(points=(point(0.0, 250.0, 10.0), point(400.0, 0.0, 100.0)))
    plots = [plot for plot in find_plots(radar, turns(radar, around)[0][0]) if plot.strength_db > 30.0]
    assert len(plots) == 2
    for plot, range_m, bearing_deg, section_m2 in zip(plots, (250.0, 400.0), (90.0, 0.0), (10.0, 100.0), strict=True):
        off_deg = math.remainder(math.degrees(plot.bearing_rad) - bearing_deg, 360.0)
        assert plot.range_m == pytest.approx(range_m, abs=radar.bin_m)
        assert off_deg == pytest.approx(0.0, abs=0.25)
        expected = radar.signal_to_noise(np.array([section_m2]), np.array([range_m]))[0]
        assert plot.strength_db == pytest.approx(10.0 * math.log10(expected), abs=0.3)
        assert radar.pulse_m - radar.bin_m <= plot.length_m <= radar.pulse_m + radar.bin_m
        assert 4.0 <= math.degrees(plot.width_rad) <= 12.0


@pytest.mark.medium
def test_two_points_a_beam_and_a_half_apart_are_two_plots_and_half_a_beam_apart_one() -> None:
    radar = MarineRadar(MarineRadarSpec(**FREE_SPACE))
    for apart_deg, count in ((14.0, 2), (2.0, 1)):
        places = [(300.0 * math.cos(a), 300.0 * math.sin(a)) for a in np.radians([45.0, 45.0 + apart_deg]).tolist()]
        around = RadarSurroundings(points=tuple(point(north, east, 1.0) for north, east in places))
        plots = find_plots(radar, turns(radar, around)[0][0])
        assert len([plot for plot in plots if plot.strength_db > 25.0]) == count


# Bad input


@pytest.mark.parametrize(
    ("keys", "text"),
    [
        ({"range_m": 80_000.0}, "prf_hz: 1873 or less"),
        ({"spokes": 700}, "use 696 or 720"),
        ({"spokes": 4320, "prf_hz": 1000.0}, "is more than the 2500 pulses of a turn"),
        ({"position_frd_m": (0.0, 0.0, 0.5)}, "is not above the water"),
        ({"range_m": 60.0}, "use 0.05 or less, or raise range_m"),
        ({"min_range_m": 800.0}, "min_range_m = 800 is not below range_m = 750"),
    ],
)
def test_impossible_radars_are_refused_with_a_fix(keys: dict[str, Any], text: str) -> None:
    with pytest.raises(SpecificationError, match=text):
        MarineRadarSpec(**keys)
