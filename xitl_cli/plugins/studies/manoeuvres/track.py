"""A batch of vessels sailed under commands, and their tracks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from sim_core import simulation as world
from sim_core.environment.environment import Environment
from sim_core.frames import Array, matrix_to_euler
from sim_core.kinematics import Kinematics
from sim_core.simulation import Simulation, SimulationState
from sim_core.vessel.vessel import VesselState

_WINDOW_S, _STEADY_SHARE = 4.0, 5e-4
Pilot = Callable[[float, "Instant"], Array]
"""Returns the (N, C) commands for the time since the start and the motion of N vessels."""
State = TypeVar("State")


@dataclass(frozen=True, slots=True, eq=False)
class Instant:
    """Motion of N vessels."""

    pos_ned_m: Array
    """Positions, (N, 3) NED."""
    euler_rad: Array
    """Euler angles, (N, 3)."""
    velocity_frd: Array
    """Velocity and rates, (N, 6), body axes."""

    @classmethod
    def from_motion(cls, motion: Kinematics) -> Instant:
        """Convert a motion. Yaw is in [-pi, pi]."""
        velocity = (motion.vel_ned_mps[:, None, :] @ motion.rot_ned_frd)[:, 0]
        return cls(motion.pos_ned_m, matrix_to_euler(motion.rot_ned_frd), np.hstack([velocity, motion.gyro_frd_radps]))


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Motion of N vessels at K instants: arrays (K, N, ...) as in `Instant`. Yaw continues beyond a turn."""

    time_s: Array
    """Times, (K,)."""
    pos_ned_m: Array
    euler_rad: Array
    velocity_frd: Array
    command: Array

    def __getitem__(self, vessel: int) -> Track:
        """Return the track of one vessel, (K, 1, ...)."""
        row = slice(vessel, vessel + 1)
        return Track(
            self.time_s, self.pos_ned_m[:, row], self.euler_rad[:, row], self.velocity_frd[:, row], self.command[:, row]
        )

    @property
    def speed_mps(self) -> Array:
        """Horizontal speed, (K, N)."""
        return np.hypot(self.velocity_frd[:, :, 0], self.velocity_frd[:, :, 1])


def still_water(environment: Environment | None = None) -> Environment:
    """Return `environment` without moving water and air."""
    return Environment() if environment is None else Environment(water=environment.water)


def spread(state: State, rows: Sequence[int]) -> State:
    """Return the vessels `rows` of a state, in this order. A vessel may occur several times."""
    return cast("State", _spread(state, np.array(rows)))


def _spread(part: Any, rows: NDArray[np.intp]) -> Any:
    if isinstance(part, np.ndarray):
        return part[rows]
    if is_dataclass(part) and not isinstance(part, type):
        return replace(part, **{field.name: _spread(getattr(part, field.name), rows) for field in fields(part)})
    return part


def start(simulation: Simulation, vessels: int, vessel: VesselState | None = None) -> SimulationState:
    """Start at rest at the origin, bow to the north, or with the given vessels, which must have the same number."""
    state = world.initial(simulation, np.zeros((vessels, 2)), np.zeros(vessels), np.random.default_rng(1))
    return state if vessel is None else replace(state, vessel=vessel)


def sail(
    simulation: Simulation,
    state: SimulationState,
    pilot: Pilot,
    duration_s: float,
    *,
    every_s: float = 0.05,
    until: Callable[[Track], bool] | None = None,
    look_s: float = 4.0,
) -> tuple[SimulationState, Track]:
    """Ask the pilot every `every_s` and record the state, until the end of the duration or until `until` returns True.

    until: receives the track so far each `look_s`.
    """
    rng = np.random.default_rng(1)
    steps = max(round(every_s / simulation.dt_s), 1)
    step_s = steps * simulation.dt_s
    samples = max(round(duration_s / step_s), 1)
    looks = max(round(look_s / step_s), 1)
    samples_kept: list[tuple[float, Instant, Array]] = []
    for sample in range(samples + 1):
        time_s = sample * step_s
        now = Instant.from_motion(state.vessel.motion)
        command = pilot(time_s, now)
        samples_kept.append((time_s, now, command))
        if sample == samples or (until is not None and sample and sample % looks == 0 and until(_track(samples_kept))):
            break
        for _ in range(steps):
            state = world.step(simulation, state, command, rng)
    return state, _track(samples_kept)


def _track(samples: list[tuple[float, Instant, Array]]) -> Track:
    euler = np.array([now.euler_rad for _, now, _ in samples])
    euler[:, :, 2] = np.unwrap(euler[:, :, 2], axis=0)
    return Track(
        time_s=np.array([time_s for time_s, _, _ in samples]),
        pos_ned_m=np.array([now.pos_ned_m for _, now, _ in samples]),
        euler_rad=euler,
        velocity_frd=np.array([now.velocity_frd for _, now, _ in samples]),
        command=np.array([command for _, _, command in samples]),
    )


def steady(track: Track) -> bool:
    """Return True if speed and rate of turn of all vessels changed by less than a given share in the last window."""
    step_s = float(track.time_s[1] - track.time_s[0])
    samples = round(_WINDOW_S / step_s)
    if len(track.time_s) <= 2 * samples:
        return False
    last = track.velocity_frd[-samples:][:, :, (0, 1, 5)]
    # The mean of each half of the window, so that a small rolling does not count.
    halves = np.array([last[: samples // 2].mean(axis=0), last[samples // 2 :].mean(axis=0)])
    change = np.abs(halves[1] - halves[0])
    size = np.maximum(np.abs(halves[1]), np.array([0.02, 0.02, 0.01]))
    return bool(np.all(change < _STEADY_SHARE * size))
