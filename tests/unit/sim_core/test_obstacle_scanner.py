"""The scan against plane geometry: each sector has the nearest of its rays."""

from __future__ import annotations

import math

import numpy as np
from motion import at_rest

from sim_core.sensors.rangefinder import SECTORS, ObstacleScanner
from sim_core.sensors.spec import ObstacleScannerSpec
from sim_core.world.plan import Wall, Walls, line_walls

RNG = np.random.default_rng(1)


def scan(scanner: ObstacleScanner, **motion: object) -> np.ndarray:
    return scanner.measure(scanner.initial(1, RNG), at_rest(**motion), RNG)[1].range_m[0]  # type: ignore[arg-type]


def test_a_long_boom_to_starboard_is_nearest_abeam() -> None:
    """In the sector about 90 degrees it is 7.6 m off, in one about a the nearest ray is 2 degrees nearer to abeam."""
    walls = Walls.joined(line_walls([(-500.0, 8.0, 0.0), (500.0, 8.0, 0.0)], 0.4))
    ranges = scan(ObstacleScanner(ObstacleScannerSpec(), walls=walls))
    assert len(ranges) == SECTORS
    for sector in range(SECTORS):
        to_abeam = abs(sector * 5.0 - 90.0)
        if to_abeam > 85.0:  # along the boom or away from it
            continue
        expected = 7.6 / math.cos(math.radians(max(to_abeam - 2.0, 0.0)))
        np.testing.assert_allclose(ranges[sector], expected, err_msg=f"sector {sector}")
    assert np.isinf(ranges[40:70]).all()


def test_it_turns_with_the_bow_and_starts_where_it_is_mounted() -> None:
    walls = Walls.joined([Wall((30.0, -100.0), (30.0, 100.0), -1.0, 1.0)])
    scanner = ObstacleScanner(ObstacleScannerSpec(position_frd_m=(1.0, 0.0, -1.5)), walls=walls)
    np.testing.assert_allclose(scan(scanner)[0], 29.0)
    ranges = scan(scanner, euler_rad=(0.0, 0.0, math.radians(90.0)))
    np.testing.assert_allclose(ranges[54], 30.0)  # 270 degrees from the bow
    assert np.isinf(ranges[18])


def test_noise_never_makes_a_range_negative() -> None:
    walls = Walls.joined([Wall((0.1, -100.0), (0.1, 100.0), -1.0, 1.0)])
    assert scan(ObstacleScanner(ObstacleScannerSpec(noise_m=1.0), walls=walls)).min() >= 0.0
