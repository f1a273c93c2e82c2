"""Water under a lidar: it returns little, nearby; and nothing is ever seen below it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from lidar_scenes import NOTHING, PlaneCaster, accounted, moving, water

from sim_core.environment.environment import Environment
from sim_core.environment.spec import CurrentSpec, EnvironmentSpec, Water, WaveSpec
from sim_core.environment.waves import FlatWater, WaveField, realise_waves
from sim_core.frames import euler_to_quat, quat_to_matrix
from sim_core.sensors.lidar import BodyTrack, Lidar, LidarScan
from sim_core.sensors.optics import WaterSeen
from sim_core.sensors.spec import LidarSpec
from sim_core.world.geometry import ROCK

METRE_UP = (0.0, 0.0, -1.0)
EXACT = Lidar(LidarSpec(range_noise_m=0.0, position_frd_m=(0.0, 0.0, 0.0)))


def sea(seed: int = 1, height_m: float = 0.3) -> WaveField:
    waves = WaveSpec("jonswap", height_m, 2.5, 40.0, spreading=10.0, components=32)
    return realise_waves(waves, Water(), np.random.default_rng(seed))


def in_ned(scan: LidarScan, track: BodyTrack) -> np.ndarray:
    """Points put where the vessel was at their instants; pose linear between steps, as the sensor has it."""
    known_s = (track.stamps_ns - track.stamps_ns[0]) * 1e-9
    later_s = scan.offset_s.astype(float)
    leg = np.clip(np.searchsorted(known_s, later_s, side="right") - 1, 0, len(known_s) - 2)
    share = ((later_s - known_s[leg]) / np.diff(known_s)[leg])[:, None]
    place = track.pos_ned_m[leg] * (1 - share) + track.pos_ned_m[leg + 1] * share
    turned = track.rot_ned_frd[leg] * (1 - share[..., None]) + track.rot_ned_frd[leg + 1] * share[..., None]
    return place + np.einsum("nij,nj->ni", turned, scan.points_frd_m.astype(float))


def test_flat_water_is_a_plane_that_ends_nearby() -> None:
    scan = EXACT.scan(moving(place_ned_m=METRE_UP), NOTHING, water(0.0), np.random.default_rng(1))
    assert accounted(scan.fates)
    assert scan.fates.returned == scan.fates.from_water > 1000
    assert scan.fates.water > 100
    np.testing.assert_allclose(scan.points_frd_m[:, 2], 1.0, atol=2e-6)
    off = np.hypot(scan.points_frd_m[:, 0], scan.points_frd_m[:, 1])
    assert np.quantile(off, 0.95) < 11.0
    assert off.max() < 25.0
    assert np.mean(off < 5.0) > 0.6


def test_a_lidar_sees_the_surface_that_a_current_carries() -> None:
    """Each ray at its own instant, where the scene has the surface then: within 1e-5 of 0.3 m in single precision."""
    spec = EnvironmentSpec(
        current=CurrentSpec(1.2, 70.0),
        waves=WaveSpec("jonswap", 0.3, 2.5, 40.0, spreading=10.0),
        water=Water(level_m=0.4),
    )
    environment = Environment.from_spec(spec, np.random.default_rng(4))
    seen = WaterSeen.around(environment, 33.0, np.array([5.0, -7.0, 0.0]))
    rng = np.random.default_rng(5)
    places, later_s = rng.uniform(-10.0, 10.0, (50, 3)), rng.uniform(0.0, 0.1, 50)
    expected = [environment.surface_ned_z_m(33.0 + s, place[:2]) for s, place in zip(later_s, places, strict=True)]
    got = seen.down_m(places.astype(np.float32), later_s.astype(np.float32))
    np.testing.assert_allclose(got, expected, atol=3e-5)


def test_how_far_water_is_seen_is_where_its_light_is_just_enough() -> None:
    """rho (1 - F)^2 cos / 0.1 (90 m / r)^2 = 1, cos = height / r: half the rays there return."""
    lidar = Lidar(LidarSpec(range_noise_m=0.0, pitch_deg=-8.0, position_frd_m=(0.0, 0.0, 0.0)), water_reflectivity=0.05)

    def light(range_m: float) -> float:
        cosine = 1.0 / range_m
        angle = math.acos(cosine)
        refracted = math.asin(math.sin(angle) / 1.328)
        less, more = angle - refracted, angle + refracted
        passed = 1.0 - 0.5 * (math.sin(less) / math.sin(more)) ** 2 - 0.5 * (math.tan(less) / math.tan(more)) ** 2
        return 0.05 * passed**2 * cosine / 0.1 * (90.0 / range_m) ** 2

    low_m, high_m = 2.0, 60.0
    for _ in range(60):
        middle_m = 0.5 * (low_m + high_m)
        low_m, high_m = (middle_m, high_m) if light(middle_m) > 1.0 else (low_m, middle_m)
    seen = fired = 0
    for number in range(4):
        caster = PlaneCaster((0.0, 0.0, 1.0), -1e9)
        track = moving(number * 100_000_000, place_ned_m=METRE_UP)
        scan = lidar.scan(track, caster, water(0.0), np.random.default_rng(number))
        to_water = 1.0 / np.maximum(caster.asked[0][1][:, 2], 1e-6)
        fired += np.count_nonzero(np.abs(to_water / low_m - 1.0) < 0.05)
        seen += np.count_nonzero(np.abs(np.linalg.norm(scan.points_frd_m, axis=1) / low_m - 1.0) < 0.05)
    # Light falls by r^-3 to r^-4: over 5 % both ways 0.4 of the deviation of its logarithm, 0.5.
    assert fired > 300
    assert seen / fired == pytest.approx(0.5, abs=0.1)


def test_water_that_scatters_nothing_returns_nothing() -> None:
    lidar = Lidar(LidarSpec(position_frd_m=(0.0, 0.0, 0.0)), water_reflectivity=0.0)
    scan = lidar.scan(moving(place_ned_m=METRE_UP), NOTHING, water(0.0), np.random.default_rng(1))
    assert scan.fates.returned == 0


def test_a_wall_ends_at_the_waterline() -> None:
    wall = PlaneCaster((1.0, 0.0, 0.0), 8.0, ROCK)
    scan = EXACT.scan(moving(place_ned_m=METRE_UP), wall, water(0.0), np.random.default_rng(1))
    ahead = np.abs(scan.points_frd_m[:, 0] - 8.0) < 1e-4
    assert scan.points_frd_m[ahead, 2].max() == pytest.approx(1.0, abs=0.02)
    assert scan.points_frd_m[:, 2].max() <= 1.0 + 2e-6
    assert not np.any(scan.points_frd_m[:, 0] > 8.0 + 1e-4)


def test_a_bed_in_shallow_water_is_not_seen() -> None:
    bed = PlaneCaster((0.0, 0.0, 1.0), 0.05, ROCK)
    scan = EXACT.scan(moving(place_ned_m=METRE_UP), bed, water(0.0), np.random.default_rng(1))
    assert scan.fates.returned == scan.fates.from_water


@pytest.mark.medium
@pytest.mark.parametrize(
    "waves", [FlatWater(), sea(), realise_waves(WaveSpec("regular", 0.4, 2.0, 10.0), Water(), np.random.default_rng(3))]
)
@pytest.mark.parametrize("level_m", [-0.01, 2.5])
def test_nothing_is_ever_seen_under_water(waves: WaveField | FlatWater, level_m: float) -> None:
    """Of the true surface in double precision, at each point's own instant and place, with noise of 10 cm."""
    lidar = Lidar(LidarSpec(range_noise_m=0.1, position_frd_m=(1.0, 0.0, -0.7), spray_share=0.02, pitch_deg=-5.0))
    environment = Environment(water=Water(level_m=level_m), waves=waves)
    wall = PlaneCaster((0.8, 0.6, 0.0), 0.8 * 700.0 + 12.0, ROCK)
    from_water = 0
    for number in range(12):
        track = moving(
            number * 100_000_000,
            place_ned_m=(700.0 + 0.2 * number, 3.0, -level_m - 0.2),
            velocity_ned_mps=(2.0, 0.5, 0.1),
            turned_deg=(4.0, 3.0 - number, 0.0),
            turning_degps=(30.0, -20.0, 15.0),
        )
        seen = WaterSeen.around(environment, number * 0.1, track.pos_ned_m[0])
        scan = lidar.scan(track, wall, seen, np.random.default_rng(number))
        assert accounted(scan.fates)
        points = in_ned(scan, track)
        times = number * 0.1 + scan.offset_s.astype(float)
        surface = np.array(
            [
                environment.surface_ned_z_m(time_s, point[:2])
                for time_s, point in zip(times[::7], points[::7], strict=True)
            ]
        )
        # Single precision: 6e-5 m at 700 m north, 1e-4 of a wave's metre.
        assert np.max(points[::7, 2] - surface) < 5e-4
        from_water += scan.fates.from_water
    assert from_water > 1000


def test_waves_are_where_they_are() -> None:
    """Returns of water lie on the waves, not on the still level."""
    waves = sea(height_m=0.3)
    environment = Environment(water=Water(), waves=waves)
    track = moving(place_ned_m=METRE_UP, velocity_ned_mps=(1.0, 0.0, 0.0))
    scan = EXACT.scan(track, NOTHING, WaterSeen.around(environment, 0.0, np.zeros(3)), np.random.default_rng(1))
    points = in_ned(scan, track)
    surface = np.array(
        [
            environment.surface_ned_z_m(later_s, point[:2])
            for later_s, point in zip(scan.offset_s.astype(float), points, strict=True)
        ]
    )
    off = points[:, 2] - surface
    assert np.std(surface) > 0.03
    assert np.quantile(np.abs(off), 0.95) < 0.01
    assert off.max() < 5e-4


def test_crests_hide_what_is_low_behind_them() -> None:
    """A wall 40 m off is cut unevenly: less of its foot is seen through waves than over flat water."""
    wall = PlaneCaster((1.0, 0.0, 0.0), 40.0, ROCK)
    low = []
    for waves in (FlatWater(), sea()):
        environment = Environment(water=Water(), waves=waves)
        count = 0
        for number in range(6):
            track = moving(number * 100_000_000, place_ned_m=METRE_UP)
            seen = WaterSeen.around(environment, number * 0.1, track.pos_ned_m[0])
            scan = EXACT.scan(track, wall, seen, np.random.default_rng(1))
            down = scan.points_frd_m[:, 2] - 1.0
            count += np.count_nonzero((scan.points_frd_m[:, 0] > 39.9) & (down > -0.1) & (down < 0.0))
        low.append(count)
    assert low[1] < 0.8 * low[0]


def test_a_lidar_under_water_sees_nothing() -> None:
    wall = PlaneCaster((1.0, 0.0, 0.0), 10.0, ROCK)
    for waves in (FlatWater(), sea()):
        seen = WaterSeen.around(Environment(water=Water(), waves=waves), 0.0, np.zeros(3))
        scan = EXACT.scan(moving(place_ned_m=(0.0, 0.0, 1.0)), wall, seen, np.random.default_rng(1))
        assert scan.fates.returned == 0
        assert accounted(scan.fates)


def test_a_turn_over_puts_it_under_water_too() -> None:
    """A capsized vessel: rays that go up from below the surface."""
    turned = quat_to_matrix(euler_to_quat(np.radians([180.0, 20.0, 0.0])))
    assert turned[2, 2] < 0.0
    track = moving(place_ned_m=(0.0, 0.0, -0.1), turned_deg=(180.0, 20.0, 0.0))
    lidar = Lidar(LidarSpec(position_frd_m=(1.0, 0.0, -0.8)))
    wall = PlaneCaster((1.0, 0.0, 0.0), 10.0, ROCK)
    scan = lidar.scan(track, wall, water(0.0), np.random.default_rng(1))
    assert scan.fates.returned == 0
