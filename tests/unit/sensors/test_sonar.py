"""The sonar against closed forms: level over range, beam, shadow, speckle, sector and time."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from sim_core.sensors.sonar import (
    FLOOR_DB,
    GAIN_DB,
    OVERHEAD_S,
    RING_DB,
    RING_DBPS,
    SPAN_DB,
    Below,
    PingSettings,
    ScanningSonar,
    Sector,
    absorption_dbpm,
    received,
    sound_speed_mps,
    turning_s,
)
from sim_core.sensors.spec import SonarSpec
from sim_core.world import geometry as shapes
from sim_core.world.geometry import BED, CONCRETE, STEEL, Box, Plane, Solid, Sphere
from sim_core.world.primitive_rays import PrimitiveCaster
from sim_core.world.ray_backends import make_caster
from sim_core.world.rays import Scene, ScenePart

Array = NDArray[np.float64]

SONAR = ScanningSonar(SonarSpec(position_frd_m=(0.0, 0.0, 0.0), water_temperature_c=25.0))
SPEED_MPS = sound_speed_mps(25.0)
DEEP_M = -1000.0  # a surface so far up that nothing is heard of it
LEVEL = np.eye(3)
ORIGIN = np.zeros(3)


def settings(range_m: float = 40.0, samples: int = 800, angle_grad: int = 0) -> PingSettings:
    return PingSettings(angle_grad, 2.0 * range_m / SPEED_MPS / samples, samples, 1e-6)


def heard(solids: list[Solid], pings: int = 1, seed: int = 1) -> Array:
    """Mean power (samples,) of what stands there alone, without the haze of the water itself."""
    rng = np.random.default_rng(seed)
    below = Below(PrimitiveCaster(solids), DEEP_M)
    empty = SONAR.scattered(settings(), ORIGIN, LEVEL, Below(PrimitiveCaster([]), DEEP_M), rng)
    total = sum(SONAR.scattered(settings(), ORIGIN, LEVEL, below, rng) for _ in range(pings))
    return np.asarray(total / pings - empty)


def ranges_m() -> Array:
    return (np.arange(800) + 0.5) * 0.05


def level_db(power: Array) -> float:
    return 10.0 * math.log10(power.sum())


def wall(range_m: float) -> Plane:
    return Plane(np.array([-1.0, 0.0, 0.0]), -range_m, STEEL)


@pytest.mark.parametrize("range_m", [2.0, 5.0, 10.0, 20.0, 35.0])
def test_a_wall_that_fills_the_beam_is_as_loud_as_the_sonar_equation_says(range_m: float) -> None:
    """-20 log r - 2 a r. The rim of the beam meets it farther off and at a slant: a share of about cos^3 of up to 12
    degrees, 0.2 dB."""
    expected = -20.0 * math.log10(range_m) - 2.0 * absorption_dbpm(750.0, 25.0) * range_m
    assert level_db(heard([wall(range_m)], pings=10)) == pytest.approx(expected, abs=0.4)


@pytest.mark.medium
def test_a_small_object_falls_by_forty_log_r() -> None:
    """From 10 m to 20 m: 40 log 2 and absorption. The pattern of the narrow beam takes 0.5 dB of the nearer one, which
    fills more of it; 300 pings leave 0.4 dB of chance."""
    near, far = (
        level_db(heard([Sphere(np.array([range_m, 0.0, 0.0]), 0.12, STEEL)], pings=300)) for range_m in (10.0, 20.0)
    )
    assert near - far == pytest.approx(40.0 * math.log10(2.0) + 20.0 * absorption_dbpm(750.0, 25.0), abs=1.2)


@pytest.mark.medium
def test_the_beam_is_half_as_strong_at_its_edges_out_and_half_back() -> None:
    def at(side_deg: float, up_deg: float, radius_m: float) -> float:
        side, up = math.radians(side_deg), math.radians(up_deg)
        place = 10.0 * np.array([math.cos(up) * math.cos(side), math.cos(up) * math.sin(side), -math.sin(up)])
        return level_db(heard([Sphere(place, radius_m, STEEL)], pings=300))

    # Two ways 3 dB each. Small against the beam, so that its pattern is that of one direction to 0.5 dB.
    assert at(0.0, 0.0, 0.2) - at(0.0, 12.5, 0.2) == pytest.approx(6.0, abs=0.8)
    assert at(0.0, 0.0, 0.1) - at(1.0, 0.0, 0.1) == pytest.approx(6.0, abs=1.2)


def test_the_echo_is_at_the_range_of_the_wall() -> None:
    power = heard([wall(12.34)])
    assert abs(ranges_m()[int(np.argmax(power))] - 12.34) <= 0.05


def test_a_softer_wall_is_quieter_by_its_backscatter() -> None:
    soft = Plane(np.array([-1.0, 0.0, 0.0]), -10.0, CONCRETE)
    assert level_db(heard([soft], pings=10)) - level_db(heard([wall(10.0)], pings=10)) == pytest.approx(
        10.0 * math.log10(CONCRETE.backscatter), abs=0.1
    )


def test_the_shadow_on_the_bed_is_as_long_as_similar_triangles_say() -> None:
    """The sonar 3 m above the bed, an object 1 m tall at 10 m: dark to 15 m along the bed. A ray's cell of the beam,
    0.6 degrees, covers 0.8 m there; half of it blurs the edge."""
    box = Box(np.array([10.01, 0.0, 2.5]), np.array([0.02, 20.0, 1.0]), LEVEL, STEEL)
    bed = Plane(np.array([0.0, 0.0, -1.0]), -3.0, BED)
    open_bed, shadowed = heard([bed], pings=20), heard([bed, box], pings=20)
    along_m = np.sqrt(np.maximum(ranges_m() ** 2 - 9.0, 0.0))
    dark = (along_m > 10.7) & (along_m < 14.5)
    assert (open_bed[dark] > 0.0).all()
    assert shadowed[dark].max() <= 1e-15
    lit = ((along_m > 6.5) & (along_m < 9.0)) | ((along_m > 15.5) & (along_m < 18.0))
    assert 10.0 * math.log10(shadowed[lit].sum() / open_bed[lit].sum()) == pytest.approx(0.0, abs=0.3)


def test_embree_and_closed_forms_hear_the_same() -> None:
    pytest.importorskip("embreex")
    size = np.array([1.0, 6.0, 4.0])
    mesh = shapes.moved(shapes.box((1.0, 6.0, 4.0), STEEL), (12.0, 1.0, 0.0))
    scene = Scene((ScenePart("box", mesh, (Box(np.array([12.0, 1.0, 0.0]), size, LEVEL, STEEL),)),))
    power = [
        SONAR.scattered(settings(), ORIGIN, LEVEL, Below(make_caster(scene, backend), DEEP_M), np.random.default_rng(3))
        for backend in ("embree", "numpy")
    ]
    assert power[0] == pytest.approx(power[1], rel=1e-4, abs=1e-12)


def test_the_head_turns_clockwise_with_the_vessel() -> None:
    """A wall to the east: at 100 gradians of a vessel heading north, at 0 of one heading east."""
    below = Below(PrimitiveCaster([Plane(np.array([0.0, -1.0, 0.0]), -10.0, STEEL)]), DEEP_M)
    east = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    for attitude, loud, silent in ((LEVEL, 100, 300), (east, 0, 200)):
        rng = np.random.default_rng(1)
        powers = [SONAR.scattered(settings(angle_grad=grad), ORIGIN, attitude, below, rng) for grad in (loud, silent)]
        assert powers[0][195:205].sum() > 1e4 * powers[1][195:205].sum()


def test_nothing_above_the_surface_is_heard_and_the_surface_faintly() -> None:
    """A wall that ends 5 cm above the surface, which is 1 m above the sonar."""
    above = Box(np.array([10.0, 0.0, -3.05]), np.array([1.0, 20.0, 4.0]), LEVEL, STEEL)
    rng = np.random.default_rng(2)
    caster = PrimitiveCaster([above])
    power = SONAR.scattered(settings(), ORIGIN, LEVEL, Below(caster, -1.0), rng)
    without = SONAR.scattered(settings(), ORIGIN, LEVEL, Below(PrimitiveCaster([]), -1.0), np.random.default_rng(2))
    assert power == pytest.approx(without, rel=1e-9)
    deep = SONAR.scattered(settings(), ORIGIN, LEVEL, Below(PrimitiveCaster([]), DEEP_M), rng)
    assert (without - deep)[40:200].max() > 0.0


def test_out_of_the_water_there_is_noise_alone() -> None:
    rng = np.random.default_rng(1)
    assert not SONAR.scattered(settings(), ORIGIN, LEVEL, Below(PrimitiveCaster([wall(5.0)]), 0.1), rng).any()


def test_speckle_is_rayleigh() -> None:
    """Power is exponential then: in decibels of mean -2.51 and deviation 5.57. 12 000 samples leave 0.05 dB of chance,
    and steps of a third of a decibel far less."""
    ping = PingSettings(0, 5e-5, 1200, 1e-6)
    rng = np.random.default_rng(4)
    heard_db = np.concatenate(
        [received(np.full(1200, 1e-5), ping, rng)[100:] * (SPAN_DB / 255.0) + FLOOR_DB for _ in range(10)]
    )
    assert heard_db.mean() == pytest.approx(-50.0 - 2.51, abs=0.2)
    assert heard_db.std() == pytest.approx(5.57, abs=0.2)


def test_the_ringing_dies_away_behind_the_pulse() -> None:
    ping = PingSettings(0, 2e-5, 600, 2e-4)
    echo = received(np.zeros(600), ping, np.random.default_rng(4)) * (SPAN_DB / 255.0) + FLOOR_DB
    since_s = (np.arange(600) + 0.5) * ping.sample_period_s
    rings = RING_DB - RING_DBPS * (since_s - ping.pulse_s)
    heard = (rings > -60.0) & (rings < FLOOR_DB + SPAN_DB)
    assert heard.sum() > 20
    assert echo[heard] == pytest.approx(rings[heard], abs=0.2)
    assert echo[rings > 0.0] == pytest.approx(FLOOR_DB + SPAN_DB)
    assert echo[rings < -110.0].max() < -75.0


def test_off_its_frequency_the_transducer_is_weaker() -> None:
    """6 dB at 100 kHz off, and what the water takes more of it, both ways."""
    below = Below(PrimitiveCaster([wall(5.0)]), DEEP_M)
    centre, above = (
        SONAR.scattered(replace(settings(), frequency_khz=khz), ORIGIN, LEVEL, below, np.random.default_rng(1))[90:110]
        for khz in (750.0, 850.0)
    )
    more = 10.0 * (absorption_dbpm(850.0, 25.0) - absorption_dbpm(750.0, 25.0))
    assert level_db(centre) - level_db(above) == pytest.approx(6.0 + more, abs=0.01)


def test_gain_lifts_by_its_decibels_and_ends_at_255() -> None:
    for gain, decibels in enumerate(GAIN_DB):
        ping = PingSettings(0, 5e-5, 1200, 1e-6, gain=gain)
        echo = received(np.full(1200, 1e-5), ping, np.random.default_rng(4)).astype(float)
        assert echo[100:].mean() * (SPAN_DB / 255.0) + FLOOR_DB == pytest.approx(-52.5 + decibels, abs=0.5)
        assert received(np.full(1200, 1e3), ping, np.random.default_rng(4)).max() == 255


def test_a_long_pulse_smears_about_its_middle() -> None:
    power = np.zeros(600)
    power[300] = 1e-3
    ping = PingSettings(0, 5e-5, 600, 5e-4)
    rng = np.random.default_rng(1)
    mean = np.mean([received(power, ping, rng) for _ in range(50)], axis=0)
    loud = np.flatnonzero(mean[100:] > 100.0) + 100  # beyond what the transducer rings
    assert loud.tolist() == list(range(295, 306))  # ten periods, half of the outer two


def test_a_seed_repeats_the_echo() -> None:
    below = Below(PrimitiveCaster([wall(9.0)]), -1.0)
    first, second = (SONAR.echo(settings(), ORIGIN, LEVEL, below, np.random.default_rng(8)) for _ in range(2))
    assert first.dtype == np.uint8
    assert first.tobytes() == second.tobytes()


def scanned(sector: Sector, pings: int) -> list[int]:
    offset, forward, angles = 0, True, []
    for _ in range(pings):
        angles.append(sector.angle_grad(offset))
        offset, forward = sector.after(offset, forward)
    return angles


def test_a_sector_is_scanned_to_and_fro_and_a_turn_round_and_round() -> None:
    assert scanned(Sector(398, 4, 2), 7) == [398, 0, 2, 0, 398, 0, 2]
    assert scanned(Sector(0, 7, 3), 6) == [0, 3, 6, 3, 0, 3]
    assert scanned(Sector(10, 0, 2), 3) == [10, 10, 10]
    assert scanned(Sector(0, 399, 1), 402)[-3:] == [399, 0, 1]
    assert scanned(Sector(300, 400, 100), 6) == [300, 0, 100, 200, 300, 0]


@pytest.mark.parametrize(("range_m", "turn_s"), [(2.0, 9.0), (50.0, 35.0)])
def test_a_turn_takes_as_long_as_the_maker_says(range_m: float, turn_s: float) -> None:
    ping_s = 2.0 * range_m / 1500.0 + OVERHEAD_S + turning_s(399, 0)
    assert 400 * ping_s == pytest.approx(turn_s, rel=0.03)


def test_impossible_figures_are_refused() -> None:
    with pytest.raises(ValueError, match=r"SonarSpec\.water_temperature_c = 90"):
        ScanningSonar(SonarSpec(water_temperature_c=90.0))
    with pytest.raises(ValueError, match=r"SonarSpec\.heading_deg"):
        ScanningSonar(SonarSpec(heading_deg=math.nan))
