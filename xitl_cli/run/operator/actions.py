"""Actions: JSON objects with a name, `action`, and its keys; names, bounds and errors are as for a profile's keys.

    {"action": "wind", "mean_mps": 6, "direction_deg": 90}

    action = read_action({"action": "launch", "kind": "trunk", "north_m": 5, "east_m": 60})

Actions of the environment have the keys of the profile's group. Missing keys keep their values.
"""

from __future__ import annotations

import difflib
from collections.abc import Mapping
from dataclasses import asdict
from typing import Annotated, Any, Literal

from sim_core.dataclass import dataclass
from sim_core.environment.spec import CurrentSpec, WaveSpec, WindSpec
from sim_core.keys import Bounds, Direction, Items, Positive, Specification, SpecificationError, key_annotations
from sim_core.world.spec import DebrisName
from xitl_cli.errors import UserError
from xitl_cli.profile.files.entry import Entry, Origin, ProfileError
from xitl_cli.profile.reader import read_group
from xitl_cli.profile.schema.faults import AgentName, Delay, LinkFault

Way = Annotated[float, Bounds(at_least=-100_000, at_most=100_000)]
MOST_WAYPOINTS = 700  # limit of an ArduRover
ENVIRONMENT: Mapping[str, type[Specification]] = {"wind": WindSpec, "current": CurrentSpec, "waves": WaveSpec}


class ActionError(UserError):
    """An action that is not possible, with the reason in one sentence."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Pause(Specification):
    """Pause from the next exchange on."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Resume(Specification):
    """Continue the run."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Step(Specification):
    """Run for a while, then pause again."""

    seconds: Annotated[float, Bounds(above=0, at_most=3600)] = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class ChangePace(Specification):
    """Set the speed of the simulation time."""

    factor: Annotated[
        Annotated[float, Bounds(at_least=0.01, at_most=1000)] | None, "times real time; null: as fast as it can"
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class LaunchBody(Specification):
    """Put a body into the water."""

    kind: DebrisName = "trunk"
    north_m: Way
    east_m: Way
    heading_deg: Direction = 0.0
    length_m: Annotated[Positive | None, "null: the usual length of its kind"] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ImpairLink(Specification):
    """Impair a link to an agent, frame by frame; without more keys it is good again."""

    vessel: Annotated[str, "of several"] = ""
    link: AgentName = "agent"
    direction: Literal["both", "sensors", "actuators"] = "both"
    delay_s: Delay = 0.0
    jitter_s: Delay = 0.0
    loss: Annotated[float, Bounds(at_least=0, at_most=1)] = 0.0
    duplicate: Annotated[float, Bounds(at_least=0, at_most=1)] = 0.0
    reorder: Annotated[float, Bounds(at_least=0, at_most=1)] = 0.0
    cut: bool = False

    def fault(self) -> LinkFault | None:
        """Return the fault as in a profile; None for a good link."""
        values = {key: value for key, value in asdict(self).items() if key not in ("vessel", "link")}
        fault = LinkFault(which=self.link, **values)
        return None if fault == LinkFault(which=self.link, direction=self.direction) else fault


@dataclass(frozen=True, slots=True, kw_only=True)
class SwitchFault(Specification):
    """Begin or end a fault of the profile, or a shipped one, now."""

    name: str
    on: bool = True
    vessel: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Arm(Specification):
    """Arm or disarm, as a ground station does."""

    armed: bool = True
    vessel: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChangeMode(Specification):
    """Change the mode, as a ground station does."""

    mode: str
    vessel: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class GoTo(Specification):
    """Go to a place in GUIDED."""

    north_m: Way
    east_m: Way
    vessel: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class SteerVelocity(Specification):
    """Steer with a speed over ground and a turn rate, as long as they are repeated."""

    speed_mps: Annotated[Annotated[float, Bounds(at_least=-100, at_most=100)], "ahead, negative astern"]
    turn_rate_radps: Annotated[Annotated[float, Bounds(at_least=-10, at_most=10)], "positive to starboard"]
    vessel: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class CommandMotor(Specification):
    """Command a motor of a vessel without an autopilot directly, as long as the command is repeated."""

    number: Annotated[Annotated[int, Bounds(at_least=0, at_most=99)], "of propellers, then gears, then rudders, from 0"]
    command: Annotated[float, Bounds(at_least=-1, at_most=1)]
    vessel: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChangeMission(Specification):
    """Start the mission on board from its beginning, clear it, or put waypoints in its place."""

    do: Literal["start", "clear", "replace"] = "start"
    waypoints_ned_m: Annotated[
        tuple[tuple[Way, Way], ...], Items(0, MOST_WAYPOINTS), "of replace: a list of [north, east]"
    ] = ()
    vessel: str = ""

    def check(self) -> None:
        if (self.do == "replace") != bool(self.waypoints_ned_m):
            problem = "is for do: replace alone" if self.waypoints_ned_m else "is empty; give a list of [north, east]"
            raise SpecificationError(("waypoints_ned_m",), problem)


@dataclass(frozen=True, slots=True, kw_only=True)
class EndRun(Specification):
    """End the run of a vessel that `driver.kind: ros` drives, which has no other end."""

    vessel: str = ""


GROUPS: Mapping[str, type[Specification]] = {
    "pause": Pause,
    "resume": Resume,
    "step": Step,
    "pace": ChangePace,
    **ENVIRONMENT,
    "launch": LaunchBody,
    "link": ImpairLink,
    "fault": SwitchFault,
    "arm": Arm,
    "mode": ChangeMode,
    "goto": GoTo,
    "velocity": SteerVelocity,
    "motor": CommandMotor,
    "mission": ChangeMission,
    "end": EndRun,
}
STEERED = ("arm", "mode", "goto", "velocity", "motor", "mission")
"""Orders to a vessel."""
STREAMED = ("velocity", "motor")
"""Orders that programs repeat many times a second. The latest before an exchange counts, and none is logged."""
OF_PACE = ("pause", "resume", "step", "pace")
"""Actions that do not affect the result."""


def action_name(action: object) -> str:
    """Return the name of the action. Raises ActionError for an unknown one."""
    if not isinstance(action, Mapping):
        raise ActionError('an action is a JSON object with the key "action", such as {"action": "pause"}')
    name = action.get("action")
    if not isinstance(name, str) or name not in GROUPS:
        close = difflib.get_close_matches(name, GROUPS, n=1) if isinstance(name, str) else []
        hint = f"did you mean {close[0]!r}? " if close else ""
        raise ActionError(f"action = {name!r} is not one; {hint}use {', '.join(GROUPS)}")
    return name


def read_action(action: Mapping[str, Any], before: Specification | None = None) -> Specification:
    """Return the action's keys, checked. `before`: the group of the environment that the action changes.

    Raises ActionError.
    """
    name = action_name(action)
    changes = {key: value for key, value in action.items() if key != "action"}
    group: Any = GROUPS[name]
    keys: dict[str, Any] = key_annotations(group)
    if name in ENVIRONMENT and not changes:
        raise ActionError(f"{name} changes nothing; give it a key of environment.{name}, such as {next(iter(keys))}")
    known: dict[str, Any] = {} if before is None else _plain(before)
    try:
        values: Specification = read_group(_entry({**known, **_merged(known, changes)}), group, name)
    except ProfileError as error:
        sentence = error.problems[0].sentence.replace("the profile needs", "it needs")
        if not keys:
            sentence = sentence.replace("known keys: ", "it has no keys")
        raise ActionError(f"{name}: {sentence}") from None
    return values


def _plain(value: Any) -> Any:
    """Convert groups to dicts at all levels."""
    if isinstance(value, Specification):
        group: Any = type(value)
        return {key: _plain(getattr(value, key)) for key in key_annotations(group)}
    return tuple(map(_plain, value)) if isinstance(value, tuple) else value


def _merged(known: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """Merge `changes` into `known`. Groups within a group keep the missing keys."""
    return {
        key: {**known[key], **_merged(known[key], value)}
        if isinstance(value, Mapping) and isinstance(known.get(key), dict)
        else value
        for key, value in changes.items()
    }


_ORIGIN = Origin("action")


def _entry(value: Any) -> Entry:
    if isinstance(value, Mapping):
        return Entry({str(key): _entry(below) for key, below in value.items()}, _ORIGIN)
    if isinstance(value, (list, tuple)):
        return Entry(tuple(map(_entry, value)), _ORIGIN)
    return Entry(value, _ORIGIN)
