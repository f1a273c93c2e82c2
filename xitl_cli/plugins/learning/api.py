"""`xitl.make_env` and `xitl.make_vec_env` of the public Python API."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike
from typing import TYPE_CHECKING, Literal

from xitl_cli.api import Overrides, load_profile
from xitl_cli.errors import UserError
from xitl_cli.extras import GYM
from xitl_cli.plugins.learning.vessels import Vessels
from xitl_cli.profile import Profile

if TYPE_CHECKING:
    from xitl_cli.plugins.learning.batch import DrawGoals, DrawStarts
    from xitl_cli.plugins.learning.environment import VesselEnv, VesselVectorEnv
    from xitl_cli.plugins.learning.episodes import Reward, Terminated
    from xitl_cli.plugins.learning.observation import Feature
    from xitl_cli.profile.schema import RunProfile

__all__ = ["Vessels", "make_env", "make_vec_env"]

PathText = str | PathLike[str]
OBSERVED = ("velocity", "attitude", "rates", "actuators")


def make_env(
    profile: PathText | Profile,
    *,
    reward: Reward,
    terminated: Terminated | None = None,
    observe: Sequence[str | Feature] = OBSERVED,
    goal: DrawGoals | None = None,
    start: DrawStarts | None = None,
    episode_s: float = 60.0,
    control_rate_hz: float | None = None,
    overrides: Overrides = (),
    render_mode: str | None = None,
) -> VesselEnv:
    """Return the vessel of a profile as a `gymnasium.Env` (needs the extra `gym`). docs/learning.md has examples.

    profile: a name, a path, or a Profile from `load_profile`, with one vessel. reward: function of the vessels before
    the step, the action (N, C) and the vessels after it (`Vessels`, action, `Vessels`), which returns (N,); here, N is
    1. terminated: function of `Vessels` that returns for which vessels the episode ends, (N,) bool; by default, no
    episode ends before its time. observe: parts of the observation, by name or as functions of `Vessels` that return
    (N, K) numbers. goal: function of a numpy Generator and a number K that returns the goals (K, G) of K episodes.
    start: function of the same arguments that returns positions (K, 2), north and east in m, and headings (K,) in rad;
    by default the mission's start. episode_s: time after which an episode is truncated. control_rate_hz: rate of
    actions, which divides `clock.physics_rate_hz`; by default `clock.exchange_rate_hz`. overrides: as for
    `load_profile`. render_mode: `"rgb_array"` draws the track from above.

    An action has a command in [-1, 1] for each actuator of the vessel, in the order of the profile. No autopilot runs.
    Raises UserError without the extra, for errors in the profile, for a profile with faults or debris, and for an
    unknown part of the observation.
    """
    GYM.require("an environment needs")
    from xitl_cli.plugins.learning.environment import VesselEnv
    from xitl_cli.plugins.learning.episodes import Task

    task = Task(observe, reward, terminated, episode_s, control_rate_hz, start, goal, render_mode)
    return VesselEnv(_runnable(profile, overrides), task)


def make_vec_env(
    profile: PathText | Profile,
    n: int,
    *,
    reward: Reward,
    terminated: Terminated | None = None,
    observe: Sequence[str | Feature] = OBSERVED,
    goal: DrawGoals | None = None,
    start: DrawStarts | None = None,
    episode_s: float = 60.0,
    control_rate_hz: float | None = None,
    overrides: Overrides = (),
    render_mode: str | None = None,
    autoreset: Literal["next_step", "same_step", "disabled"] = "next_step",
    threads: int = 1,
) -> VesselVectorEnv:
    """Return `n` vessels of a profile as a `gymnasium.vector.VectorEnv`, in one batched simulation (extra `gym`).

    n: number of vessels. autoreset: when an ended episode begins again, as in Gymnasium's `AutoresetMode`. threads:
    number of threads for batches of more than 512 vessels; results do not depend on it.

    All other arguments and errors are as for `make_env`.
    """
    GYM.require("an environment needs")
    if n < 1:
        raise UserError(f"n = {n} must be at least 1")
    from gymnasium.vector import AutoresetMode

    from xitl_cli.plugins.learning.environment import VesselVectorEnv
    from xitl_cli.plugins.learning.episodes import Task

    modes = {
        "next_step": AutoresetMode.NEXT_STEP,
        "same_step": AutoresetMode.SAME_STEP,
        "disabled": AutoresetMode.DISABLED,
    }
    if autoreset not in modes:
        raise UserError(f"autoreset = {autoreset!r} is unknown; use {', '.join(modes)}")
    task = Task(observe, reward, terminated, episode_s, control_rate_hz, start, goal, render_mode)
    return VesselVectorEnv(_runnable(profile, overrides), n, task, modes[autoreset], threads)


def _runnable(profile: PathText | Profile, overrides: Overrides) -> RunProfile:
    if not isinstance(profile, Profile):
        return load_profile(profile, overrides).runnable()
    if overrides:
        raise UserError(f"{profile.name} is loaded already; give overrides to load_profile")
    return profile.runnable()
