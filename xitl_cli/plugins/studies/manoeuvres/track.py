"""A batch of vessels sailed under commands, and their tracks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import fields, is_dataclass, replace
from typing import Any, Self, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from sim_core import simulation as world
from sim_core.dataclass import dataclass
from sim_core.environment.environment import Environment
from sim_core.frames import Array, matrix_to_euler
from sim_core.kinematics import Kinematics
from sim_core.simulation import Simulation, SimulationState
from sim_core.vessel.spec import VesselSpec
from sim_core.vessel.vessel import VesselState

_WINDOW_S, _STEADY_SHARE = 4.0, 5e-4
_DRIFT_S = 1.0
"""Period of current, wind and the waves' mean force in a trial, where they are constant or slow."""
Pilot = Callable[[float, "Instant"], Array]
"""Returns the (N, C) commands for the time since the start and the motion of N vessels."""
State = TypeVar("State")


@dataclass(frozen=True, slots=True, eq=False)
class Instant:
    """Motion of N vessels, for their pilots."""

    motion: Kinematics

    @property
    def yaw_rad(self) -> Array:
        """Yaw in [-pi, pi], (N,)."""
        rotation = self.motion.rot_ned_frd
        yaw: Array = np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0])
        return yaw

    @property
    def rate_radps(self) -> Array:
        """Rate of turn about the body's axis, (N,)."""
        return self.motion.gyro_frd_radps[:, 2]

    @property
    def euler_rad(self) -> Array:
        """Euler angles, (N, 3)."""
        return matrix_to_euler(self.motion.rot_ned_frd)

    @property
    def velocity_frd(self) -> Array:
        """Velocity and rates, (N, 6), body axes."""
        motion = self.motion
        ahead = (motion.vel_ned_mps[:, None, :] @ motion.rot_ned_frd)[:, 0]
        return np.hstack([ahead, motion.gyro_frd_radps])


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """Motion of N vessels at K instants."""

    time_s: Array
    """Times, (K,)."""
    pos_ned_m: Array
    """Positions, (K, N, 3) NED."""
    euler_rad: Array
    """Euler angles, (K, N, 3). Yaw continues beyond a turn."""
    velocity_frd: Array
    """Velocity and rates, (K, N, 6), body axes."""
    command: Array
    """Commands, (K, N, C)."""

    @classmethod
    def from_samples(cls, samples: Sequence[tuple[float, Kinematics, Array]]) -> Self:
        """Convert times, motions and commands."""
        times_s, motions, commands = zip(*samples, strict=True)
        rotation = np.array([motion.rot_ned_frd for motion in motions])
        vel_ned_mps = np.array([motion.vel_ned_mps for motion in motions])
        gyro = np.array([motion.gyro_frd_radps for motion in motions])
        ahead = (vel_ned_mps[:, :, None, :] @ rotation)[:, :, 0]
        euler = matrix_to_euler(rotation)
        euler[:, :, 2] = np.unwrap(euler[:, :, 2], axis=0)
        return cls(
            time_s=np.array(times_s),
            pos_ned_m=np.array([motion.pos_ned_m for motion in motions]),
            euler_rad=euler,
            velocity_frd=np.concatenate([ahead, gyro], axis=2),
            command=np.array(commands),
        )

    def continued(self, later: Track) -> Track:
        """Return both tracks as one, with yaw continuous."""
        pairs = ((getattr(self, field.name), getattr(later, field.name)) for field in fields(self))
        time_s, pos, euler, velocity, command = (np.concatenate(pair) for pair in pairs)
        last = len(self.time_s) - 1
        euler[last:, :, 2] = np.unwrap(euler[last:, :, 2], axis=0)
        return Track(time_s, pos, euler, velocity, command)

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


def trial(model: VesselSpec, environment: Environment, dt_s: float) -> Simulation:
    """Return the simulation of a trial. Raises ValueError as `Simulation.from_spec`."""
    simulation = Simulation.from_spec(model, environment, dt_s)
    return replace(simulation, drift_ns=max(round(_DRIFT_S / dt_s), 1) * simulation.dt_ns)


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
    new: list[tuple[float, Kinematics, Array]] = []
    track: Track | None = None
    for sample in range(samples + 1):
        motion = state.vessel.motion
        command = pilot(sample * step_s, Instant(motion))
        new.append((sample * step_s, motion, command))
        if sample == samples or (sample and sample % looks == 0):
            part = Track.from_samples(new)
            track = part if track is None else track.continued(part)
            new.clear()
            if sample == samples or (until is not None and until(track)):
                break
        state = world.step(simulation, state, command, rng, steps)
    assert track is not None
    return state, track


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
