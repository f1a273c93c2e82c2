"""What comes back, against the maker's figures, Beer and Lambert, Koschmieder and Fresnel."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from lidar_scenes import PlaneCaster, SquareOn, accounted, moving, water

from sim_core.sensors.lidar import Lidar, LidarScan, PointFates
from sim_core.sensors.optics import Atmosphere, extinction_per_m, through_surface
from sim_core.sensors.spec import LidarSpec
from sim_core.world.geometry import BED, CONCRETE, MATERIALS, STEEL, WALL, Material

TENTH = BED  # a material of 10 %


def looked(lidar: Lidar, caster: PlaneCaster, seed: int = 1) -> LidarScan:
    scan = lidar.scan(moving(), caster, water(), np.random.default_rng(seed))
    assert accounted(scan.fates)
    return scan


def share(lidar: Lidar, range_m: float, material: Material) -> float:
    fates = looked(lidar, SquareOn(range_m, material)).fates
    return fates.returned / fates.fired


def test_the_dark_target_is_seen_as_far_as_the_maker_says() -> None:
    assert TENTH.reflectivity == 0.1
    assert (
        share(Lidar(LidarSpec(position_frd_m=(0.0, 0.0, 0.0))), 80.0, TENTH) > 0.97
    )  # 12 % nearer is 24 % more light, 2.4 of its deviations
    assert share(Lidar(LidarSpec(position_frd_m=(0.0, 0.0, 0.0))), 90.0, TENTH) == pytest.approx(
        0.5, abs=4 * 0.5 / 100
    )  # half by chance, 4 sigma
    assert share(Lidar(LidarSpec(position_frd_m=(0.0, 0.0, 0.0))), 101.0, TENTH) < 0.03


@pytest.mark.parametrize(("reflectivity", "maker_m"), [(0.2, 130.0), (0.8, 260.0)])
def test_other_reflectivities_go_by_the_root(reflectivity: float, maker_m: float) -> None:
    """The maker rounds: 90 m sqrt(2) = 127 m, 90 m sqrt(8) = 255 m, both within 2.5 % of the figures."""
    farthest_m = 90.0 * math.sqrt(reflectivity / 0.1)
    assert farthest_m == pytest.approx(maker_m, rel=0.025)
    material = min(MATERIALS, key=lambda one: abs(one.reflectivity - reflectivity))
    own_m = 90.0 * math.sqrt(material.reflectivity / 0.1)
    assert share(Lidar(LidarSpec(max_range_m=300.0, position_frd_m=(0.0, 0.0, 0.0))), own_m, material) == pytest.approx(
        0.5, abs=0.02
    )


def test_what_is_aslant_is_seen_less_far() -> None:
    """A wall along the way: at 60 degrees of incidence half the light, so 1/sqrt(2) of the range."""
    slanted = PlaneCaster(
        (0.5, math.sqrt(0.75), 0.0), 0.5 * 90.0 * math.sqrt(CONCRETE.reflectivity / 0.1 * 0.5), CONCRETE
    )
    scan = looked(Lidar(LidarSpec(range_noise_m=0.0, position_frd_m=(0.0, 0.0, 0.0))), slanted)
    looking = scan.points_frd_m / np.linalg.norm(scan.points_frd_m, axis=1, keepdims=True)
    _, direction, _ = slanted.asked[0]
    ahead = np.flatnonzero(direction @ [1.0, 0.0, 0.0] > math.cos(math.radians(2.0)))
    seen = np.count_nonzero(looking[:, 0] > math.cos(math.radians(2.0)))
    # Over 2 degrees both ways the light goes from 0.8 to 1.25 of just enough, evenly: about half is seen.
    assert seen / len(ahead) == pytest.approx(0.5, abs=0.1)


def test_nothing_from_beyond_the_longest_range_and_from_the_blind_zone() -> None:
    assert share(Lidar(LidarSpec(max_range_m=100.0, position_frd_m=(0.0, 0.0, 0.0))), 101.0, WALL) == 0.0
    assert share(Lidar(LidarSpec(max_range_m=100.0, position_frd_m=(0.0, 0.0, 0.0))), 99.0, WALL) == 1.0
    assert looked(
        Lidar(LidarSpec(min_range_m=0.5, position_frd_m=(0.0, 0.0, 0.0))), SquareOn(0.49, WALL)
    ).fates == PointFates(fired=10_000, near=10_000)
    assert share(Lidar(LidarSpec(min_range_m=0.5, position_frd_m=(0.0, 0.0, 0.0))), 0.6, WALL) == 1.0


def test_noise_brings_nothing_into_the_blind_zone() -> None:
    """Of what is at its edge, half is measured nearer than the device knows."""
    scan = looked(Lidar(LidarSpec(position_frd_m=(0.0, 0.0, 0.0))), SquareOn(0.05, WALL))
    assert np.linalg.norm(scan.points_frd_m, axis=1).min() >= 0.05 - 1e-6
    assert scan.fates.returned == pytest.approx(0.5 * scan.fates.fired, rel=0.05)  # 5 deviations of 10 000 draws


def test_intensity_is_reflectivity_in_the_makers_scale() -> None:
    """150 for a diffuse target of 100 %, whatever the range; the flicker of 10 % averages out to 0.5 % of itself."""
    for range_m in (5.0, 50.0):
        for material in (BED, CONCRETE, WALL):
            scan = looked(Lidar(LidarSpec(position_frd_m=(0.0, 0.0, 0.0))), SquareOn(range_m, material))
            assert scan.intensity.mean() == pytest.approx(150.0 * material.reflectivity, rel=0.01, abs=0.1)


def test_returns_are_lost_at_random() -> None:
    fates = looked(Lidar(LidarSpec(drop_share=0.3, position_frd_m=(0.0, 0.0, 0.0))), SquareOn(30.0, WALL)).fates
    assert fates.dropped == pytest.approx(3000, abs=4 * math.sqrt(10_000 * 0.3 * 0.7))
    assert fates.returned == 10_000 - fates.dropped


def test_spray_hides_what_is_behind() -> None:
    scan = looked(Lidar(LidarSpec(spray_share=0.2, position_frd_m=(0.0, 0.0, 0.0))), SquareOn(30.0, WALL))
    nearer = np.linalg.norm(scan.points_frd_m, axis=1) < 29.0
    assert np.count_nonzero(nearer) == scan.fates.from_spray
    # Droplets lie exponentially about 1.5 m off; some within the blind zone of 5 cm.
    expected = 10_000 * 0.2 * math.exp(-0.05 / 1.5)
    assert scan.fates.from_spray == pytest.approx(expected, abs=4 * math.sqrt(1600))
    assert np.linalg.norm(scan.points_frd_m[nearer], axis=1).mean() == pytest.approx(1.55, abs=4 * 1.5 / 44)


@pytest.mark.parametrize("visibility_m", [30.0, 100.0, 400.0])
def test_fog_takes_light_both_ways(visibility_m: float) -> None:
    """In fog all wavelengths fare alike: at the visibility 2 % are left one way (Koschmieder)."""
    extinction = extinction_per_m(visibility_m)
    assert math.exp(-extinction * visibility_m) == pytest.approx(0.02, rel=2e-3)

    def light(range_m: float) -> float:
        return TENTH.reflectivity / 0.1 * (90.0 / range_m) ** 2 * math.exp(-2.0 * extinction * range_m)

    low_m, high_m = 1.0, 90.0
    for _ in range(60):
        middle_m = 0.5 * (low_m + high_m)
        low_m, high_m = (middle_m, high_m) if light(middle_m) > 1.0 else (low_m, middle_m)
    fates = looked(
        Lidar(LidarSpec(position_frd_m=(0.0, 0.0, 0.0)), air=Atmosphere(visibility_m)), SquareOn(low_m, TENTH)
    ).fates
    behind = fates.fired - fates.from_fog
    assert (fates.returned - fates.from_fog) / behind == pytest.approx(0.5, abs=0.025)


def test_haze_lets_red_pass_better_than_green_does() -> None:
    """Kim 2001: q = 1.3 at 20 km, 0.5 at 1 km, 0 below 500 m; and it falls without a jump that matters."""
    assert extinction_per_m(20_000.0) == pytest.approx(3.912 / 20_000.0 * (905.0 / 550.0) ** -1.3)
    assert extinction_per_m(1_000.0) == pytest.approx(3.912 / 1_000.0 * (905.0 / 550.0) ** -0.5)
    assert extinction_per_m(499.0) == 3.912 / 499.0
    assert extinction_per_m(math.inf) == 0.0
    values = [extinction_per_m(visibility_m) for visibility_m in np.geomspace(20.0, 1e5, 200)]
    assert all(later < earlier for earlier, later in pairwise(values))


def test_fog_returns_light_itself_the_denser_the_more() -> None:
    counts = [
        looked(
            Lidar(LidarSpec(position_frd_m=(0.0, 0.0, 0.0)), air=Atmosphere(visibility_m)), SquareOn(40.0, STEEL)
        ).fates.from_fog
        for visibility_m in (800, 200, 50)
    ]
    assert counts[0] < counts[1] < counts[2]
    assert looked(Lidar(LidarSpec(position_frd_m=(0.0, 0.0, 0.0))), SquareOn(40.0, STEEL)).fates.from_fog == 0
    scan = looked(Lidar(LidarSpec(position_frd_m=(0.0, 0.0, 0.0)), air=Atmosphere(50.0)), SquareOn(25.0, STEEL))
    range_m = np.linalg.norm(scan.points_frd_m, axis=1)
    assert np.count_nonzero(range_m < 24.0) == scan.fates.from_fog
    # As of a diffuse target of pi beta dR, beta = extinction / 18 sr: 1 % at 50 m, which is seen to 13 m.
    assert range_m[range_m < 24.0].max() < 15.0


def test_the_surface_lets_pass_what_fresnel_says() -> None:
    """With angles, as textbooks have it: R = (sin^2(i - t) / sin^2(i + t) + tan^2(i - t) / tan^2(i + t)) / 2."""
    angle = np.radians([1.0, 20.0, 45.0, 53.0, 70.0, 80.0, 85.0, 89.0])
    refracted = np.arcsin(np.sin(angle) / 1.328)
    less, more = angle - refracted, angle + refracted
    reflected = 0.5 * (np.sin(less) ** 2 / np.sin(more) ** 2 + np.tan(less) ** 2 / np.tan(more) ** 2)
    np.testing.assert_allclose(through_surface(np.cos(angle).astype(np.float32)), 1.0 - reflected, atol=2e-5)
    assert through_surface(np.ones(1, np.float32))[0] == pytest.approx(1.0 - (0.328 / 2.328) ** 2, abs=1e-6)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"range_noise_m": -0.1}, r"LidarSpec\.range_noise_m = -0\.1 is too small"),
        ({"min_range_m": 30.0, "max_range_m": 20.0}, r"min_range_m = 30 is not below max_range_m"),
        ({"position_frd_m": (0.0, math.nan, 0.0)}, r"LidarSpec\.position_frd_m"),
        ({"drop_share": 1.5}, r"LidarSpec\.drop_share = 1\.5 is too large"),
    ],
)
def test_what_cannot_be_is_refused(wrong: dict[str, object], said: str) -> None:
    with pytest.raises(ValueError, match=said):
        Lidar(LidarSpec(**wrong))


def test_visibility_cannot_be_nothing() -> None:
    with pytest.raises(ValueError, match=r"environment\.visibility_m = 0\.0 must be above zero"):
        Atmosphere(0.0)
