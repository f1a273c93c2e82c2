"""Motor commands over time: the steps of a script or of a recording, each active until the next."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sim_core.dataclass import dataclass
from sim_core.vessel.spec import VesselSpec
from xitl_cli.errors import UserError
from xitl_cli.profile.schema import RunProfile
from xitl_cli.profile.schema.agents import ReplaySpec, ScriptStep
from xitl_cli.replay.pulse_log import NO_PULSE_US, PulseLog, holds_messages, read_pulse_log
from xitl_cli.replay.thrust_log import ThrustLog, read_thrust_log

THROTTLE_LEFT, THROTTLE_RIGHT, GROUND_STEERING, THROTTLE, MOTOR_1 = 73, 74, 26, 70, 33  # SERVOn_FUNCTION
USUAL_OUTPUTS = (1, 3)

Motors = tuple[float, ...]


@dataclass(frozen=True, slots=True)
class MotorSchedule:
    """Motor commands over time."""

    at_ns: tuple[int, ...]
    """Start of each step, rising, from the start of the schedule."""
    motors: tuple[Motors, ...]
    """Commands in [-1, 1], in the vessel's order, each active until the next."""
    end_ns: int | None
    """End of the schedule; None for a script without an end, which holds its last step."""

    def motors_at(self, now_ns: int) -> Motors | None:
        """Return the active command, None before the first."""
        number = bisect_right(self.at_ns, now_ns)
        return self.motors[number - 1] if number else None

    @property
    def last_ns(self) -> int:
        """Start of the last step, or the end of the schedule."""
        return self.at_ns[-1] if self.end_ns is None else self.end_ns


def schedule_from_script(steps: Sequence[ScriptStep]) -> MotorSchedule:
    """Return the steps of a script that move motors. A step without `motors` keeps the active command."""
    moving = [(round(step.at_s * 1e9), step.motors) for step in steps if step.motors is not None]
    end_ns = round(steps[-1].at_s * 1e9) if steps[-1].end else None
    return MotorSchedule(tuple(at_ns for at_ns, _ in moving), tuple(motors for _, motors in moving), end_ns)


def schedule_from_file(profile: RunProfile, vessel: VesselSpec | None = None) -> MotorSchedule:
    """Return the recording of `driver.file` as commands, as `schedule_from_pulses` does.

    For a bag without servo outputs, use the commands to its thrusters. Raises UserError with the problem in the file.
    """
    path, replay = Path(profile.driver.file or ""), profile.driver.replay
    if holds_messages(path) and (thrusts := read_thrust_log(path, profile)) is not None:
        return _schedule_from_thrusts(thrusts, replay, vessel)
    return schedule_from_pulses(read_pulse_log(path), replay, vessel)


def _schedule_from_thrusts(log: ThrustLog, replay: ReplaySpec, vessel: VesselSpec | None) -> MotorSchedule:
    """Return the commands from `start_s`, or the first command that is not neutral, on."""
    moving = np.flatnonzero(log.commands.any(axis=1))
    if not len(moving):
        raise UserError(f"{log.source}: all thruster commands are zero; use a bag of a vessel under way")
    if vessel is None and log.commands.shape[1] != len(USUAL_OUTPUTS):
        raise UserError(
            f"{log.source}: an autopilot can replay only two propellers side by side; use autopilot.kind: none to "
            "replay the thrusters of another vessel"
        )
    start_s = float(log.at_s[moving[0]]) if replay.start_s is None else replay.start_s
    end_s = float(log.at_s[-1]) if replay.end_s is None else min(replay.end_s, float(log.at_s[-1]))
    if start_s >= end_s:
        raise UserError(
            f"{log.source} ends at {end_s:g} s, not after the start of the replay at {start_s:g} s; "
            "set driver.replay.start_s and end_s within it"
        )
    first = max(int(np.searchsorted(log.at_s, start_s, side="right")) - 1, 0)
    last = int(np.searchsorted(log.at_s, end_s, side="right"))
    at_ns = np.maximum(np.rint((log.at_s[first:last] - start_s) * 1e9), 0.0).astype(np.int64)
    return MotorSchedule(
        tuple(at_ns.tolist()), tuple(map(tuple, log.commands[first:last].tolist())), round((end_s - start_s) * 1e9)
    )


def schedule_from_pulses(log: PulseLog, replay: ReplaySpec, vessel: VesselSpec | None = None) -> MotorSchedule:
    """Return recorded pulse widths as commands of the vessel, from `start_s` (or the first armed output) on.

    vessel: None for two motors. An autopilot gets their commands as stick inputs. Steering and throttle drive one
    propeller and all steering actuators. For two propellers they are mixed as in a skid-steered ArduRover: port is
    throttle plus steering.
    """
    outputs, mixed = _outputs(log, replay, vessel)
    start_s, end_s = replayed_span_s(log, replay, vessel)
    rows = _rows(log, outputs)
    first = max(bisect_right(log.at_s, start_s) - 1, 0)
    last = bisect_right(log.at_s, end_s)
    commands = [tuple(_command(pulse, replay) for pulse in row) for row in rows[first:last]]
    return MotorSchedule(
        at_ns=tuple(max(round((at_s - start_s) * 1e9), 0) for at_s in log.at_s[first:last]),
        motors=tuple(_mix(vessel, *command) if mixed else command for command in commands),
        end_ns=round((end_s - start_s) * 1e9),
    )


def replayed_span_s(log: PulseLog, replay: ReplaySpec, vessel: VesselSpec | None = None) -> tuple[float, float]:
    """Return start and end of the replay on the recording's clock in s. Raises UserError for an empty span."""
    rows = _rows(log, _outputs(log, replay, vessel)[0])
    start_s = _first_armed_s(log, rows, replay.trim_us) if replay.start_s is None else replay.start_s
    end_s = log.at_s[-1] if replay.end_s is None else min(replay.end_s, log.at_s[-1])
    if start_s >= end_s:
        raise UserError(
            f"{log.source} ends at {end_s:g} s, not after the start of the replay at {start_s:g} s; "
            f"the recording goes from {log.at_s[0]:g} to {log.at_s[-1]:g} s, "
            "set driver.replay.start_s and end_s within it"
        )
    return start_s, end_s


def _rows(log: PulseLog, outputs: tuple[int, ...]) -> list[tuple[float, ...]]:
    """Return the pulses of these channels at each instant."""
    missing = [channel for channel in outputs if channel not in log.pulses_us]
    if missing:
        raise UserError(
            f"{log.source} has no output C{missing[0]}, only "
            f"{', '.join(f'C{channel}' for channel in sorted(log.pulses_us))}; select those of the motors in "
            "driver.replay.outputs"
        )
    return list(zip(*(log.pulses_us[channel] for channel in outputs), strict=True))


def _outputs(log: PulseLog, replay: ReplaySpec, vessel: VesselSpec | None) -> tuple[tuple[int, ...], bool]:
    """Return the channels to read, and whether they are steering and throttle."""
    mixed = replay.outputs_are == "steering-throttle"
    if replay.outputs is not None:
        return replay.outputs, mixed
    channel_of = {function: channel for channel, function in sorted(log.functions.items(), reverse=True)}
    motors = range(MOTOR_1, MOTOR_1 + (2 if vessel is None else vessel.commands))
    if replay.outputs_are != "steering-throttle" and all(function in channel_of for function in motors):
        return tuple(channel_of[function] for function in motors), False
    pair = vessel is None or vessel.commands == len(vessel.propellers) == len(USUAL_OUTPUTS)
    kinds = {"motors": (THROTTLE_LEFT, THROTTLE_RIGHT)} if pair else {}
    if vessel is None or vessel.moves_by_sticks:
        kinds["steering-throttle"] = (GROUND_STEERING, THROTTLE)
    for kind, functions in kinds.items():
        if replay.outputs_are in (None, kind) and all(f in channel_of for f in functions):
            return tuple(channel_of[function] for function in functions), kind == "steering-throttle"
    usual = USUAL_OUTPUTS if mixed or pair or vessel is None else tuple(range(1, vessel.commands + 1))
    return usual, mixed


def _first_armed_s(log: PulseLog, rows: Sequence[tuple[float, ...]], trim_us: float) -> float:
    """Return the time of arming, or otherwise the time at which an output first left neutral."""
    if log.armed_s is not None:
        return log.at_s[min(bisect_left(log.at_s, log.armed_s), len(log.at_s) - 1)]
    for at_s, row in zip(log.at_s, rows, strict=True):
        if any(pulse not in (NO_PULSE_US, trim_us) for pulse in row):
            return at_s
    raise UserError(
        f"{log.source}: all outputs stay at {trim_us:g} µs; check driver.replay.outputs and trim_us, "
        "or set driver.replay.start_s"
    )


def _command(pulse_us: float, replay: ReplaySpec) -> float:
    if pulse_us == NO_PULSE_US:
        return 0.0
    return min(max((pulse_us - replay.trim_us) / replay.span_us, -1.0), 1.0)


def _mix(vessel: VesselSpec | None, steering: float, throttle: float) -> Motors:
    """Return throttle and all steering actuators, or port and starboard without steering actuators.

    When port or starboard would exceed 1, both are scaled, so that the turn keeps its shape.
    """
    steered = 0 if vessel is None else vessel.own_commands - len(vessel.propellers)
    if steered:
        return (throttle, *[steering] * steered)
    port, starboard = throttle + steering, throttle - steering
    scale = max(abs(port), abs(starboard), 1.0)
    return port / scale, starboard / scale
