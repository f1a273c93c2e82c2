"""Settings of ground stations that persist over a restart: parameters, mission and fence in one JSON file.

A separate thread replaces the complete file. The control loop only hands over the content.
"""

from __future__ import annotations

import json
import os
import threading
from pathlib import Path
from typing import Any, NamedTuple

from agent.fcu.fence import FenceItem
from agent.fcu.mission import CHANGE_SPEED, JUMP, MissionError, MissionItem, make_mission
from agent.fcu.vehicle.autopilot import Autopilot
from agent.fcu.vehicle_state import ERROR, WARNING
from agent.files import read_text
from agent.mavlink.parameter_rows import ParameterError

FORMAT = 2
_FORMATS = (1, 2)  # format 1 stored only some fields of mission items


class StorageError(ValueError):
    """Raised for a refused file. The message says which file, why and what to do."""


class _Contents(NamedTuple):
    parameters: dict[str, float]
    mission: tuple[MissionItem, ...]
    fence: tuple[FenceItem, ...]


class Storage:
    """Implements `SettingsStorage`. The constructor raises StorageError. A failed write becomes an event."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._contents = _read(path)
        self._problem = ""
        self._changed = threading.Condition()
        self._wanted: _Contents | None = None
        self._busy = False
        self._closing = False
        self._thread = threading.Thread(target=self._write_on, name="storage", daemon=True)
        self._thread.start()

    def apply(self, autopilot: Autopilot) -> None:
        """Apply the stored settings. Omit invalid ones for this version, with an event."""
        contents = self._contents
        for name, value in contents.parameters.items():
            try:
                autopilot.parameters.set(name, value)
            except ParameterError as error:
                autopilot.events.add(WARNING, f"{self.path.name}: {error}")
        try:
            autopilot.commands.set_mission(make_mission(contents.mission))
        except MissionError as error:
            autopilot.events.add(WARNING, f"{self.path.name}: {error}")
        if contents.fence:
            refused = autopilot.commands.set_fence(list(contents.fence))
            if refused:
                autopilot.events.add(WARNING, f"{self.path.name}: {refused}")

    def keep_parameter(self, name: str, value: float) -> None:
        self._keep(self._contents._replace(parameters={**self._contents.parameters, name: value}))

    def keep_all_parameters(self, autopilot: Autopilot) -> None:
        values = {name: autopilot.parameters[name] for name in autopilot.parameters}
        self._keep(self._contents._replace(parameters=values))

    def keep_plan(self, autopilot: Autopilot) -> None:
        self._keep(
            self._contents._replace(mission=autopilot.navigator.mission.items, fence=tuple(autopilot.fence.items))
        )

    def forget_parameters(self, autopilot: Autopilot) -> None:
        defaults = type(autopilot.parameters)()
        for name in self._contents.parameters:
            if name in defaults:
                autopilot.parameters.set(name, defaults[name])
        self._keep(self._contents._replace(parameters={}))

    def report(self, autopilot: Autopilot) -> None:
        """Add an event, once, when a write has failed."""
        problem, self._problem = self._problem, ""
        if problem:
            autopilot.events.add(ERROR, problem)

    def flush(self) -> None:
        """Wait until everything is written."""
        with self._changed:
            self._changed.wait_for(lambda: self._wanted is None and not self._busy, timeout=10.0)

    def close(self) -> None:
        """Write the remaining content and end the thread."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._thread.join(timeout=10.0)

    def _keep(self, contents: _Contents) -> None:
        self._contents = contents
        with self._changed:
            self._wanted = contents
            self._changed.notify_all()

    def _write_on(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._wanted is not None or self._closing)
                contents, self._wanted = self._wanted, None
                if contents is None:
                    return
                self._busy = True
            try:
                _write(self.path, contents)
            except OSError as error:
                self._problem = f"{self.path}: not written ({error.strerror}); the settings will be lost at a restart"
            with self._changed:
                self._busy = False
                self._changed.notify_all()


def _write(path: Path, contents: _Contents) -> None:
    """Write the file atomically: under another name, then moved into place."""
    document = {
        "format": FORMAT,
        "parameters": contents.parameters,
        "mission": [item._asdict() for item in contents.mission],
        "fence": [item._asdict() for item in contents.fence],
    }
    new = path.with_name(path.name + ".new")
    with new.open("w") as file:
        json.dump(document, file, indent=1)
        file.write("\n")
        file.flush()
        os.fsync(file.fileno())
    new.replace(path)


def _read(path: Path) -> _Contents:
    try:
        text = read_text(path)
    except FileNotFoundError:
        if not path.parent.is_dir():
            raise StorageError(f"{path}: there is no folder {path.parent}; create it or choose another file") from None
        return _Contents({}, (), ())
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not text"
        raise StorageError(f"{path}: cannot be read ({reason}); check the path") from None
    try:
        document = json.loads(text)
        if document["format"] not in _FORMATS:
            raise StorageError(f"{path}: has format {document['format']}, this release reads {FORMAT}; move it away")
        return _Contents(
            {str(name): float(value) for name, value in document["parameters"].items()},
            tuple(_mission_item(fields) for fields in document["mission"]),
            tuple(_fence_item(fields) for fields in document["fence"]),
        )
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError, RecursionError) as error:
        if isinstance(error, StorageError):
            raise
        reason = f"{type(error).__name__}: {error}"
        raise StorageError(f"{path}: is not a storage file ({reason}); move it away to start with defaults") from None


def _mission_item(fields: Any) -> MissionItem:
    """Return an item of either format. Format 1 stored each command's own fields instead of its parameters."""
    command = int(fields["command"])
    lat_deg, lon_deg, alt_m = (float(fields.get(name, 0.0)) for name in ("lat_deg", "lon_deg", "alt_m"))
    named = {CHANGE_SPEED: ("", "speed_mps"), JUMP: ("jump_seq", "repeats")}.get(command, ("hold_s", ""))
    first, second, third, fourth = fields.get("parameters", (*(fields.get(name, 0.0) for name in named), 0.0, 0.0))
    parameters = (float(first), float(second), float(third), float(fourth))
    return MissionItem(command, lat_deg, lon_deg, alt_m, parameters, int(fields.get("frame", 3)))


def _fence_item(fields: Any) -> FenceItem:
    whole = {"command", "vertex_count"}
    numbers: dict[str, Any] = {name: int(value) if name in whole else float(value) for name, value in fields.items()}
    return FenceItem(**numbers)
