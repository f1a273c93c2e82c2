"""Records the tide, and moves the drawn water with it."""

from __future__ import annotations

from collections.abc import Sequence

from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.topics import TideState
from xitl_cli.run.core.node import RunContext, RunNode, RunStep
from xitl_cli.run.world.plant import Plant
from xitl_cli.run.world.scene import make_water_scene

RATE_HZ = 1.0
DRAWN_STEP_M = 0.02
"""Change of the level after which the water is drawn again."""


class TideNode(RunNode):
    """Records the tide at 1 Hz. profiles: one for each vessel."""

    def __init__(self, profiles: Sequence[RunProfile], plant: Plant) -> None:
        self._profiles, self._plant = profiles, plant
        self._every = max(round(profiles[0].clock.physics_rate_hz / RATE_HZ), 1)
        self._drawn_m = 0.0

    def begin(self, context: RunContext) -> None:
        self._recorder = context.recorder
        self._record(0)

    def record(self, step: RunStep) -> None:
        if step.number % self._every == 0:
            self._record(step.now_ns)

    def _record(self, now_ns: int) -> None:
        environment, time_s = self._plant.simulation.environment, now_ns * 1e-9
        tide = environment.tide
        height_m = tide.height_m(time_s)
        level_m = environment.level_m(time_s)
        self._recorder.write(now_ns, TideState(level_m, height_m, tide.rise_mps(time_s), tide.stream_mps(time_s)))
        if self._profiles[0].recording.scene and abs(height_m - self._drawn_m) >= DRAWN_STEP_M:
            self._drawn_m = height_m
            self._recorder.scene(make_water_scene(self._profiles, height_m), now_ns)
