"""The lidar in a run: frames without gaps, clouds after their latency, what is recorded is what is sent."""

from __future__ import annotations

from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from lidar_scenes import PlaneCaster, moving

from agent.companion.clouds import CloudReassembler, PointCloud
from sim_core.environment.environment import Environment
from sim_core.environment.spec import Water
from sim_core.sensors.lidar import Lidar
from sim_core.sensors.spec import LidarSpec
from sim_core.world.rays import NO_BODIES
from xitl_cli.errors import UserError
from xitl_cli.profile import load_profile
from xitl_cli.run.core.node import RunStep
from xitl_cli.run.sensors.lidar import LidarInstrument, make_lidar
from xitl_cli.seeds import Seeds

STEP_NS = 2_500_000
PLANT: Any = SimpleNamespace(
    simulation=SimpleNamespace(environment=Environment(water=Water(level_m=-1.5))), bodies=lambda: NO_BODIES
)


@dataclass
class Kept:
    clouds: list[tuple[int, np.ndarray, np.ndarray, np.ndarray]] = field(default_factory=list)

    def lidar_points(self, stamp_ns: int, points: np.ndarray, offset_s: np.ndarray, intensity: np.ndarray) -> None:
        self.clouds.append((stamp_ns, points, offset_s, intensity))


def run(steps: int, latency_s: float = 0.0) -> tuple[list[tuple[int, PointCloud]], Kept, LidarInstrument, PlaneCaster]:
    """Clouds as a companion gets them, with the instants."""
    caster = PlaneCaster((1.0, 0.0, 0.0), 40.0)
    instrument = LidarInstrument(
        Lidar(LidarSpec(position_frd_m=(0.0, 0.0, 0.0))),
        caster,
        PLANT,
        every=40,
        latency_ns=round(latency_s * 1e9),
        rng=np.random.default_rng(5),
    )
    kept, clouds, came = Kept(), CloudReassembler(), []
    instrument.begin(kept)
    track = moving(velocity_ned_mps=(2.0, 0.0, 0.0), turning_degps=(0.0, 0.0, 10.0), steps=steps)
    for step in range(1, steps + 1):
        motion: Any = SimpleNamespace(pos_ned_m=track.pos_ned_m[step, None], rot_ned_frd=track.rot_ned_frd[step, None])
        world: Any = SimpleNamespace(state=None)
        for message in instrument.update(RunStep(step, step * STEP_NS, world, motion)):
            came += [(step * STEP_NS, cloud) for cloud in clouds.handle(message)]
    instrument.close()
    return came, kept, instrument, caster


def test_a_cloud_a_frame_at_its_end() -> None:
    came, _, instrument, caster = run(200)
    assert [at_ns for at_ns, _ in came] == [200_000_000, 300_000_000, 400_000_000, 500_000_000]
    assert [cloud.stamp_ns for _, cloud in came] == [100_000_000, 200_000_000, 300_000_000, 400_000_000]
    assert [cloud.number for _, cloud in came] == [0, 1, 2, 3]
    report = instrument.report()
    assert report["frames"] == 4
    assert report["points"]["fired"] == 40_000 == sum(len(origin) for origin, _, _ in caster.asked)
    assert report["points"]["returned"] == sum(len(cloud.points_m) for _, cloud in came)


def test_the_rays_go_out_from_where_the_vessel_is_at_their_instants() -> None:
    _, _, _, caster = run(120)
    origin = np.concatenate([origin for origin, _, _ in caster.asked])
    np.testing.assert_allclose(origin[:, 0], 2.0 * (0.1 + np.arange(20_000) * 1e-5), atol=1e-6)


def test_what_is_kept_is_what_is_sent() -> None:
    came, kept, _, _ = run(200)
    for (_, cloud), (stamp_ns, points, offset_s, intensity) in zip(came, kept.clouds, strict=True):
        assert cloud.stamp_ns == stamp_ns
        np.testing.assert_allclose(cloud.points_m, points, atol=0.0051)  # half a centimetre of the wire
        np.testing.assert_allclose(cloud.offset_s, offset_s, atol=5.1e-6)
        np.testing.assert_array_equal(cloud.intensity, intensity)


@pytest.mark.parametrize("latency_s", [0.01, 0.25])
def test_clouds_wait_out_the_latency_and_keep_their_order(latency_s: float) -> None:
    came, _, _, _ = run(320, latency_s)
    assert [cloud.number for _, cloud in came] == list(range(len(came)))
    assert len(came) == (6 if latency_s < 0.1 else 4)
    for at_ns, cloud in came:
        assert at_ns - (cloud.stamp_ns + 100_000_000) == round(latency_s * 1e9)


def of_profile(*overrides: str) -> LidarInstrument:
    profile = load_profile("sitl-perception", overrides).runnable()
    scenery: Any = SimpleNamespace(caster=lambda: PlaneCaster((1.0, 0.0, 0.0), 40.0))
    return make_lidar(profile, Seeds(1), scenery, PLANT)


def test_it_is_as_the_profile_says() -> None:
    lidar = of_profile(
        "environment.visibility_m=200", "sensors.lidar.pitch_deg=-4", "environment.water_reflectivity=0.1"
    )
    assert lidar._lidar.air.visibility_m == 200.0
    assert (lidar._lidar.spec.pitch_deg, lidar._lidar.water_reflectivity) == (-4.0, 0.1)
    assert of_profile()._lidar.air.extinction_per_m == 0.0


def test_what_the_profile_cannot_mean_is_one_sentence() -> None:
    with pytest.raises(UserError, match=r"lidar\.min_range_m = 30 is not below max_range_m = 20"):
        of_profile("sensors.lidar.min_range_m=30", "sensors.lidar.max_range_m=20")
    with pytest.raises(UserError, match=r"sensors\.lidar\.rate_hz = 7 does not divide the physics rate 400 Hz"):
        of_profile("sensors.lidar.rate_hz=7")
