"""Missions: the items that ArduRover accepts, with ArduPilot's numbers and names. Item 0 is the home position.

An item is stored unchanged, so that a download returns the same item. `agent.fcu.vehicle.mission_progress` and
`agent.fcu.vehicle.commands` execute the commands.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

WAYPOINT = 16  # MAV_CMD_NAV_WAYPOINT
LOITER_UNLIMITED = 17  # MAV_CMD_NAV_LOITER_UNLIM
LOITER_TURNS = 18  # MAV_CMD_NAV_LOITER_TURNS
LOITER_TIME = 19  # MAV_CMD_NAV_LOITER_TIME
RETURN_HOME = 20  # MAV_CMD_NAV_RETURN_TO_LAUNCH
GUIDED_ENABLE = 92  # MAV_CMD_NAV_GUIDED_ENABLE
DELAY = 93  # MAV_CMD_NAV_DELAY
CONDITION_DELAY = 112  # MAV_CMD_CONDITION_DELAY
CONDITION_DISTANCE = 114  # MAV_CMD_CONDITION_DISTANCE
JUMP = 177  # MAV_CMD_DO_JUMP
CHANGE_SPEED = 178  # MAV_CMD_DO_CHANGE_SPEED
SET_HOME = 179  # MAV_CMD_DO_SET_HOME
SET_SERVO = 183  # MAV_CMD_DO_SET_SERVO
REPEAT_SERVO = 184  # MAV_CMD_DO_REPEAT_SERVO
SET_REVERSE = 194  # MAV_CMD_DO_SET_REVERSE
FENCE_ENABLE = 207  # MAV_CMD_DO_FENCE_ENABLE
SET_YAW_SPEED = 213  # MAV_CMD_NAV_SET_YAW_SPEED
AUX_FUNCTION = 218  # MAV_CMD_DO_AUX_FUNCTION
GUIDED_LIMITS = 222  # MAV_CMD_DO_GUIDED_LIMITS
JUMP_TAG = 600  # MAV_CMD_JUMP_TAG: the tag
DO_JUMP_TAG = 601  # MAV_CMD_DO_JUMP_TAG: the jump to it
MOST_ITEMS = 724  # as in ArduRover on a board with 16 KiB of storage
FOREVER = -1
_MOST_ALTITUDE_M = 83000.0

PASSAGES = (WAYPOINT, LOITER_UNLIMITED, LOITER_TURNS, LOITER_TIME, RETURN_HOME)  # motions along a line or a circle
STAGES = (*PASSAGES, GUIDED_ENABLE, DELAY, SET_YAW_SPEED)  # executed one after the other
PERFORMED = (
    *STAGES,
    CONDITION_DELAY,
    CONDITION_DISTANCE,
    JUMP,
    CHANGE_SPEED,
    SET_HOME,
    SET_SERVO,
    REPEAT_SERVO,
    SET_REVERSE,
    FENCE_ENABLE,
    AUX_FUNCTION,
    GUIDED_LIMITS,
    JUMP_TAG,
    DO_JUMP_TAG,
)
"""Commands that the embedded autopilot executes. It skips all other commands of COMMANDS."""


class MissionCommand(NamedTuple):
    """A command that ArduRover accepts in a mission."""

    name: str
    """Name in ArduPilot's texts."""
    parameters: int = 0
    """Number of parameters in use."""
    has_place: bool = False
    """Whether x, y and z are a position."""
    device: str = ""
    """Device that the command needs and that this vessel does not have."""


COMMANDS: Mapping[int, MissionCommand] = {
    WAYPOINT: MissionCommand("WP", 1, True),
    LOITER_UNLIMITED: MissionCommand("LoitUnlim", 0, True),
    LOITER_TURNS: MissionCommand("LoitTurns", 3, True),
    LOITER_TIME: MissionCommand("LoitTime", 1, True),
    RETURN_HOME: MissionCommand("RTL"),
    21: MissionCommand("Land", 1, True),
    22: MissionCommand("Takeoff", 1, True),
    30: MissionCommand("ContinueAndChangeAlt", 1, True),
    31: MissionCommand("LoitAltitude", 2, True),
    82: MissionCommand("SplineWP", 1, True),
    83: MissionCommand("AltitudeWait", 3),
    84: MissionCommand("VTOLTakeoff", 0, True),
    85: MissionCommand("VTOLLand", 1, True),
    GUIDED_ENABLE: MissionCommand("GuidedEnable", 1, True),
    DELAY: MissionCommand("Delay", 4),
    94: MissionCommand("PayloadPlace", 1, True),
    CONDITION_DELAY: MissionCommand("CondDelay", 1),
    CONDITION_DISTANCE: MissionCommand("CondDist", 1),
    115: MissionCommand("CondYaw", 4),
    JUMP: MissionCommand("Jump", 2),
    CHANGE_SPEED: MissionCommand("ChangeSpeed", 2),
    SET_HOME: MissionCommand("SetHome", 1, True),
    181: MissionCommand("SetRelay", 2, device="relay"),
    182: MissionCommand("RepeatRelay", 3, device="relay"),
    SET_SERVO: MissionCommand("SetServo", 2),
    REPEAT_SERVO: MissionCommand("RepeatServo", 4),
    188: MissionCommand("ReturnPathStart", 0, True),
    189: MissionCommand("LandStart", 0, True),
    191: MissionCommand("Go Around", 0, True),
    193: MissionCommand("PauseContinue", 1),
    SET_REVERSE: MissionCommand("SetReverse", 1),
    195: MissionCommand("SetROILocation", 1, True, "mount"),
    197: MissionCommand("SetROINone", 1, device="mount"),
    201: MissionCommand("SetROI", 1, True, "mount"),
    202: MissionCommand("DigiCamCfg", 4, device="camera"),
    203: MissionCommand("DigiCamCtrl", 4, device="camera"),
    205: MissionCommand("MountControl", 3, device="mount"),
    206: MissionCommand("SetCamTrigDst", 3, device="camera"),
    FENCE_ENABLE: MissionCommand("FenceEnable", 1),
    208: MissionCommand("Parachute", 1, device="parachute"),
    210: MissionCommand("InvertedFlight", 1),
    211: MissionCommand("Gripper", 2, device="gripper"),
    212: MissionCommand("AutoTuneEnable", 1),
    SET_YAW_SPEED: MissionCommand("SetYawSpd", 3),
    215: MissionCommand("SetRepeatDist", 1),
    216: MissionCommand("Sprayer", 1, device="sprayer"),
    217: MissionCommand("Scripting", 4, device="script"),
    AUX_FUNCTION: MissionCommand("AuxFunction", 2),
    GUIDED_LIMITS: MissionCommand("GuidedLimits", 4),
    223: MissionCommand("EngineControl", 4, device="engine control"),
    531: MissionCommand("SetCameraZoom", 2, device="camera"),
    532: MissionCommand("SetCameraFocus", 2, device="camera"),
    534: MissionCommand("SetCameraSource", 3, device="camera"),
    JUMP_TAG: MissionCommand("Tag", 1),
    DO_JUMP_TAG: MissionCommand("JumpToTag", 2),
    1000: MissionCommand("GimbalPitchYaw", 0, device="mount"),
    2000: MissionCommand("ImageStartCapture", 4, device="camera"),
    2001: MissionCommand("ImageStopCapture", 1, device="camera"),
    2500: MissionCommand("VideoStartCapture", 1, device="camera"),
    2501: MissionCommand("VideoStopCapture", 1, device="camera"),
    3000: MissionCommand("VTOLTransition", 1),
    42600: MissionCommand("Winch", 4, device="winch"),
    42702: MissionCommand("NavScriptTime", 4, device="script"),
    42703: MissionCommand("NavAttitudeTime", 4),
}
"""Commands that AP_Mission of ArduPilot 4.7 stores, by number. Commands outside PERFORMED are skipped."""


class MissionItem(NamedTuple):
    """One item, with MAVLink's param1 to param4 in `parameters`.

    Latitude and longitude that are both zero mean the position of the vessel, as in ArduPilot.
    """

    command: int
    lat_deg: float = 0.0
    lon_deg: float = 0.0
    alt_m: float = 0.0
    parameters: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    frame: int = 3
    """MAV_FRAME, the reference of the altitude: 0 mean sea level, 3 home, 10 the ground. A boat ignores it."""

    @property
    def name(self) -> str:
        """Name as in ArduPilot's texts."""
        return COMMANDS[self.command].name

    @property
    def place(self) -> tuple[float, float] | None:
        """Latitude and longitude, None for the position of the vessel."""
        return (self.lat_deg, self.lon_deg) if self.lat_deg != 0.0 or self.lon_deg != 0.0 else None

    @property
    def stay_s(self) -> float:
        """Time to stay at a WAYPOINT or LOITER_TIME, in s. Infinite for a LOITER_UNLIMITED."""
        if self.command == LOITER_UNLIMITED:
            return math.inf
        return max(0.0, self.parameters[0]) if self.command in (WAYPOINT, LOITER_TIME) else 0.0


class ItemProblem(NamedTuple):
    """Error of an item."""

    field: int
    """1 to 7 of MAVLink's param1 to z, 0 for the command itself."""
    text: str


class MissionError(ValueError):
    """Raised for a refused mission. The message names the item."""


def waypoint(lat_deg: float, lon_deg: float, alt_m: float = 0.0, hold_s: float = 0.0) -> MissionItem:
    """Return an item: go to a position and stay for `hold_s`."""
    return MissionItem(WAYPOINT, lat_deg, lon_deg, alt_m, (hold_s, 0.0, 0.0, 0.0))


def change_speed(speed_mps: float) -> MissionItem:
    """Return an item: set the speed over ground of the following legs."""
    return MissionItem(CHANGE_SPEED, parameters=(1.0, speed_mps, -1.0, 0.0))


def jump(seq: int, repeats: int) -> MissionItem:
    """Return an item: continue with item `seq`, `repeats` times or FOREVER."""
    return MissionItem(JUMP, parameters=(float(seq), float(repeats), 0.0, 0.0))


class MissionSequence(NamedTuple):
    """A checked sequence. `items[0]` is home and never a target. Build it with `make_mission`."""

    items: tuple[MissionItem, ...] = ()

    def waypoints(self) -> tuple[int, ...]:
        """Sequence numbers of the stages: items that move the vessel, make it stay or wait, or turn it."""
        return tuple(seq for seq, item in enumerate(self.items) if seq > 0 and item.command in STAGES)

    def next_waypoint(self, seq: int) -> int | None:
        """Return the first stage at or after `seq`, without home and jumps."""
        for candidate in range(max(seq, 1), len(self.items)):
            if self.items[candidate].command in STAGES:
                return candidate
        return None

    def tagged(self, tag: int) -> int:
        """Return the first item with this tag, 0 for none."""
        for seq, item in enumerate(self.items):
            if seq > 0 and item.command == JUMP_TAG and int(item.parameters[0]) == tag:
                return seq
        return 0


def make_mission(items: list[MissionItem] | tuple[MissionItem, ...]) -> MissionSequence:
    """Check the items, home first. Raises MissionError. One item or none is the empty mission."""
    if len(items) > MOST_ITEMS:
        raise MissionError(f"mission has {len(items)} items; at most {MOST_ITEMS} fit")
    for seq, item in enumerate(items):
        problem = item_problem(item)
        if problem and seq > 0:
            raise MissionError(f"mission item {seq}: {problem.text}")
        if item.command == JUMP and seq > 0 and not 1 <= int(item.parameters[0]) < len(items):
            raise MissionError(f"mission item {seq}: jump to item {item.parameters[0]:g}; use 1 to {len(items) - 1}")
    return MissionSequence(tuple(items) if len(items) > 1 else ())


def item_problem(item: MissionItem) -> ItemProblem | None:
    """Return the error of an item as ArduRover reports it, None for a valid one.

    NaN in unused parameters is accepted.
    """
    command = COMMANDS.get(item.command)
    if command is None:
        return ItemProblem(0, f"command {item.command} is not supported; use those of ArduRover's missions")
    for number, value in enumerate(item.parameters, start=1):
        if math.isinf(value) or (math.isnan(value) and number <= command.parameters):
            return ItemProblem(number, f"parameter {number} of {command.name} is {value:g}; use a number")
    if not command.has_place:
        return None
    for field, value, limit in ((5, item.lat_deg, 90.0), (6, item.lon_deg, 180.0)):
        if not abs(value) <= limit:
            return ItemProblem(field, f"position {item.lat_deg:g}, {item.lon_deg:g} is not on Earth; use degrees")
    if not abs(item.alt_m) < _MOST_ALTITUDE_M:
        return ItemProblem(7, f"altitude {item.alt_m:g} m is not valid; use 0")
    return None
