"""Actions of an earlier run or of a file, with the instants at which to repeat them."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from xitl_cli.errors import UserError
from xitl_cli.run.core.directory import RECORDING
from xitl_cli.run.operator.actions import ENVIRONMENT, ActionError, action_name, read_action

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
        raise UserError(
            f"--replay-events {path}: there is no such recording; give a run's directory, a .mcap or .jsonl"
        )
    found = list(_lines(file) if file.suffix == ".jsonl" else _recorded(file))
    if not found:
        raise UserError(f"--replay-events {path}: nobody acted in it; a run with --view or --live records what is done")
    return tuple(sorted(found, key=lambda each: each.time_ns))


def _recorded(file: Path) -> Iterator[TimedAction]:
    from xitl_cli.logs import LogError, open_log

    try:
        with open_log(file) as log:
            if TOPIC not in log:
                return
            table = log[TOPIC]
            for time_ns, text, source in zip(table.stamp_ns, table["action"], table["source"], strict=True):
                yield _checked(int(time_ns), json.loads(str(text)), str(source), str(file))
    except (LogError, ValueError) as error:
        raise UserError(
            f"--replay-events {file}: cannot be read ({error}); give a run's directory, a .mcap or .jsonl"
        ) from error


def _lines(file: Path) -> Iterator[TimedAction]:
    try:
        lines = file.read_text(encoding="utf-8").splitlines()
    except (OSError, ValueError) as error:
        raise UserError(f"--replay-events {file}: cannot be read ({error})") from error
    for number, line in enumerate(lines, start=1):
        if not line.strip():
            continue
        where = f"{file}:{number}"
        try:
            action = json.loads(line)
        except ValueError as error:
            raise UserError(f"{where}: is no JSON ({error}); write one action a line") from None
        time_s = action.pop("time_s", None) if isinstance(action, dict) else None
        if not isinstance(time_s, (int, float)) or isinstance(time_s, bool) or not 0 <= time_s < 1e9:
            raise UserError(f"{where}: needs time_s, seconds of simulation time from 0 on, beside the action's keys")
        source = action.pop("source", SOURCE)
        yield _checked(round(time_s * 1e9), action, str(source), where)


def _checked(time_ns: int, action: Any, source: str, where: str) -> TimedAction:
    """Check the keys that depend on nothing else, before the run."""
    try:
        name = action_name(action)
        if name not in ENVIRONMENT:
            read_action(action)
    except ActionError as error:
        raise UserError(f"{where}: {error}") from None
    return TimedAction(time_ns, action, source)
