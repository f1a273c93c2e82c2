"""One step of N vessels and of the water under them: `move` in numpy, and the same recorded for compiled code.

`MotionStep.step` runs the recording of `move` where it can, and `move` itself otherwise. Both give the same motion, to
rounding. The physics is in `move` and the functions that it calls, and nowhere else.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field, replace
from typing import NamedTuple

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.environment.waves import HullSurface, HullWaves, StillHull
from sim_core.frames import Array
from sim_core.kinematics import Kinematics
from sim_core.state_class import state_class
from sim_core.tape.library import Kernel, NoKernelError, load_kernel
from sim_core.tape.program import Program
from sim_core.tape.traced import NotRecordableError, TapeRecorder
from sim_core.vessel import vessel as vessel_motion
from sim_core.vessel.battery import BatteryCondition, BatteryState
from sim_core.vessel.condition import Condition
from sim_core.vessel.propulsion import ExtendedPropulsion
from sim_core.vessel.vessel import PackedState, Surroundings, Vessel, VesselState


@state_class
class Influences:
    """What acts on N vessels in one step, besides their own state."""

    time_s: float
    tide_m: float
    """Height of the still water above its mean level."""
    current_ned_mps: Array
    """Current, (N, 3), with the waves' drift and without their orbital motion."""
    wind_ned_mps: Array
    """Wind at the height of the vessels' wind areas, (N, 3) or (1, 3)."""
    drift_frd_n: Array | None
    """Mean force of the waves, (N, 2), held from an earlier step. None to compute it."""
    command: Array
    """Commands in [-1, 1], (N, C) or (1, C)."""
    wrench_frd: Array | None
    """Force and moment of contacts, in body axes, (N, 6)."""


class Moved(NamedTuple):
    """Result of a step of N vessels."""

    vessel: VesselState
    surface: HullSurface
    """The water surface under the hulls at the beginning of the step."""
    drift_frd_n: Array
    """Mean force of the waves, (N, 2)."""


def surroundings(
    vessel: Vessel, hull_waves: HullWaves | StillHull, motion: Kinematics, influences: Influences
) -> Surroundings:
    """Return water, air and surface at the vessels."""
    surface = hull_waves.sample(influences.time_s, motion.pos_ned_m, motion.rot_ned_frd)
    surface = replace(surface, tide_m=influences.tide_m)
    water = influences.current_ned_mps + surface.orbital_ned_mps
    drift_frd_n = influences.drift_frd_n
    if drift_frd_n is None:
        drift_frd_n = vessel.wave_forces.drift.force_frd_n(motion, water, surface)
    return Surroundings(water, influences.wind_ned_mps, surface, drift_frd_n)


def move(vessel: Vessel, hull_waves: HullWaves | StillHull, state: VesselState, influences: Influences) -> Moved:
    """Return the vessels one step later."""
    around = surroundings(vessel, hull_waves, state.motion, influences)
    after = vessel_motion.step(vessel, state, influences.command, around, influences.wrench_frd)
    return Moved(after, around.surface, around.drift_frd_n)


_STEP_INPUTS = 2  # time and tide


class _Kind(NamedTuple):
    """What changes the operations of a step."""

    drift_held: bool
    contacts: bool
    condition: bool


@dataclass(slots=True, eq=False)
class MotionStep:
    """Steps the vessels of one model in one sea. Keeps the recordings of `move`."""

    vessel: Vessel
    hull_waves: HullWaves | StillHull
    why_numpy: str | None = None
    """Why the steps run in numpy, None while they run compiled."""
    _kernel: Kernel | None = None
    _programs: dict[_Kind, _CompiledMove] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if isinstance(self.vessel.propulsion, ExtendedPropulsion):  # its code may do more at a call than numpy shows
            self.why_numpy = "actuators of packages run in Python"
            return
        try:
            self._kernel = load_kernel()
        except NoKernelError as error:
            self.why_numpy = str(error)

    def __reduce__(self) -> tuple[type[MotionStep], tuple[Vessel, HullWaves | StillHull]]:
        """Make copies and pickles without the recordings, whose addresses belong to this process."""
        return MotionStep, (self.vessel, self.hull_waves)

    def step(self, state: VesselState, influences: Influences, later: Sequence[tuple[float, float]] = ()) -> Moved:
        """Return the vessels one step later, and a further step for each of `later`.

        later: time_s and tide_m of each further step. All other influences are those of the first step.
        """
        if later and (self._kernel is None or state.half_change is None or influences.drift_frd_n is None):
            moved = self._step(state, influences, ())
            return self.step(moved.vessel, _at(*later[0], influences, moved.drift_frd_n), later[1:])
        return self._step(state, influences, later)

    def _step(self, state: VesselState, influences: Influences, later: Sequence[tuple[float, float]]) -> Moved:
        """Return the vessels after steps of one kind."""
        if self._kernel is None or state.half_change is None:  # the first step integrates differently
            return move(self.vessel, self.hull_waves, state, influences)
        kind = _Kind(influences.drift_frd_n is not None, influences.wrench_frd is not None, state.condition is not None)
        program = self._programs.get(kind)
        if program is None:
            try:
                program = self._programs[kind] = _CompiledMove(self.vessel, self.hull_waves, self._kernel, kind)
            except NotRecordableError as error:
                self._kernel, self.why_numpy = None, f"the step needs {error}"
                return self.step(state, influences, later)
        return program(state, influences, later)


def _at(time_s: float, tide_m: float, influences: Influences, drift_frd_n: Array) -> Influences:
    """Return the influences of another step, with the mean force of the waves held."""
    current_ned_mps, wind_ned_mps = influences.current_ned_mps, influences.wind_ned_mps
    command, wrench_frd = influences.command, influences.wrench_frd
    return Influences(time_s, tide_m, current_ned_mps, wind_ned_mps, drift_frd_n, command, wrench_frd)


class _CompiledMove:
    """The recording of `move` for one kind of step."""

    def __init__(self, vessel: Vessel, hull_waves: HullWaves | StillHull, kernel: Kernel, kind: _Kind) -> None:
        commands, propellers = vessel.model.commands, len(vessel.model.propellers)
        self._commands, self._battery = commands, vessel.battery is not None
        recorder = TapeRecorder()
        # The row of the state
        widths = [3, 3, 4, 9, 3, commands, 6, *([1] if self._battery else [])]
        parts = _split(recorder.input((1, sum(widths))), widths)
        pos, vel, quat, rot, gyro, rotor_speed, half_change, *charge = parts
        motion = Kinematics(pos, vel, pos, quat, rot.reshape(1, 3, 3), gyro, pos)
        battery = BatteryState(charge[0][:, 0], charge[0][:, 0], charge[0][:, 0]) if self._battery else None
        # The row of the influences
        widths = [1, 1, 3, 3, commands]
        widths += [2] * kind.drift_held + [6] * kind.contacts
        widths += [commands, commands, propellers, 1, 1, 1] if kind.condition else []
        time_s, tide_m, current, wind, command, *others = _split(recorder.input((1, sum(widths))), widths)
        drift = others.pop(0) if kind.drift_held else None
        wrench = others.pop(0) if kind.contacts else None
        condition = None
        if kind.condition:
            sign, held_at, share, *of_battery = others
            condition = Condition(sign, held_at, share, BatteryCondition(*(values[:, 0] for values in of_battery)))
        # The step
        influences = Influences(time_s[0, 0], tide_m[0, 0], current, wind, drift, command, wrench)
        before = VesselState(motion, rotor_speed, half_change, condition, battery)
        after, surface, drift_frd_n = move(vessel, hull_waves, before, influences)
        # The row of the results begins with the row of the next state
        new = after.motion
        assert after.half_change is not None
        results = [new.pos_ned_m, new.vel_ned_mps, new.quat_ned_frd, new.rot_ned_frd, new.gyro_frd_radps]
        results += [after.rotor_speed, after.half_change]
        if after.battery is not None:
            results += [after.battery.used_as, after.battery.voltage_v, after.battery.current_a]
        results += [new.acc_ned_mps2, new.angular_acc_frd_radps2]
        results += [surface.point_elevation_m, surface.over_hull, drift_frd_n]
        self._program = Program(kernel, recorder, results, _STEP_INPUTS)

    def __call__(self, state: VesselState, influences: Influences, later: Sequence[tuple[float, float]]) -> Moved:
        values, address = _packed(state, self._battery)
        rows, columns = values.shape
        self._fill(self._program.other(rows), state.condition, influences)
        results, place, *parts = self._program.run(rows, address, columns, later)
        # The arrays of the next state and of the surroundings
        pos, vel, quat, rot, gyro, rotor_speed, half_change, *charge, acc, angular_acc, elevation, over_hull, drift = (
            parts
        )
        motion = Kinematics(pos, vel, acc, quat, rot, gyro, angular_acc)
        battery = BatteryState(*charge) if charge else None
        packed = PackedState(results, place, motion, rotor_speed, half_change, battery)
        after = VesselState(motion, rotor_speed, half_change, state.condition, battery, packed)
        tide_m = later[-1][1] if later else influences.tide_m
        return Moved(after, HullSurface(elevation, over_hull, tide_m), drift)

    def _fill(self, other: Array, condition: Condition | None, influences: Influences) -> None:
        """Put the influences into the (N, columns) rows of the vessels."""
        other[:, 0] = influences.time_s
        other[:, 1] = influences.tide_m
        other[:, 2:5] = influences.current_ned_mps
        other[:, 5:8] = influences.wind_ned_mps
        column = 8 + self._commands
        other[:, 8:column] = influences.command
        if influences.drift_frd_n is not None:
            other[:, column : column + 2] = influences.drift_frd_n
            column += 2
        if influences.wrench_frd is not None:
            other[:, column : column + 6] = influences.wrench_frd
            column += 6
        if condition is not None:
            faults = condition.battery
            other[:, column:] = np.column_stack(
                [
                    *(condition.sign, condition.held_at, condition.thrust_share),
                    *(faults.added_resistance_ohm, faults.cell_share, faults.voltage_drop_v),
                ]
            )


def _split(row: Array, widths: list[int]) -> list[Array]:
    ends = np.cumsum(widths).tolist()
    return [row[:, start:end] for start, end in zip([0, *ends], ends, strict=False)]


def _packed(state: VesselState, battery: bool) -> tuple[Array, int]:
    """Return the (N, columns) rows of the state and their address. A compiled step has made them already."""
    packed = state.packed
    if packed is not None and packed.holds(state):
        return packed.values, packed.address
    motion = state.motion
    parts = [motion.pos_ned_m, motion.vel_ned_mps, motion.quat_ned_frd, motion.rot_ned_frd.reshape(-1, 9)]
    parts += [motion.gyro_frd_radps, state.rotor_speed]
    assert state.half_change is not None
    parts.append(state.half_change)
    if battery and state.battery is not None:
        parts.append(state.battery.used_as[:, None])
    values = np.concatenate(parts, axis=1)
    return values, values.ctypes.data
