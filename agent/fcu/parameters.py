"""Parameters of the embedded autopilot: the table, and a store with checks.

If ArduRover has a parameter of the same purpose, name, unit, meaning and type are those of ArduRover. Defaults suit the
full-size vessel.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from agent.mavlink.modes import ROVER_MODES
from agent.mavlink.parameter_rows import INT8, INT16, INT32, REAL32, Parameter, ParameterError, parm_lines, within
from agent.navigation.parameters import ESTIMATOR_ROWS

RC_CHANNELS = 16  # with RCn_ parameters
OUTPUTS = 16  # with SERVOn_ parameters
MOTORS, RUDDERS = 8, 4  # with a position: MOTn_, RUDn_
_MODES = tuple(ROVER_MODES)
SYSTEM_ID = "SYSID_THISMAV"


_ROWS: tuple[Parameter, ...] = (
    Parameter("ACRO_TURN_RATE", 30.0, 1.0, 360.0, "deg/s", "turn rate at full steering stick in ACRO and STEERING"),
    Parameter(
        "ARMING_CHECK",
        1,
        0,
        2097151,
        "",
        "0 none, 1 all, or a sum: 2 baro, 4 compass, 8 GPS, 16 INS, 64 RC, 16384 mission",
        INT32,
    ),
    Parameter("ATC_ACCEL_MAX", 0.7, 0.05, 10.0, "m/s/s", "largest rise of the desired speed"),
    Parameter("ATC_DECEL_MAX", 0.7, 0.05, 10.0, "m/s/s", "largest fall of the desired speed"),
    Parameter("ATC_SPEED_I", 0.25, 0.0, 2.0, "1/m", "speed integral gain"),
    Parameter("ATC_SPEED_IMAX", 0.5, 0.0, 1.0, "", "limit of the speed integral, part of full thrust"),
    Parameter("ATC_SPEED_P", 0.6, 0.0, 4.0, "s/m", "speed proportional gain"),
    Parameter("ATC_STR_ACC_MAX", 90.0, 0.0, 1000.0, "deg/s/s", "largest change of the desired turn rate, 0 for none"),
    Parameter("ATC_STR_ANG_P", 1.5, 0.1, 10.0, "1/s", "desired turn rate per heading error"),
    Parameter("ATC_STR_RAT_D", 0.0, 0.0, 1.0, "s^2/rad", "turn rate derivative gain"),
    Parameter("ATC_STR_RAT_FF", 0.8, 0.0, 10.0, "s/rad", "steering per desired turn rate"),
    Parameter("ATC_STR_RAT_FLTD", 5.0, 0.1, 100.0, "Hz", "low pass of the turn rate derivative"),
    Parameter("ATC_STR_RAT_I", 0.6, 0.0, 10.0, "1/rad", "turn rate integral gain"),
    Parameter("ATC_STR_RAT_IMAX", 0.5, 0.0, 1.0, "", "limit of the turn rate integral"),
    Parameter("ATC_STR_RAT_MAX", 30.0, 1.0, 360.0, "deg/s", "largest desired turn rate"),
    Parameter("ATC_STR_RAT_P", 0.6, 0.0, 10.0, "s/rad", "turn rate proportional gain"),
    Parameter("ATC_TURN_MAX_G", 0.15, 0.01, 1.0, "g", "largest lateral acceleration in a turn"),
    Parameter("CIRC_DIR", 0, 0, 1, "", "CIRCLE: 0 clockwise, 1 counterclockwise", INT8),
    Parameter("CIRC_RADIUS", 20.0, 0.0, 100.0, "m", "radius of CIRCLE, no less than TURN_RADIUS"),
    Parameter("CIRC_SPEED", 0.0, 0.0, 10.0, "m/s", "speed of CIRCLE, 0 for WP_SPEED"),
    Parameter("CRUISE_SPEED", 3.0, 0.1, 30.0, "m/s", "speed through still water at CRUISE_THROTTLE"),
    Parameter("CRUISE_THROTTLE", 45.0, 1.0, 100.0, "%", "thrust, part of full thrust, at CRUISE_SPEED", INT8),
    Parameter(
        "FENCE_ACTION", 1, 0, 4, "", "at a breach: 0 report, 1 RTL, 2 HOLD, 3 SMART_RTL or RTL, 4 SMART_RTL", INT8
    ),
    Parameter("FENCE_ENABLE", 0, 0, 1, "", "1 enables the fence", INT8),
    Parameter("FENCE_MARGIN", 2.0, 0.0, 100.0, "m", "distance inside at which a breach ends; GUIDED keeps it too"),
    Parameter("FENCE_RADIUS", 300.0, 1.0, 10000.0, "m", "radius of the circle around home"),
    Parameter("FENCE_TYPE", 6, 0, 7, "", "sum of: 2 circle around home, 4 uploaded polygons and circles", INT8),
    Parameter(
        "FS_ACTION", 2, 0, 6, "", "0 none, 1 RTL, 2 HOLD, 3 SMART_RTL or RTL, 4 SMART_RTL, 5 disarm, 6 LOITER", INT8
    ),
    Parameter("FS_EKF_ACTION", 1, 0, 2, "", "bad estimate in a mode that needs it: 0 nothing, 1 HOLD, 2 report", INT8),
    Parameter("FS_EKF_THRESH", 0.8, 0.0, 10.0, "", "test ratio of GNSS or compass that counts as bad, 0 for none"),
    Parameter(
        "FS_GCS_ENABLE", 0, 0, 2, "", "act when the ground station falls silent: 0 no, 1 yes, 2 but not in AUTO", INT8
    ),
    Parameter(
        "FS_GCS_TIMEOUT", 5.0, 1.0, 120.0, "s", "time without a heartbeat after which a ground station is silent"
    ),
    Parameter("FS_IMU_TIMEOUT", 0.25, 0.02, 10.0, "s", "time without an IMU sample after which outputs are neutral"),
    Parameter("FS_TIMEOUT", 1.5, 0.0, 100.0, "s", "duration of the cause before a failsafe acts"),
    Parameter("GUID_TIMEOUT", 3.0, 0.1, 60.0, "s", "validity of velocity and course targets in GUIDED"),
    Parameter("INITIAL_MODE", 4, 0, 15, "", "number of the mode after start", INT8, _MODES),
    Parameter("LOIT_RADIUS", 2.0, 0.1, 100.0, "m", "largest drift of a loitering vessel from its position"),
    Parameter("LOIT_SPEED_GAIN", 0.5, 0.0, 5.0, "1/s", "speed back to the position per distance"),
    Parameter("LOIT_TYPE", 0, 0, 2, "", "back to the position: 0 bow or stern first, 1 bow first, 2 stern first", INT8),
    Parameter("LOS_KAPPA", 0.8, 0.0, 10.0, "m/s", "integral gain of the line-of-sight guidance"),
    Parameter("LOS_LOOKAHEAD", 6.0, 0.5, 500.0, "m", "look-ahead distance of the line-of-sight guidance"),
    Parameter("MIS_DONE_BEHAVE", 0, 0, 1, "", "after the last waypoint: 0 HOLD, 1 LOITER", INT8),
    Parameter("MOT_SLEWRATE", 500.0, 0.0, 1000.0, "%/s", "largest change of a motor command, 0 for none", INT16),
    Parameter("MOT_SPD_SCA_BASE", 1.0, 0.0, 10.0, "m/s", "speed above which rudders turn less, 0 for none"),
    Parameter("MOT_STR_THR_MIX", 1.0, 0.2, 1.0, "", "skid steering: 1 reduces thrust for steering, 0.5 both equally"),
    Parameter("MOT_THST_ASYM", 1.667, 1.0, 10.0, "", "thrust ahead over thrust astern at full command"),
    Parameter("MOT_THST_EXPO", 1.0, -1.0, 1.0, "", "thrust curve: 0 linear, 1 square of the command"),
    Parameter("MOT_VEC_ANGLEMAX", 0.0, 0.0, 90.0, "deg", "angle of the thrust at full steering, 0 for a rudder"),
    Parameter("RCMAP_ROLL", 1, 1, RC_CHANNELS, "", "RC channel of the steering stick", INT8),
    Parameter("RCMAP_THROTTLE", 3, 1, RC_CHANNELS, "", "RC channel of the throttle stick", INT8),
    Parameter("RC_OVERRIDE_TIME", 3.0, -1.0, 120.0, "s", "validity of RC overrides, 0 never, -1 until released"),
    Parameter("RTL_SPEED", 0.0, 0.0, 100.0, "m/s", "speed over ground on the way home, 0 for WP_SPEED"),
    Parameter("SIMPLE_TYPE", 0, 0, 1, "", "reference of headings in SIMPLE: 0 the heading at arming, 1 north", INT8),
    Parameter("SPEED_MAX", 0.0, 0.0, 30.0, "m/s", "speed at full throttle stick, 0 to derive it from CRUISE_THROTTLE"),
    Parameter("SRTL_ACCURACY", 2.0, 0.0, 10.0, "m", "SMART_RTL: least distance between the points of its path"),
    Parameter("SRTL_POINTS", 300, 0, 500, "", "SMART_RTL: most points of its path, 0 for no SMART_RTL", INT16),
    Parameter("SYSID_MYGCS", 255, 0, 255, "", "system id of the ground station to monitor, 0 for any", INT16),
    Parameter("TURN_RADIUS", 3.0, 0.1, 100.0, "m", "tightest turn under way, at full steering stick in STEERING"),
    Parameter("WP_RADIUS", 2.0, 0.1, 100.0, "m", "distance at which a waypoint counts as reached"),
    Parameter("WP_SPEED", 3.0, 0.1, 100.0, "m/s", "speed over ground between waypoints"),
    Parameter("WP_SPEED_MIN", 1.0, 0.1, 100.0, "m/s", "least speed in corners"),
)


def _channel_rows(number: int) -> tuple[Parameter, ...]:
    """Parameters of an RC channel.

    MIN is 1101: a ground station treats exactly 1100, 1500 and 1900 as an uncalibrated radio.
    """
    name = f"RC{number}"
    return (
        Parameter(f"{name}_DZ", 30, 0, 200, "us", "dead zone on either side of the trim", INT16),
        Parameter(f"{name}_MAX", 1900, 1600, 2200, "us", "widest pulse", INT16),
        Parameter(f"{name}_MIN", 1101, 800, 1400, "us", "narrowest pulse", INT16),
        _fixed(f"{name}_OPTION", 0, INT16, "no switch is read"),
        Parameter(f"{name}_REVERSED", 0, 0, 1, "", "1 reverses the direction", INT8),
        Parameter(f"{name}_TRIM", 1500, 800, 2200, "us", "pulse of the centred stick", INT16),
    )


def _output_rows() -> Iterator[Parameter]:
    """Parameters of the actuators: functions of the outputs as in ArduRover, and positions of motors and rudders."""
    usual = {1: 73, 3: 74}
    for number in range(1, OUTPUTS + 1):
        yield Parameter(
            f"SERVO{number}_FUNCTION",
            usual.get(number, 0),
            0,
            74,
            "",
            "0 none, 26 steering, 70 throttle, 73 and 74 throttle left and right, 33 to 40 motor 1 to 8",
            INT16,
            (0, 26, *range(33, 33 + MOTORS), 70, 73, 74),
        )
    for number in range(1, MOTORS + 1):
        name = f"MOT{number}"
        yield Parameter(f"{name}_ANGLE", 0.0, -180.0, 180.0, "deg", "direction of its thrust, 90 to starboard")
        yield Parameter(f"{name}_ASYM", 0.0, 0.0, 100.0, "", "its full thrust ahead over astern, 0 for MOT_THST_ASYM")
        yield Parameter(f"{name}_POS_X", 0.0, -500.0, 500.0, "m", "its position forward of the body origin")
        yield Parameter(f"{name}_POS_Y", 0.0, -500.0, 500.0, "m", "its position right of the body origin")
        yield Parameter(f"{name}_THRUST", 0.0, 0.0, 1e7, "N", "its full thrust ahead, 0 for an absent motor")
        yield Parameter(f"{name}_VEC_MAX", 0.0, 0.0, 180.0, "deg", "largest angle of its gear, 0 for a fixed motor")
    for number in range(1, RUDDERS + 1):
        name = f"RUD{number}"
        yield Parameter(f"{name}_FORCE", 0.0, 0.0, 1e7, "N", "side force of full angle at MOT_SPD_SCA_BASE, 0 for none")
        yield Parameter(f"{name}_MOT", 0, 0, MOTORS, "", "motor whose race flows over it, 0 for none", INT8)
        yield Parameter(f"{name}_POS_X", 0.0, -500.0, 500.0, "m", "its position forward of the body origin")
        yield Parameter(f"{name}_RACE", 0.0, 0.0, 100.0, "m/s", "flow over it at rest with that motor full ahead")


def _fixed(name: str, value: float, type: int, meaning: str, unit: str = "") -> Parameter:
    """Constant of this autopilot that ground stations read under ArduPilot's name."""
    return Parameter(name, value, value, value, unit, meaning, type)


def _battery_rows() -> Iterator[Parameter]:
    """Battery settings under ArduPilot's names. They are stored without effect, because nothing measures a battery."""
    yield _fixed("BATT_MONITOR", 0, INT8, "0: nothing measures the battery")
    for name, default, high, unit, kind in (
        ("AMP_OFFSET", 0.0, 10.0, "V", REAL32),
        ("AMP_PERVLT", 17.0, 1000.0, "A/V", REAL32),
        ("ARM_MAH", 0, 1e6, "mAh", INT32),
        ("ARM_VOLT", 0.0, 1000.0, "V", REAL32),
        ("CAPACITY", 3300, 1e6, "mAh", INT32),
        ("CRT_MAH", 0.0, 1e6, "mAh", REAL32),
        ("CRT_VOLT", 0.0, 1000.0, "V", REAL32),
        ("CURR_PIN", -1, 127, "", INT8),
        ("FS_CRT_ACT", 0, 6, "", INT8),
        ("FS_LOW_ACT", 0, 6, "", INT8),
        ("LOW_MAH", 0.0, 1e6, "mAh", REAL32),
        ("LOW_VOLT", 0.0, 1000.0, "V", REAL32),
        ("VOLT_MULT", 10.1, 1000.0, "", REAL32),
        ("VOLT_PIN", -1, 127, "", INT8),
    ):
        low = -1 if name.endswith("PIN") else 0
        yield Parameter(f"BATT_{name}", default, low, high, unit, "stored; nothing measures the battery", kind)


def _station_rows() -> Iterator[Parameter]:
    """Other ArduRover parameters that ground stations read, see docs/ground-stations.md."""
    # One calibrated compass. Device ids are of ArduPilot's simulated sensors (libraries/AP_HAL, devtype SITL).
    for number in ("", "2", "3"):
        yield _fixed(f"COMPASS_DEV_ID{number}", 0 if number else 97539, INT32, "the compass; 0 for none")
        yield _fixed(f"COMPASS_PRIO{number or 1}_ID", 0 if number else 97539, INT32, "compass of that rank; 0 for none")
        yield _fixed(f"COMPASS_USE{number}", 0 if number else 1, INT8, "whether the estimator uses it")
        external = f"COMPASS_EXTERN{number}" if number else "COMPASS_EXTERNAL"
        yield _fixed(external, 0, INT8, "0 as it is aligned with the body")
        yield _fixed(f"COMPASS_ORIENT{number}", 0, INT8, "0 as it is aligned with the body")
        if number:
            yield from (_fixed(f"COMPASS_OFS{number}_{a}", 0.0, REAL32, "there is none", "mGauss") for a in "XYZ")
    yield from _battery_rows()
    yield _fixed("AHRS_ORIENTATION", 0, INT8, "0: samples are in body axes")
    yield _fixed("BARO1_DEVID", 65540, INT32, "the barometer")
    yield _fixed("BARO2_DEVID", 0, INT32, "there is none")
    yield _fixed("BARO3_DEVID", 0, INT32, "there is none")
    yield _fixed("COMPASS_ENABLE", 1, INT8, "there is a compass")
    yield _fixed("COMPASS_LEARN", 0, INT8, "0: offsets are not learned")
    yield _fixed("FORMAT_VERSION", 16, INT16, "of ArduRover's parameters")
    yield _fixed("FRAME_CLASS", 2, INT8, "2: a boat")
    yield _fixed("FRAME_TYPE", 0, INT8, "0: no balancing, no wheels")
    yield _fixed("FS_CRASH_CHECK", 0, INT8, "0: crashes are not detected")
    yield _fixed("FS_THR_ENABLE", 0, INT8, "0: there is no RC receiver")
    yield _fixed("FS_THR_VALUE", 910, INT16, "throttle pulse below which a receiver has failed", "us")
    for axis in "XYZ":
        # Values of ArduPilot's simulated sensors. All zeros would mean "not calibrated" to a station.
        yield _fixed(f"INS_ACCOFFS_{axis}", 0.001, REAL32, "samples come calibrated", "m/s/s")
        yield _fixed(f"INS_ACCSCAL_{axis}", 1.0, REAL32, "samples come calibrated")
    yield _fixed("INS_ACC_ID", 2753028, INT32, "the accelerometer")
    yield _fixed("INS_ACC2_ID", 0, INT32, "there is none")
    yield _fixed("INS_ACC3_ID", 0, INT32, "there is none")
    yield _fixed("INS_GYR_ID", 2752772, INT32, "the gyroscope")
    yield _fixed("MODE_CH", 8, INT8, "RC channel of the mode switch, which is not read")
    for mode in range(1, 7):
        yield Parameter(f"MODE{mode}", 0, 0, 15, "", "stored; the mode switch is not read", INT8, _MODES)
    yield Parameter("RCMAP_PITCH", 2, 1, RC_CHANNELS, "", "stored; a boat has no such stick", INT8)
    yield Parameter("RCMAP_YAW", 4, 1, RC_CHANNELS, "", "stored; RCMAP_ROLL steers", INT8)
    yield Parameter(SYSTEM_ID, 1, 1, 250, "", "system id of this autopilot, fixed at its start", INT16)


TABLE: tuple[Parameter, ...] = tuple(
    sorted(
        (
            *_ROWS,
            *ESTIMATOR_ROWS,
            *_station_rows(),
            *_output_rows(),
            *(row for number in range(1, RC_CHANNELS + 1) for row in _channel_rows(number)),
        )
    )
)

BY_NAME: dict[str, Parameter] = {row.name: row for row in TABLE}


class Parameters:
    """Values of all parameters. `version` counts changes, so that users with cached values know when to update.

    system_id: system id of the autopilot, constant while it runs, because all peers use it.
    """

    def __init__(self, values: Mapping[str, float] | None = None, system_id: int = 1) -> None:
        self.version = 0
        self._values = {row.name: float(row.default) for row in TABLE} | {SYSTEM_ID: float(system_id)}
        for name, value in (values or {}).items():
            self.set(name, value)

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def set(self, name: str, value: float) -> float:
        """Set one parameter and return the stored value.

        Raises ParameterError for a refused value and changes nothing.
        """
        stored = checked(name, value)
        if stored != self._values[name]:
            self._check_settable(name, stored)
            self._values[name] = stored
            self.version += 1
        return stored

    def _check_settable(self, name: str, value: float) -> None:
        if name == SYSTEM_ID and value != self._values[SYSTEM_ID]:
            raise ParameterError(
                f"{SYSTEM_ID} = {value:g} is refused: it is {self._values[SYSTEM_ID]:g} since the start; set the "
                "agent's --system-id, or the profile's autopilot.system_id"
            )

    def load(self, text: str, source: str = "parameters") -> None:
        """Set all values of a .parm text, or none when one line is refused. source: name of the file in messages."""
        values = checked_parm(text, source)
        for line, name, value in values:
            try:
                self._check_settable(name, value)
            except ParameterError as error:
                raise ParameterError(f"{source}:{line}: {error}") from None
        for _, name, value in values:
            self.set(name, value)

    def as_parm(self) -> str:
        """Return all values as the text of a .parm file."""
        return "".join(f"{name} {value:.9g}\n" for name, value in self._values.items())


def checked(name: str, value: float) -> float:
    """Return the value as it is stored. Raises ParameterError for an unknown name or an invalid value."""
    row = BY_NAME.get(name)
    if row is None:
        from difflib import get_close_matches  # lazily, because only a typing error needs it

        close = get_close_matches(name, BY_NAME, n=1, cutoff=0.7)
        hint = f"; did you mean {close[0]}?" if close else ""
        raise ParameterError(f"{name} is not a parameter{hint}")
    return within(row, value)


def checked_parm(text: str, source: str) -> list[tuple[int, str, float]]:
    """Parse like `parm_lines`, with each value as the embedded autopilot stores it. Raises the first refusal."""
    values = []
    for line, name, value in parm_lines(text, source):
        try:
            values.append((line, name, checked(name, value)))
        except ParameterError as error:
            raise ParameterError(f"{source}:{line}: {error}") from None
    return values
