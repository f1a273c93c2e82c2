"""Bringing a vehicle to a set of parameters, over as many restarts as it takes for hidden ones to appear."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace

from xitl_cli.params.check import hidden
from xitl_cli.params.compare import Change
from xitl_cli.params.compare import push as push_values
from xitl_cli.params.script import accept_calibration, install, restart, restarted
from xitl_cli.params.text import same
from xitl_cli.params.vehicle import Vehicle, connected

MOST_RESTARTS = 3
MOST_ROUNDS = 6
_AHRS, _PORTS = "EAHRS_TYPE", "SCR_"
_WAITS = "it comes last, when the port that it listens at is there; add --reboot"


@dataclass(frozen=True, slots=True)
class Brought:
    """What was done. `script` is its path on the vehicle, empty when none was asked for; `written` whether it was new.

    `restart_due` when something of it is in force after a restart only, and none was asked for.
    """

    changes: tuple[Change, ...]
    restarts: int = 0
    script: str = ""
    written: bool = False
    restart_due: bool = False


def bring(
    url: str,
    key: bytes | None,
    wanted: Mapping[str, float],
    script: bytes | None = None,
    reboot: bool = False,
    progress: Callable[[str], None] = lambda doing: None,
) -> Brought:
    """Set what differs, and bring the script there if one is given. `progress` hears what is being done.

    With `reboot` the vehicle restarts when anything has changed, and what appears then is set too. Raises UserError;
    what the vehicle refuses is among the changes.
    """
    changes: dict[str, Change] = {}
    restarts, path, written = 0, "", False
    reached: AbstractContextManager[Vehicle] = connected(url, key)
    while True:
        with reached as vehicle:
            if script is not None and not path:
                path, written = install(vehicle, script, lambda done: progress(f"script {done:.0%}"))
            fresh = _set_all(vehicle, wanted, changes)
            refused = any(change.reason for change in changes.values())
            due = fresh or (restarts == 0 and (written or refused))
            if not (reboot and due and restarts < MOST_RESTARTS):
                if script is not None and not due:
                    accept_calibration(vehicle)
                return Brought(tuple(changes.values()), restarts, path, written, due)
            progress("restart")
            boot_ms = restart(vehicle)
        restarts += 1
        progress("parameters")
        reached = restarted(url, key, boot_ms)


def _set_all(vehicle: Vehicle, wanted: Mapping[str, float], changes: dict[str, Change]) -> bool:
    """Set what differs, and what appears by that, into `changes`; whether anything was set."""
    set_some = False
    for _ in range(MOST_ROUNDS):
        present = vehicle.read_all()
        held = _held(wanted, present)
        now = push_values(vehicle, {name: value for name, value in wanted.items() if name != held}, present)
        for name in [name for name, change in changes.items() if change.reason]:
            del changes[name]
        for change in now:
            changes[change.name] = _explained(change, wanted, present) if change.reason else change
        if held:
            changes[held] = Change(held, wanted[held], present.get(held), present.get(held), _WAITS)
        if all(change.reason for change in now):
            break
        set_some = True
    return set_some


def _held(wanted: Mapping[str, float], present: Mapping[str, float]) -> str:
    """The external AHRS comes last: with its port still to appear, ArduPilot 4.7 crashes at its next start."""
    if wanted.get(_AHRS, 0.0) <= 0.0 or present.get(_AHRS, 0.0) > 0.0:
        return ""
    still_to_come = any(
        name.startswith(_PORTS) and not (name in present and same(present[name], value))
        for name, value in wanted.items()
    )
    return _AHRS if still_to_come else ""


def _explained(change: Change, wanted: Mapping[str, float], present: Mapping[str, float]) -> Change:
    switch = hidden(change.name, wanted, present) if change.before is None else ""
    if not switch:
        return change
    return replace(change, reason=f"it appears after a restart with {switch} on; add --reboot")
