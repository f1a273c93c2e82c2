"""A vessel that is held until its autopilot arms looks like one at rest to every sensor."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from sim_core.geodesy import normal_gravity_mps2
from sim_core.simulation import kinematics
from xitl_cli.profile import load_profile
from xitl_cli.record.topics import MotorCommand
from xitl_cli.run.loop import Ending, Loop
from xitl_cli.run.nodes.score import MissionScore
from xitl_cli.run.pace import Lockstep
from xitl_cli.run.pilot import Progress
from xitl_cli.run.seeds import Seeds
from xitl_cli.run.sensors.sensing import sensing_of
from xitl_cli.run.view import NoView
from xitl_cli.run.world.world import build

HELD_S, FREE_S = 3.0, 1.0


class Watcher:
    """A pilot that waits for `HELD_S` and keeps what its sensors say."""

    def __init__(self, profile: Any, seeds: Seeds) -> None:
        self.command = MotorCommand((0.0, 0.0))
        self.estimation = None
        self.stale_exchanges = 0
        self.motions: list[Any] = []
        self.accelerations: list[Any] = []
        self._sensing = sensing_of(profile, seeds)
        self._now_ns = 0
        self._step = 0

    def sense(self, sim_ns: int, motion: Any, air_ned_mps: Any) -> None:
        self._now_ns = sim_ns
        self._step += 1
        if sim_ns <= HELD_S * 1e9:
            self.motions.append(motion)
            for message in self._sensing.due(self._step, sim_ns, motion, air_ned_mps):
                if message.get_type() == "XITL_IMU":
                    self.accelerations.append(message.accel)

    def progress(self) -> Progress:
        return Progress("", waits_for="the test" if self._now_ns < HELD_S * 1e9 else "")

    def __getattr__(self, name: str) -> Any:
        return lambda *arguments: []


class Deaf:
    def __getattr__(self, name: str) -> Any:
        return lambda *arguments: None


def test_it_does_not_move_turn_or_accelerate_in_waves_wind_and_current() -> None:
    profile = load_profile("sitl-ardupilot", [f"clock.duration_s={FREE_S}"]).runnable()
    seeds = Seeds(1)
    simulation, state = build(profile, seeds)
    pilot: Any = Watcher(profile, seeds)
    nobody: Any = Deaf()
    score = MissionScore(profile.mission.waypoints_ned_m)
    loop = Loop(profile, simulation, state, pilot, Lockstep(), nobody, NoView(), score, lambda: False)
    assert loop.run(seeds) is Ending.DURATION
    start = kinematics(simulation, state)
    for motion in pilot.motions:
        assert np.array_equal(motion.pos_ned_m, start.pos_ned_m)
        for name in ("vel_ned_mps", "acc_ned_mps2", "gyro_frd_radps", "angular_acc_frd_radps2"):
            assert not np.any(getattr(motion, name)), name
    gravity = normal_gravity_mps2(profile.site.latitude_deg, profile.site.altitude_m)
    mean = np.mean(pilot.accelerations, axis=0)
    assert mean == pytest.approx([0.0, 0.0, -gravity], abs=0.2)  # the bias of the profile's unit
    # The time for which it was held does not count.
    assert loop.moored_steps == pytest.approx(HELD_S * profile.clock.physics_rate_hz, abs=2)
    assert loop.state.time_ns * 1e-9 == pytest.approx(HELD_S + FREE_S, abs=0.02)
    assert np.linalg.norm(kinematics(simulation, loop.state).vel_ned_mps) > 0.01
