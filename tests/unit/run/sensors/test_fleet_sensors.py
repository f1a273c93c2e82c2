"""Sensors that a fleet measures together give each vessel the samples that it would get alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from agent.wire.codec import prepare
from xitl_cli.profile import load_profile
from xitl_cli.run.sensors.sensing import DRAWN_AHEAD, FleetNormals, SensorSuite, make_sensing
from xitl_cli.run.world.plant import Plant
from xitl_cli.run.world.world import build_plant
from xitl_cli.scenery import Scenery
from xitl_cli.seeds import Seeds

FLEET = """
extends: [sitl]
vessels:
  first: {mission: {start: {north_m: 0, east_m: 0}, waypoints_ned_m: [[50, 0]]}}
  other: {extends: vehicles/otter, mission: {start: {north_m: 0, east_m: -12}, waypoints_ned_m: [[50, -12]]}}
  faulty:
    mission: {start: {north_m: 0, east_m: -24}, waypoints_ned_m: [[50, -24]]}
    faults: {stuck: {from_s: 0.1, until_s: 0.3, imu: {gyro_bias_frd_radps: [0, 0, 0.1]}, barometer: {freeze: true}}}
  quick:
    sensors: {imu: {rate_hz: 400}, magnetometer: {latency_s: 0.02}}
    mission: {start: {north_m: 0, east_m: -36}, waypoints_ned_m: [[50, -36]]}
"""
STEPS = 3 * DRAWN_AHEAD


def sent(suite: SensorSuite, plant: Plant, number: int, step: int) -> list[tuple[str, bytes]]:
    view = plant.vessels[number]
    messages = suite.due(step, plant.state.time_ns, view.motion(), view.state.wind_ned_mps)
    return [(message.get_type(), prepare(message)[1]) for message in messages]


@pytest.mark.medium
def test_each_vessel_gets_the_samples_that_it_would_get_alone(tmp_path: Path) -> None:
    path = tmp_path / "fleet.yaml"
    path.write_text(FLEET)
    profiles = load_profile(str(path)).run_profiles()
    plant = build_plant(profiles, Seeds(1), Scenery(profiles[0]))
    seeds = [Seeds(profile.clock.seed, profile.vessel) for profile in profiles]
    pairs = list(zip(profiles, seeds, plant.vessels, strict=True))
    together = [make_sensing(profile, own, plant=view) for profile, own, view in pairs]
    alone = [make_sensing(profile, own) for profile, own, _ in pairs]
    kinds: set[str] = set()
    for step in range(1, STEPS + 1):
        plant.advance([(0.5, 0.2)] * len(pairs))
        for number in range(len(pairs)):
            samples = sent(together[number], plant, number, step)
            assert samples == sent(alone[number], plant, number, step)
            kinds |= {kind for kind, _ in samples}
    assert kinds >= {"XITL_IMU", "XITL_MAGNETOMETER", "XITL_BAROMETER"}


@pytest.mark.parametrize("numbers", [2, 12])
def test_each_generator_gives_the_numbers_of_separate_calls(numbers: int) -> None:
    normals = FleetNormals([np.random.default_rng(seed) for seed in (1, 2, 3)])
    apart = [np.random.default_rng(seed) for seed in (1, 2, 3)]
    for _ in range(2 * DRAWN_AHEAD + 1):
        expected = np.concatenate([generator.standard_normal((1, numbers)) for generator in apart])
        np.testing.assert_array_equal(normals.standard_normal((3, numbers)), expected)
