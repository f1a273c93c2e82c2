"""Episodes of a batch of vessels: observations, rewards, ends and restarts, without Gymnasium."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.frames import Array, Array32
from xitl_cli.errors import UserError
from xitl_cli.plugins.learning.batch import DrawGoals, DrawStarts, VesselBatch
from xitl_cli.plugins.learning.observation import Feature, Observation
from xitl_cli.plugins.learning.top_view import TopView
from xitl_cli.plugins.learning.vessels import Vessels
from xitl_cli.profile.schema import RunProfile

Flags = NDArray[np.bool_]
Reward = Callable[[Vessels, Array, Vessels], Array]
"""Returns the rewards (N,) of a step, from the vessels before it, the action (N, C) and the vessels after it."""
Terminated = Callable[[Vessels], Array]
"""Returns for which vessels the episode has ended, (N,) bool."""
RENDER_MODES = ("rgb_array",)


@dataclass(frozen=True, slots=True)
class Task:
    """What a vessel has to learn."""

    observe: Sequence[str | Feature]
    reward: Reward
    terminated: Terminated | None
    episode_s: float
    control_rate_hz: float | None
    start: DrawStarts | None
    goal: DrawGoals | None
    render_mode: str | None


class Episodes:
    """N vessels of a profile at one task.

    observation: its parts and limits. commands: number of actuators. render_fps: control rate.
    """

    def __init__(self, profile: RunProfile, count: int, task: Task, threads: int = 1) -> None:
        """Raises UserError for a task that the profile does not allow."""
        if task.render_mode is not None and task.render_mode not in RENDER_MODES:
            raise UserError(f"render_mode = {task.render_mode!r} is unknown; use 'rgb_array' or None")
        rate_hz = task.control_rate_hz or profile.clock.exchange_rate_hz
        steps = round(task.episode_s * rate_hz)
        if steps < 1:
            raise UserError(f"episode_s = {task.episode_s:g} must be at least one control step, {1.0 / rate_hz:g} s")
        self.observation = Observation(task.observe)
        self.render_fps = rate_hz
        self._task = task
        self._longest_s = (steps - 0.5) / rate_hz
        self._batch = VesselBatch(profile, count, rate_hz, task.start, task.goal, self.observation.sensors, threads)
        self._batch.begin(0)
        self._vessels = self._batch.vessels()
        self._track = TopView(self._batch.outline) if task.render_mode is not None else None
        self.observation.measure(self._vessels)

    @property
    def commands(self) -> int:
        """Number of actuators."""
        return self._batch.commands

    @property
    def vessels(self) -> Vessels:
        """The vessels now."""
        return self._vessels

    def begin(self, seed: int) -> None:
        """Begin an episode of each vessel in a new sea."""
        self._batch.begin(seed)
        self._moved(np.ones(self._batch.count, dtype=np.bool_))

    def restart(self, rows: Flags) -> None:
        """Begin new episodes of the flagged vessels (N,) in the same sea."""
        if rows.any():
            self._batch.restart(np.flatnonzero(rows))
            self._moved(rows)

    def step(self, action: NDArray[np.floating]) -> tuple[Array, Flags, Flags]:
        """Take a step with actions (N, C). Return the rewards, and which episodes were terminated or truncated.

        Raises ValueError for actions of another shape or not finite, and for a reward or end of another shape.
        """
        count = self._batch.count
        command = np.asarray(action, dtype=np.float64)
        if command.shape != (count, self.commands):
            raise ValueError(f"the action has the shape {command.shape}; give {(count, self.commands)}")
        if not np.isfinite(command).all():
            raise ValueError("the action has numbers that are not finite; limit the policy's output to [-1, 1]")
        command = np.clip(command, -1.0, 1.0)
        before = self._vessels
        self._batch.advance(command)
        self._moved(None)
        after = self._vessels
        rewards = _per_vessel("reward", self._task.reward(before, command, after), count)
        terminated = np.zeros(count, dtype=np.bool_)
        if self._task.terminated is not None:
            terminated = _per_vessel("terminated", self._task.terminated(after), count).astype(np.bool_)
        return rewards.astype(np.float64), terminated, after.time_s > self._longest_s

    def observe(self) -> Array32:
        """Return the observations now, (N, K)."""
        return self.observation.read(self._vessels)

    def picture(self, row: int) -> NDArray[np.uint8] | None:
        """Return the track of one vessel as RGB, (H, W, 3), None without a render mode."""
        return None if self._track is None else self._track.picture(self._vessels, row)

    def close(self) -> None:
        """End the threads."""
        self._batch.close()

    def _moved(self, began: Flags | None) -> None:
        self._vessels = self._batch.vessels()
        if self._track is not None:
            self._track.add(self._vessels, began)


def _per_vessel(name: str, values: Array, count: int) -> Array:
    checked = np.asarray(values)
    if checked.shape != (count,):
        raise ValueError(f"{name} returned the shape {checked.shape}; return one value per vessel, ({count},)")
    return checked
