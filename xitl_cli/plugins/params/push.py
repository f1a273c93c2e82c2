"""Setting the parameters of a vehicle, over as many restarts as hidden ones need to appear.

It can also install, by MAVLink FTP, the script that an ArduPilot needs for HIL messages.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import replace

from agent.mavlink.ftp import FtpRefusedError, checksum, has_folder, make_folder, read_checksum, write_file
from agent.mavlink.parameters import same_value
from agent.wire import dialect
from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError
from xitl_cli.params.values import format_value
from xitl_cli.params.vehicle import VehicleConnection, VehicleFiles, connect
from xitl_cli.plugins.params.check import absent_parameter, hiding_parameter, in_names_of
from xitl_cli.shipped import firmware_params_dir

MOST_RESTARTS = 3
MOST_ROUNDS = 6
_CALIBRATED = "INS_ACC_ID"
_AHRS, _PORTS = "EAHRS_TYPE", "SCR_"
_WAITS = "it must be set last, after its port has appeared; add --reboot"
NAME = "xitl_hil.lua"
BOARD_ROOT, BOARD_FOLDER = "/APM", "/APM/scripts"
PLAIN_FOLDER = "scripts"  # on simulated vehicles and Linux boards, relative to the working directory of their program
RESTART_S = 40.0
SETTLE_S = 1.0
RETRY_S = 5.0
LOST_MS = 500.0  # least decrease of its time since boot by a restart
_MAV_CMD_PREFLIGHT_CALIBRATION = 241
_AS_IT_IS = 76.0  # ArduPilot: accept the stored calibration as valid
_ACCEPTED = 0  # MAV_RESULT


@dataclass(frozen=True, slots=True)
class PushedParameter:
    """Result of one parameter."""

    name: str
    wanted: float
    before: float | None
    """Value before the push."""
    kept: float | None
    """Value that the vehicle keeps."""
    reason: str = ""
    """Reason for a refused value; empty if the vehicle accepted it."""


@dataclass(frozen=True, slots=True)
class PushResult:
    """Result of a push."""

    changes: tuple[PushedParameter, ...]
    restarts: int = 0
    script: str = ""
    """Path of the script on the vehicle, empty if none was requested."""
    written: bool = False
    """True if the script is new."""
    restart_due: bool = False
    """True if some changes need a restart and none was requested."""


def push(
    url: str,
    key: bytes | None,
    wanted: Mapping[str, float],
    script: bytes | None = None,
    reboot: bool = False,
    progress: Callable[[str], None] = lambda doing: None,
) -> PushResult:
    """Set differing parameters, and install the script if one is given. `progress` receives the current activity.

    With `reboot`, the vehicle restarts if anything has changed, and parameters that appear then are set too. Raises
    UserError. Refused values are among the changes.
    """
    changes: dict[str, PushedParameter] = {}
    restarts, path, written = 0, "", False
    reached: AbstractContextManager[VehicleConnection] = connect(url, key)
    while True:
        with reached as vehicle:
            if script is not None and vehicle.px4:
                raise UserError(f"{url}: is a PX4, but the script is for ArduPilot; remove --with-script")
            if script is not None and not path:
                path, written = install_script(vehicle, script, lambda done: progress(f"script {done:.0%}"))
            fresh = _set_all(vehicle, wanted, changes)
            refused = any(change.reason for change in changes.values())
            due = fresh or (restarts == 0 and (written or refused))
            if not (reboot and due and restarts < MOST_RESTARTS):
                if not due and (script is not None or _injects_sensors(wanted, changes)):
                    accept_calibration(vehicle)
                return PushResult(tuple(changes.values()), restarts, path, written, due)
            progress("restart")
            boot_ms = restart(vehicle)
        restarts += 1
        progress("parameters")
        reached = restarted(url, key, boot_ms)


def _injects_sensors(wanted: Mapping[str, float], changes: Mapping[str, PushedParameter]) -> bool:
    """Return True if its inertial sensors are external, so that there is nothing to calibrate; only for a whole set."""
    return wanted.get(_AHRS, 0.0) > 0.0 and _CALIBRATED in wanted and not any(one.reason for one in changes.values())


def _set_all(vehicle: VehicleConnection, wanted: Mapping[str, float], changes: dict[str, PushedParameter]) -> bool:
    """Set differing parameters, and newly visible ones, into `changes`. Return True if anything was set."""
    set_some = False
    for _ in range(MOST_ROUNDS):
        present = vehicle.read_all()
        wanted = in_names_of(present, wanted)
        held = _held(wanted, present)
        now = set_differing(vehicle, {name: value for name, value in wanted.items() if name != held}, present)
        for name in [name for name, change in changes.items() if change.reason]:
            del changes[name]
        for change in now:
            changes[change.name] = _explained(change, wanted, present) if change.reason else change
        if held:
            changes[held] = PushedParameter(held, wanted[held], present.get(held), present.get(held), _WAITS)
        if all(change.reason for change in now):
            break
        set_some = True
    return set_some


def _held(wanted: Mapping[str, float], present: Mapping[str, float]) -> str:
    """Return the external AHRS, which must be set last: while its port is hidden, ArduPilot 4.7 crashes at its next
    start.
    """
    if wanted.get(_AHRS, 0.0) <= 0.0 or present.get(_AHRS, 0.0) > 0.0:
        return ""
    still_to_come = any(
        name.startswith(_PORTS) and not (name in present and same_value(present[name], value))
        for name, value in wanted.items()
    )
    return _AHRS if still_to_come else ""


def _explained(change: PushedParameter, wanted: Mapping[str, float], present: Mapping[str, float]) -> PushedParameter:
    switch = hiding_parameter(change.name, wanted, present) if change.before is None else ""
    if not switch:
        return change
    return replace(change, reason=f"it appears after a restart with {switch} on; add --reboot")


def set_differing(
    vehicle: VehicleConnection, wanted: Mapping[str, float], present: Mapping[str, float], complete: bool = True
) -> list[PushedParameter]:
    """Set all differences from `present` and read each back. A refused value raises no error.

    `complete`: `present` has all parameters of the vehicle. Otherwise they are read if a name is missing.
    """
    changes: list[PushedParameter] = []
    if not complete and any(name not in present for name in wanted):
        present = vehicle.read_all()
    for name, value in wanted.items():
        before = present.get(name)
        if before is None:
            reason = absent_parameter(name, value, wanted, present).sentence(format_value)
            changes.append(PushedParameter(name, value, None, None, reason))
        elif not same_value(before, value):
            answer = vehicle.set(name, value)
            if answer.accepts(value):
                changes.append(PushedParameter(name, value, before, answer.kept))
                continue
            kept = "does not answer" if answer.kept is None else f"keeps {format_value(answer.kept)}"
            message = f": {answer.texts[-1]}" if answer.texts else ""
            changes.append(PushedParameter(name, value, before, answer.kept, f"the vehicle {kept}{message}"))
    return changes


# -- script and restart


def shipped_script() -> bytes:
    """Return the script that comes with xitl. Raises UserError."""
    path = firmware_params_dir() / "lua" / NAME
    try:
        return path.read_bytes()
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}); install xitl again") from error


def install_script(
    vehicle: VehicleConnection, content: bytes, progress: Callable[[float], None] = lambda done: None
) -> tuple[str, bool]:
    """Install the script unless it exists. Return its path, and True if it was written. Raises UserError."""
    files = VehicleFiles(vehicle)
    try:
        on_board = files.run(has_folder(BOARD_ROOT))
        folder = BOARD_FOLDER if on_board else PLAIN_FOLDER
        path = f"{folder}/{NAME}"
        wanted = checksum(content)
        if files.run(read_checksum(path)) == wanted:
            return path, False
        files.run(make_folder(folder))
        files.run(write_file(path, content, progress))
        written = files.run(read_checksum(path))
    except FtpRefusedError as refusal:
        raise UserError(
            f"the script cannot be installed on the vehicle: {refusal}; check that it has a memory card"
        ) from None
    if written != wanted:
        raise UserError(f"{path}: is damaged on the vehicle; check its memory card and push again")
    return path, True


def accept_calibration(vehicle: VehicleConnection) -> None:
    """Accept the stored calibration of IMUs and compasses: injected sensors need none. Raises UserError."""
    if vehicle.command(_MAV_CMD_PREFLIGHT_CALIBRATION, 0, _AS_IT_IS, 0, 0, _AS_IT_IS) != _ACCEPTED:
        raise UserError(
            "the vehicle does not accept the calibration of the injected sensors; "
            "disarm it, or choose Force Accel Calibration in a ground station"
        )


def restart(vehicle: VehicleConnection) -> int:
    """Restart the vehicle. Return its time since boot in ms just before. Raises UserError."""
    before = vehicle.request_message(dialect.MAVLINK_MSG_ID_SYSTEM_TIME)
    if vehicle.command(dialect.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1) != _ACCEPTED:
        raise UserError("the vehicle refuses to restart; disarm it, or switch its power off and on")
    return 0 if before is None else int(before.time_boot_ms)


@contextmanager
def restarted(url: str, key: bytes | None, boot_ms: int) -> Iterator[VehicleConnection]:
    """Yield the vehicle after its restart, which happened at `boot_ms` of its time. Raises UserError."""
    asked_s = time.monotonic()
    with ExitStack() as opened:
        while True:
            time.sleep(SETTLE_S)
            try:
                attempt = ExitStack()
                with attempt:
                    vehicle = attempt.enter_context(connect(url, key, RETRY_S))
                    now = vehicle.request_message(dialect.MAVLINK_MSG_ID_SYSTEM_TIME)
                    elapsed_ms = (time.monotonic() - asked_s) * 1000.0
                    if now is not None and now.time_boot_ms < boot_ms + elapsed_ms - LOST_MS:
                        opened.push(attempt.pop_all())
                        break
            except UserError:
                pass
            if time.monotonic() - asked_s > RESTART_S:
                raise UserError(
                    f"{url}: the vehicle did not come back from its restart within {RESTART_S:.0f} s; "
                    "switch its power off and on"
                )
        yield vehicle
