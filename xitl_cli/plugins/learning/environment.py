"""The environments with Gymnasium's interface."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box, Space
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy import float32
from numpy.typing import NDArray

from sim_core.frames import Array, Array32
from xitl_cli.plugins.learning.episodes import RENDER_MODES, Episodes, Flags, Task
from xitl_cli.plugins.learning.top_view import Picture
from xitl_cli.plugins.learning.vessels import Vessels
from xitl_cli.profile.schema import RunProfile

Information = dict[str, Any]
SEEDS = 2**63
RESET_MASK = "reset_mask"


class VesselEnv(gymnasium.Env[Array32, Array32]):
    """One vessel. Rewards and ends are computed by the same functions as for many vessels, with N = 1."""

    def __init__(self, profile: RunProfile, task: Task) -> None:
        self._episodes = Episodes(profile, 1, task)
        self.metadata = {"render_modes": [*RENDER_MODES], "render_fps": round(self._episodes.render_fps)}
        self.render_mode = task.render_mode
        self.observation_space, self.action_space = _spaces(self._episodes)

    @property
    def vessels(self) -> Vessels:
        """The vessel now, as arrays with N = 1."""
        return self._episodes.vessels

    def reset(self, *, seed: int | None = None, options: Information | None = None) -> tuple[Array32, Information]:
        """Begin an episode in a new sea. A seed repeats everything after it, bit for bit."""
        super().reset(seed=seed)
        self._episodes.begin(int(self.np_random.integers(SEEDS)))
        return self._episodes.observe()[0], {}

    def step(self, action: Array32) -> tuple[Array32, float, bool, bool, Information]:
        """Take a step with commands (C,) in [-1, 1] of the actuators. Raises ValueError for other shapes."""
        rewards, terminated, truncated = self._episodes.step(np.asarray(action)[None])
        return self._episodes.observe()[0], float(rewards[0]), bool(terminated[0]), bool(truncated[0]), {}

    def render(self) -> Picture | None:
        """Return the track from above, (H, W, 3), None without a render mode."""
        return self._episodes.picture(0)

    def close(self) -> None:
        """Nothing is kept open."""
        self._episodes.close()


class VesselVectorEnv(VectorEnv[Array32, Array32, Array]):
    """N vessels in one sea, which take their steps together."""

    def __init__(self, profile: RunProfile, count: int, task: Task, autoreset: AutoresetMode, threads: int) -> None:
        self._episodes = Episodes(profile, count, task, threads)
        self._autoreset = autoreset
        self._ended: Flags = np.zeros(count, dtype=np.bool_)
        self.num_envs = count
        self.metadata = {
            "render_modes": [*RENDER_MODES],
            "render_fps": round(self._episodes.render_fps),
            "autoreset_mode": autoreset,
        }
        self.render_mode = task.render_mode
        self.single_observation_space, self.single_action_space = _spaces(self._episodes)
        self.observation_space = batch_space(self.single_observation_space, count)
        self.action_space = batch_space(self.single_action_space, count)

    @property
    def vessels(self) -> Vessels:
        """The vessels now."""
        return self._episodes.vessels

    def reset(self, *, seed: int | None = None, options: Information | None = None) -> tuple[Array32, Information]:
        """Begin an episode of each vessel in a new sea. A seed repeats everything after it, bit for bit.

        options: `{"reset_mask": (N,) bool}` begins new episodes of some vessels in the same sea. Raises ValueError for
        another mask, and for a mask with a seed.
        """
        if options is not None and RESET_MASK in options:
            self._restart(options[RESET_MASK], seed)
        else:
            super().reset(seed=seed)
            self._episodes.begin(int(self.np_random.integers(SEEDS)))
            self._ended = np.zeros(self.num_envs, dtype=np.bool_)
        return self._episodes.observe(), {}

    def step(self, actions: Array32) -> tuple[Array32, Array, Flags, Flags, Information]:  # type: ignore[override]
        """Take a step with commands (N, C) in [-1, 1]. Raises ValueError for other shapes.

        Ended episodes begin again as `metadata["autoreset_mode"]` says.
        """
        if self._autoreset is AutoresetMode.DISABLED and self._ended.any():
            rows = ", ".join(map(str, np.flatnonzero(self._ended)[:8].tolist()))
            raise ValueError(f"the episodes of {rows} have ended; call reset(options={{'{RESET_MASK}': ...}}) first")
        rewards, terminated, truncated = self._episodes.step(actions)
        information: Information = {}
        if self._autoreset is AutoresetMode.NEXT_STEP:
            # This step only restarts the vessels whose episode ended in the last step
            restarts = self._ended
            rewards[restarts], terminated[restarts], truncated[restarts] = 0.0, False, False
            self._episodes.restart(restarts)
        self._ended = terminated | truncated
        if self._autoreset is AutoresetMode.SAME_STEP and self._ended.any():
            information = self._last(self._ended)
            self._episodes.restart(self._ended)
            self._ended = np.zeros(self.num_envs, dtype=np.bool_)
        return self._episodes.observe(), rewards, terminated, truncated, information

    def render(self) -> tuple[Picture, ...] | None:
        """Return the track of each vessel from above, None without a render mode."""
        pictures = [self._episodes.picture(row) for row in range(self.num_envs if self.render_mode else 0)]
        return tuple(picture for picture in pictures if picture is not None) if self.render_mode else None

    def close_extras(self, **kwargs: Any) -> None:
        """End the threads."""
        self._episodes.close()

    def _last(self, ended: Flags) -> Information:
        """Return the last observations of ended episodes, as Gymnasium's vector environments do."""
        observations: NDArray[np.object_] = np.full(self.num_envs, None, dtype=object)
        last = self._episodes.observe()
        for row in np.flatnonzero(ended).tolist():
            observations[row] = last[row].copy()
        return {"final_obs": observations, "_final_obs": ended.copy(), "final_info": {}, "_final_info": ended.copy()}

    def _restart(self, mask: object, seed: int | None) -> None:
        if not (isinstance(mask, np.ndarray) and mask.dtype == np.bool_ and mask.shape == (self.num_envs,)):
            raise ValueError(f"options[{RESET_MASK!r}] must be an array of bool with the shape ({self.num_envs},)")
        if seed is not None:
            raise ValueError(f"options[{RESET_MASK!r}] keeps the sea and its random streams; give no seed")
        self._episodes.restart(mask)
        self._ended = self._ended & ~mask


def _spaces(episodes: Episodes) -> tuple[Space[Any], Space[Any]]:
    """Return the spaces of one vessel."""
    low, high = episodes.observation.low, episodes.observation.high
    return Box(low, high, dtype=float32), Box(-1.0, 1.0, (episodes.commands,), dtype=float32)
