"""Short windows of recordings, and their simulation with sim_core: all windows are rows of one batch.

The simulation is in axes that drift with the water, so that a uniform current enters the measurements alone. Wind is
relative to the water.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.environment.spec import Water
from sim_core.environment.waves import StillHull
from sim_core.frames import euler_to_quat, quat_to_euler, quat_to_matrix
from sim_core.motion import Influences, MotionStep, surroundings
from sim_core.vessel.spec import VesselSpec
from sim_core.vessel.vessel import Vessel, VesselState, at_rest, with_half_change
from xitl_cli.errors import UserError
from xitl_cli.plugins.identify.recording import QUANTITIES, Floats, Recording

OUTPUT_S = 0.04
"""Interval of the simulated motion."""
COMMAND_S = 0.02
"""Interval of the commands: their mean over each is what the actuators follow."""
HISTORY_S = 2.0
"""Time before a window that is simulated too, so that the actuators, heel and trim begin it with their true values."""
_STRIPS = 4
_MOST_SAMPLES = 250
"""Of a quantity in a window. Samples of longer windows are thinned, so that a fit costs no more with them."""
_SMALLEST_STEP_S = 0.02 / 16
NAMES = tuple(QUANTITIES)
OF_POSITION = tuple(NAMES.index(name) for name in ("north", "east"))


@dataclass(frozen=True, slots=True)
class Windows:
    """Equally long windows of several recordings, and all samples in them, in the order of the windows."""

    recordings: tuple[Recording, ...]
    of: NDArray[np.intp]
    """(W,) number of the recording of each window."""
    start_s: Floats
    """(W,) on the time of its recording."""
    length_s: float
    window: NDArray[np.intp]
    """(M,) window of each sample."""
    quantity: NDArray[np.intp]
    """(M,) number in NAMES."""
    offset_s: Floats
    """(M,) since the start of the window."""
    values: Floats
    """(M,)."""
    width_s: Floats
    """(M,) time of which each sample is the mean."""

    def __len__(self) -> int:
        return len(self.start_s)

    def commands(self, delay_s: float) -> Floats:
        """Return the commands from HISTORY_S before each window to its end, delayed, (W, steps, C)."""
        steps = round((HISTORY_S + self.length_s) / COMMAND_S)
        edges = np.arange(steps + 1) * COMMAND_S - HISTORY_S - delay_s
        parts = [
            recording.mean_commands(self.start_s[self.of == number, None] + edges)
            for number, recording in enumerate(self.recordings)
        ]
        return np.concatenate(parts)

    def wind(self) -> Floats:
        """Return the measured velocity of the air in the middle of each step of the commands, (W, steps, 2)."""
        middles = (np.arange(round(self.length_s / COMMAND_S)) + 0.5) * COMMAND_S
        times_s = self.start_s[:, None] + middles
        return np.concatenate([own.wind_at(times_s[self.of == number]) for number, own in enumerate(self.recordings)])

    def starts(self) -> Floats:
        """Return the measured motion at the start of each window, (W, 6)."""
        return self._motion_at(self.start_s)

    def before(self, current_ne_mps: Floats, yaw_bias_rad: Floats) -> Floats:
        """Return the motion HISTORY_S before each window, (W, 4), see `relative_to_water`."""
        return relative_to_water(self._motion_at(self.start_s - HISTORY_S), current_ne_mps, yaw_bias_rad)

    def _motion_at(self, time_s: Floats) -> Floats:
        return np.concatenate([own.motion_at(time_s[self.of == number]) for number, own in enumerate(self.recordings)])


def relative_to_water(motion: Floats, current_ne_mps: Floats, yaw_bias_rad: Floats) -> Floats:
    """Return yaw, velocity through the water ahead and to starboard, and yaw rate (W, 4) of measured motions (W, 6)."""
    yaw = motion[:, 2] - yaw_bias_rad
    over_ground = (motion[:, 3] + 1j * motion[:, 4]) * np.exp(1j * motion[:, 2])
    through_water = (over_ground - current_ne_mps @ [1.0, 1j]) * np.exp(-1j * yaw)
    return np.column_stack([yaw, through_water.real, through_water.imag, motion[:, 5]])


def cut(recordings: Sequence[Recording], length_s: float, every_s: float | None = None) -> Windows:
    """Cut recordings into windows, one after the other or every `every_s`.

    Windows with gaps are left out, and those in which the boat only drifts.

    Raises UserError when no window remains.
    """
    of, starts = [], []
    for number, recording in enumerate(recordings):
        first_s, last_s = recording.span_s
        start_s = np.arange(first_s + HISTORY_S, last_s - length_s, every_s or length_s)
        start_s = start_s[~recording.broken(start_s, length_s)]
        start_s = start_s[~recording.idle(start_s, length_s)]
        of.append(np.full(len(start_s), number))
        starts.append(start_s)
    start_s, numbers = np.concatenate(starts), np.concatenate(of).astype(np.intp)
    if not len(start_s):
        longest_s = max(own.longest_part_s for own in recordings)
        raise UserError(
            f"{recordings[0].source}: no part of {length_s + HISTORY_S:g} s is under way and without a gap of 1 s (the "
            f"longest has {longest_s:.0f} s); record without interruption, or use a shorter --window"
        )
    samples = []
    for window, (number, begin_s) in enumerate(zip(numbers, start_s, strict=True)):
        for name, own in recordings[number].channels.items():
            first, last = np.searchsorted(own.time_s, (begin_s, begin_s + length_s - OUTPUT_S))
            rows = slice(first, last, max(int(np.ceil((last - first) / _MOST_SAMPLES)), 1))
            count = len(own.time_s[rows])
            code = np.full(count, NAMES.index(name))
            samples.append(
                (
                    np.full(count, window),
                    code,
                    own.time_s[rows] - begin_s,
                    own.values[rows],
                    np.full(count, own.width_s),
                )
            )
    columns = [np.concatenate(parts) for parts in zip(*samples, strict=True)]
    return Windows(tuple(recordings), numbers, start_s, length_s, *columns)


class Simulator:
    """Simulates many windows at once with the model of sim_core in still water."""

    def __init__(self, water: Water) -> None:
        self._water = water
        self._step_s = COMMAND_S

    def motion(self, spec: VesselSpec, before: Floats, starts: Floats, commands: Floats, wind_ne_mps: Floats) -> Floats:
        """Return (K, R, 6) north, east, yaw, velocity north and east, and yaw rate at every OUTPUT_S.

        starts: (R, 4) yaw, velocity ahead and to starboard, yaw rate. before: the same HISTORY_S earlier.
        commands: (R, steps, C), see `Windows.commands`.
        wind_ne_mps: (R, steps, 2) relative to the water, see `Windows.wind`, or (R, 1, 2) for a steady wind.
        """
        # In still water, more than four strips along a hull hardly change trim and heel
        hull = None if spec.hull is None else replace(spec.hull, strips=min(spec.hull.strips, _STRIPS))
        planar = replace(
            spec, hull=hull, hulls=tuple(replace(own, strips=min(own.strips, _STRIPS)) for own in spec.hulls)
        )
        while True:
            try:
                vessel = Vessel.from_spec(planar, self._water, self._step_s)
                break
            except ValueError as error:
                if self._step_s < _SMALLEST_STEP_S:
                    raise UserError(f"the model cannot be simulated ({error}); begin with other values") from error
                self._step_s *= 0.5
        return _simulated(vessel, before, starts, commands, wind_ne_mps)


def _simulated(vessel: Vessel, before: Floats, starts: Floats, commands: Floats, wind_ne_mps: Floats) -> Floats:
    rows, steps, _ = commands.shape
    history, repeats = round(HISTORY_S / COMMAND_S), round(COMMAND_S / vessel.dt_s)
    step_motion = MotionStep(vessel, StillHull(len(vessel.buoyancy.points_frd_m)))
    still = np.zeros((rows, 3))
    wind = np.zeros((rows, steps - history, 3))
    wind[:, :, :2] = wind_ne_mps
    around = Influences(0.0, 0.0, still, wind[:, 0], np.zeros((rows, 2)), commands[:, 0], None)
    # Before the windows
    state = replace(at_rest(vessel, np.zeros((rows, 2)), before[:, 0]), rotor_speed=commands[:, 0].copy())
    state = _set_off(vessel, step_motion, state, before, around)
    for step in range(history):
        around = replace(around, command=commands[:, step])
        for _ in range(repeats):
            state = step_motion.step(state, around).vessel
    around = replace(around, command=commands[:, history])
    state = _set_off(vessel, step_motion, state, starts, around)
    # Steps
    every = round(OUTPUT_S / COMMAND_S)
    results = np.empty(((steps - history) // every + 1, rows, 6))
    for number, step in enumerate(range(history, steps)):
        if number % every == 0:
            _note(results[number // every], state.motion)
        around = replace(around, command=commands[:, step], wind_ned_mps=wind[:, number])
        for _ in range(repeats):
            state = step_motion.step(state, around).vessel
    if (steps - history) % every == 0:
        _note(results[-1], state.motion)
    results[:, :, 2] = np.unwrap(results[:, :, 2], axis=0)
    results[:, :, 2] += np.round((starts[:, 0] - results[0, :, 2]) / (2.0 * np.pi)) * 2.0 * np.pi
    return results[: (steps - history) // every + 1]


def _set_off(
    vessel: Vessel, step_motion: MotionStep, state: VesselState, planar: Floats, around: Influences
) -> VesselState:
    """Return vessels at the origin with the motion in the plane of (R, 4), see `Simulator.motion`."""
    yaw, ahead, right, rate = planar.T
    cos, sin = np.cos(yaw), np.sin(yaw)
    motion = state.motion
    pos_m, velocity, gyro = motion.pos_ned_m.copy(), motion.vel_ned_mps.copy(), motion.gyro_frd_radps.copy()
    euler = quat_to_euler(motion.quat_ned_frd)
    pos_m[:, :2] = 0.0
    velocity[:, 0], velocity[:, 1] = cos * ahead - sin * right, sin * ahead + cos * right
    euler[:, 2], gyro[:, 2] = yaw, rate
    quat = euler_to_quat(euler)
    motion = replace(
        motion,
        pos_ned_m=pos_m,
        vel_ned_mps=velocity,
        quat_ned_frd=quat,
        rot_ned_frd=quat_to_matrix(quat),
        gyro_frd_radps=gyro,
    )
    state = replace(state, motion=motion)
    return with_half_change(vessel, state, surroundings(vessel, step_motion.hull_waves, motion, around))


def _note(row: Floats, motion: object) -> None:
    """Write north, east, yaw, velocity and rate of the yaw."""
    rot, gyro = motion.rot_ned_frd, motion.gyro_frd_radps  # type: ignore[attr-defined]
    row[:, :2] = motion.pos_ned_m[:, :2]  # type: ignore[attr-defined]
    row[:, 2] = np.arctan2(rot[:, 1, 0], rot[:, 0, 0])
    row[:, 3:5] = motion.vel_ned_mps[:, :2]  # type: ignore[attr-defined]
    row[:, 5] = gyro[:, 2]
