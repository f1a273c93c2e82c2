"""A vessel that is held until its autopilot arms looks like one at rest to every sensor."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.random import default_rng

from sim_core.geodesy import normal_gravity_mps2
from xitl_cli.profile import load_profile
from xitl_cli.record.topics import MotorCommand
from xitl_cli.run.core.node import ControlNode, RunStep, SimulationClock, VesselNodes
from xitl_cli.run.core.pace import Lockstep
from xitl_cli.run.core.reports import Ending, Progress
from xitl_cli.run.loop import Loop
from xitl_cli.run.sensors.sensing import make_sensing
from xitl_cli.run.world.plant import Plant
from xitl_cli.run.world.world import build_simulation
from xitl_cli.seeds import Seeds

HELD_S, FREE_S = 3.0, 1.0


class Watcher(ControlNode):
    """Waits for `HELD_S` and keeps what its sensors say."""

    def __init__(self, profile: Any, seeds: Seeds) -> None:
        self.command = MotorCommand((0.0, 0.0))
        self.progress = Progress("", waits_for="the test")
        self.motions: list[Any] = []
        self.accelerations: list[Any] = []
        self._sensing = make_sensing(profile, seeds)

    def sense(self, step: RunStep) -> None:
        if step.now_ns <= HELD_S * 1e9:
            self.motions.append(step.motion)
            for message in self._sensing.due(step.number, step.now_ns, step.motion, step.state.wind_ned_mps):
                if message.get_type() == "XITL_IMU":
                    self.accelerations.append(message.accel)

    def exchange(self, step: RunStep) -> None:
        self.progress = Progress("", waits_for="the test" if step.now_ns < HELD_S * 1e9 else "")


class Deaf:
    def __getattr__(self, name: str) -> Any:
        return lambda *arguments: None


@pytest.mark.medium
def test_it_does_not_move_turn_or_accelerate_in_waves_wind_and_current() -> None:
    profile = load_profile("sitl-ardupilot", [f"clock.duration_s={HELD_S + FREE_S}"]).runnable()
    seeds = Seeds(1)
    simulation, state = build_simulation(profile, seeds)
    watcher, pace = Watcher(profile, seeds), Lockstep()
    nobody: Any = Deaf()
    plant = Plant(simulation, state, default_rng(seeds.sequence("environment")))
    vessel = VesselNodes("", watcher, (watcher,))
    loop = Loop(profile.clock, plant, [vessel], pace, SimulationClock(pace), nobody, lambda: False)
    assert loop.run() is Ending.DURATION
    start = state.vessel.motion
    for motion in watcher.motions:
        assert np.array_equal(motion.pos_ned_m, start.pos_ned_m)
        for name in ("vel_ned_mps", "acc_ned_mps2", "gyro_frd_radps", "angular_acc_frd_radps2"):
            assert not np.any(getattr(motion, name)), name
    gravity = normal_gravity_mps2(profile.site.latitude_deg, profile.site.altitude_m)
    mean = np.mean(watcher.accelerations, axis=0)
    assert mean == pytest.approx([0.0, 0.0, -gravity], abs=0.2)  # the bias of the profile's unit
    # The duration counts from the start, the time for which it was held too.
    assert plant.vessels[0].held_steps == pytest.approx(HELD_S * profile.clock.physics_rate_hz, abs=2)
    assert plant.state.time_ns * 1e-9 == pytest.approx(HELD_S + FREE_S, abs=0.02)
    assert np.linalg.norm(plant.state.vessel.motion.vel_ned_mps) > 0.01
