"""Outputs of the autopilot as commands: function, end points and neutral position of each."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim_core.dataclass import dataclass
from xitl_cli.logs.model.codes import (
    FIXED_OUTPUTS,
    MOTORS,
    OLD_FUNCTIONS,
    PORT_THROTTLE,
    STARBOARD_THROTTLE,
    THROTTLE,
    VehicleKind,
    servo_function_name,
)
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.table import Flags, Floats
from xitl_cli.logs.signals import Series, outputs
from xitl_cli.logs.signals.states import armed_rows, vehicle_kind

_SHORTEST_US, _LONGEST_US = 500.0, 2500.0  # of a pulse; other values are not pulses
_USUAL_US = (1100.0, 1900.0)
_AT_END = 0.05  # of the range
_GROUND_STEERING = 26
_MOTORS_BOTH_WAYS = ("rover", "sub")
_FEWEST_MOTORS = 4  # minimum of a copter, on its first outputs
_PX4_FUNCTION, _PX4_FIRST_MOTOR, _PX4_MOTORS = "PWM_MAIN_FUNC", 101, 12


@dataclass(frozen=True, slots=True)
class OutputChannel:
    """An output with its command."""

    channel: int
    name: str
    function: int | None
    series: Series
    command: Floats
    """(N,) from -1 to 1 about neutral, or from 0 to 1 if neutral is an end; NaN without a pulse."""
    armed: Flags
    """(N,); all True if the log does not show arming, and arming_known is False."""
    known: bool
    """Whether the log has its end points."""
    arming_known: bool

    @property
    def drives(self) -> bool:
        """Whether it is a motor."""
        return self.function in MOTORS or self.function in THROTTLES or (self.series.unit == "" and not self.function)


@dataclass(frozen=True, slots=True)
class OutputRange:
    """Pulses (us) of an output: minimum, maximum, and neutral (trim, or an end: idle)."""

    low_us: float
    high_us: float
    neutral_us: float
    reversed: bool
    known: bool

    def command(self, pulse_us: Floats) -> Floats:
        """(N,) commands for pulses: share of the range from neutral to either end."""
        offset = pulse_us - self.neutral_us
        up, down = self.high_us - self.neutral_us, self.neutral_us - self.low_us
        command = np.where(offset >= 0.0, offset / up if up > 0.0 else 0.0, offset / down if down > 0.0 else 0.0)
        return -command if self.reversed else command


def driven_outputs(log: Log, parameters: Mapping[str, float]) -> list[OutputChannel]:
    """Outputs with a function, by channel."""
    kind = vehicle_kind(log)
    every = (output_channel(log, channel, each, parameters, kind) for channel, each in outputs(log).items())
    return [output for output in every if output is not None]


def output_channel(
    log: Log, channel: int, each: Series, parameters: Mapping[str, float], kind: VehicleKind
) -> OutputChannel | None:
    """Output of a channel; None if it drives nothing."""
    armed = armed_rows(log, each.stamp_ns)
    on = np.ones(len(each.stamp_ns), dtype=np.bool_) if armed is None else armed
    if each.unit != "us":
        if not each.values.any():
            return None
        # Function of a command in an xitl recording; empty if unknown.
        table = log.tables.get("/actuators")
        if table is None or "names" not in table.columns or not len(table.stamp_ns):
            what = ""
        else:
            names = str(table.values("names")[0]).split(", ")
            what = names[channel - 1] if channel <= len(names) else ""
        turns = what.startswith(("steering", "rudder"))
        name, driven = (what, _GROUND_STEERING) if turns else (f"motor {channel}", None)
        return OutputChannel(channel, name, driven, each, each.values, on, True, armed is not None)
    px4 = any(name.startswith(_PX4_FUNCTION) for name in parameters)
    px4_motor = int(parameters.get(f"{_PX4_FUNCTION}{channel}", 0.0)) - _PX4_FIRST_MOTOR if px4 else 0
    function = None if px4 else _function(channel, parameters, kind)
    if px4_motor == -_PX4_FIRST_MOTOR or (function is not None and (function in FIXED_OUTPUTS or function <= 0)):
        return None
    pulse = np.where((each.values < _SHORTEST_US) | (each.values > _LONGEST_US), np.nan, each.values)
    if not np.isfinite(pulse).any():
        return None
    prefixes = () if px4 else (f"SERVO{channel}_", f"RC{channel}_")  # RCn_MAX of a PX4 belongs to an input
    prefix = next((name for name in prefixes if f"{name}MAX" in parameters), None)
    low, high = (parameters.get(f"{prefix}{end}", us) for end, us in zip(("MIN", "MAX"), _USUAL_US, strict=True))
    idles = function in MOTORS and kind not in _MOTORS_BOTH_WAYS
    if idles:
        low, high = _motor_ends(low, high, parameters)
    known = prefix is not None and low < high
    if not known:
        wider = bool(np.nanmin(pulse) < _USUAL_US[0] or np.nanmax(pulse) > _USUAL_US[1])
        low, high = (1000.0, 2000.0) if wider else _USUAL_US
    turned = parameters.get(f"{prefix}REVERSED", 0.0) > 0.0 or parameters.get(f"{prefix}REV", 1.0) < 0.0
    trim = parameters.get(f"{prefix}TRIM")
    if idles or (kind == "plane" and function in THROTTLES and parameters.get("THR_MIN", 0.0) >= 0.0):
        trim = high if turned and not idles else low  # TRIM is not used for these
    if px4:  # disarmed, its outputs are below the minimum
        goes_back = px4_motor not in range(_PX4_MOTORS) or int(parameters.get("CA_R_REV", 0.0)) >> px4_motor & 1
        trim = 0.5 * (low + high) if goes_back else low
    if trim is None or not low <= trim <= high:
        at_rest = pulse[~on & np.isfinite(pulse)]
        trim = float(np.median(at_rest)) if len(at_rest) else 0.5 * (low + high)
        trim = min(max(trim, low), high)
    span = high - low
    trim = low if trim - low < _AT_END * span else high if high - trim < _AT_END * span else trim
    ends = OutputRange(low, high, trim, turned and not idles, known)
    name = f"output {channel}" if function is None else f"output {channel} ({servo_function_name(function)})"
    return OutputChannel(channel, name, function, each, ends.command(pulse), on, ends.known, armed is not None)


def _function(channel: int, parameters: Mapping[str, float], kind: VehicleKind) -> int | None:
    """Function number; 0 for an output without function; None if unknown."""
    if any(name.startswith("SERVO") and name.endswith("_FUNCTION") for name in parameters):
        return int(parameters.get(f"SERVO{channel}_FUNCTION", 0.0))
    fixed = OLD_FUNCTIONS.get(kind, {}).get(channel)
    if f"RC{channel}_MIN" not in parameters:
        return fixed if kind == "copter" and channel <= _FEWEST_MOTORS else None
    own = int(parameters.get(f"RC{channel}_FUNCTION", 0.0))
    return own if own or fixed is None else fixed


THROTTLES = (THROTTLE, PORT_THROTTLE, STARBOARD_THROTTLE)


def _motor_ends(low: float, high: float, parameters: Mapping[str, float]) -> tuple[float, float]:
    """End points of multicopter motors, which are separate; before 2017, those of the throttle's channel."""
    for prefix in ("MOT_PWM_", "Q_M_PWM_"):
        if parameters.get(f"{prefix}MAX", 0.0) > parameters.get(f"{prefix}MIN", 0.0) > 0.0:
            return parameters[f"{prefix}MIN"], parameters[f"{prefix}MAX"]
    return parameters.get("RC3_MIN", low), parameters.get("RC3_MAX", high)
