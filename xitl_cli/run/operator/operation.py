"""Operation of a run: who may act in it, its pace, and the actions of an earlier run or a file to repeat."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError
from xitl_cli.profile.schema import Profile
from xitl_cli.run.core.directory import RECORDING


@dataclass(frozen=True, slots=True)
class Operation:
    """Options for the operation of a run."""

    people: tuple[Callable[[Any], object], ...] = ()
    """Sources of actions during the run. Each gets the `OperatorNode` before the run begins."""
    events: tuple[TimedAction, ...] = ()
    """Actions that are repeated."""
    pace: float | None = None
    """Multiple of real time in lockstep; None for as fast as possible."""
    viewed: bool = False
    """The run has a view with a page for actions."""
    ros: bool = False
    """ROS nodes may act."""
    live: bool = False
    """Users may act from Foxglove."""

    @property
    def operated(self) -> bool:
        """Whether the run has an operator."""
        return self._attended or bool(self.events)

    @property
    def paced(self) -> bool:
        """Whether the run may pause or have a pace."""
        return self._attended or self.pace is not None

    @property
    def _attended(self) -> bool:
        return bool(self.people or self.viewed or self.live or self.ros)


UNATTENDED = Operation()


def operation_of(profile: Profile, replay_events: Path | None = None, pace: float | None = None) -> Operation:
    """Return the operation for the options of `xitl sim`. Raises UserError for an invalid file or pace."""
    if pace is not None:
        from xitl_cli.run.operator.actions import ActionError, read_action  # most runs have no actions

        try:
            read_action({"action": "pace", "factor": pace})
        except ActionError as error:
            raise UserError(f"--{error}") from None
        if profile.clock is not None and profile.clock.mode == "realtime":
            raise UserError("--pace has no effect in real time; use --clock lockstep, or remove --pace")
    events = () if replay_events is None else read_events(replay_events)
    return Operation(events=events, pace=pace)


TOPIC = "/operator/action"
SOURCE = "file"


@dataclass(frozen=True, slots=True)
class TimedAction:
    """An action, its instant of simulation time, and its source."""

    time_ns: int
    action: Mapping[str, Any]
    source: str


def read_events(path: Path) -> tuple[TimedAction, ...]:
    """Return the actions of a run's directory, its run.mcap, or a .jsonl file, sorted by their instants.

    A line of a .jsonl file is an action with an additional key `time_s`. Raises UserError for a file that cannot be
    read or has no actions. The error for an invalid action names its line.
    """
    file = path / RECORDING if path.is_dir() else path
    if not file.is_file():
        raise UserError(f"--replay-events {path} does not exist; give a run directory, a .mcap or .jsonl file")
    actions = list(_actions_of_lines(file) if file.suffix == ".jsonl" else _recorded_actions(file))
    if not actions:
        raise UserError(
            f"--replay-events {path} contains no actions; record a run with --view or --live-commands and act in it"
        )
    return tuple(sorted(actions, key=lambda action: action.time_ns))


def _recorded_actions(file: Path) -> Iterator[TimedAction]:
    from xitl_cli.logs import LogError, open_log

    try:
        with open_log(file) as log:
            if TOPIC not in log:
                return
            table = log[TOPIC]
            for time_ns, text, source in zip(table.stamp_ns, table["action"], table["source"], strict=True):
                yield _checked(int(time_ns), json.loads(str(text)), str(source), str(file))
    except (LogError, ValueError, RecursionError) as error:
        raise UserError(
            f"--replay-events {file} cannot be read ({error}); give a run directory, a .mcap or .jsonl file"
        ) from error


def _actions_of_lines(file: Path) -> Iterator[TimedAction]:
    try:
        lines = file.read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError) as error:
        raise UserError(f"--replay-events {file} cannot be read ({error})") from error
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        where = f"{file}:{number}"
        try:
            action = json.loads(line)
        except (ValueError, RecursionError) as error:
            raise UserError(f"{where}: no JSON ({error}); write one JSON object per line") from None
        time_s = action.pop("time_s", None) if isinstance(action, dict) else None
        if not isinstance(time_s, (int, float)) or isinstance(time_s, bool) or not 0 <= time_s < 1e9:
            raise UserError(f"{where}: time_s is missing or invalid; add the simulation time in seconds, from 0")
        source = action.pop("source", SOURCE)
        yield _checked(round(time_s * 1e9), action, str(source), where)


def _checked(time_ns: int, action: Any, source: str, where: str) -> TimedAction:
    """Check the keys that depend on nothing else, before the run."""
    from xitl_cli.run.operator.actions import ENVIRONMENT, ActionError, action_name, read_action

    try:
        name = action_name(action)
        if name not in ENVIRONMENT:
            read_action(action)
    except ActionError as error:
        raise UserError(f"{where}: {error}") from None
    return TimedAction(time_ns, action, source)
