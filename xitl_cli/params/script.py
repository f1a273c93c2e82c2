"""The script that an ArduPilot needs for HIL messages: brought there by MAVLink FTP, verified, started anew."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

from agent.wire import dialect
from xitl_cli.errors import UserError
from xitl_cli.params.ftp import Files, RefusedError, checksum
from xitl_cli.params.vehicle import Vehicle, connected
from xitl_cli.shipped import firmware_params_dir

NAME = "xitl_hil.lua"
BOARD_ROOT, BOARD_FOLDER = "/APM", "/APM/scripts"
PLAIN_FOLDER = "scripts"  # of simulated vehicles and Linux boards: where their program runs
RESTART_S = 40.0
SETTLE_S = 1.0
RETRY_S = 5.0
LOST_MS = 500.0  # of its time since boot, at least, by a restart
_MAV_CMD_PREFLIGHT_CALIBRATION = 241
_AS_IT_IS = 76.0  # ArduPilot: take the calibration that is stored for a valid one
_ACCEPTED = 0  # MAV_RESULT


def shipped_script() -> bytes:
    """The script that comes with xitl. Raises UserError."""
    path = firmware_params_dir() / "lua" / NAME
    try:
        return path.read_bytes()
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}); install xitl again") from error


def install(
    vehicle: Vehicle, content: bytes, progress: Callable[[float], None] = lambda done: None
) -> tuple[str, bool]:
    """Bring the script there, unless it is there: its path, and whether it was written. Raises UserError."""
    files = Files(vehicle)
    try:
        on_board = files.has_folder(BOARD_ROOT)
        folder = BOARD_FOLDER if on_board else PLAIN_FOLDER
        path = f"{folder}/{NAME}"
        wanted = checksum(content)
        if files.checksum(path) == wanted:
            return path, False
        files.make_folder(folder)
        files.write(path, content, progress)
        found = files.checksum(path)
    except RefusedError as refusal:
        raise UserError(
            f"the script could not be brought to the vehicle: {refusal}; check that it has a memory card"
        ) from None
    if found != wanted:
        raise UserError(f"{path}: came out damaged on the vehicle; check its memory card and push again")
    return path, True


def accept_calibration(vehicle: Vehicle) -> None:
    """Have the stored calibration of IMUs and compasses taken for good: injected ones need none. Raises UserError."""
    if vehicle.command(_MAV_CMD_PREFLIGHT_CALIBRATION, 0, _AS_IT_IS, 0, 0, _AS_IT_IS) != _ACCEPTED:
        raise UserError(
            "the vehicle does not take the calibration of the injected sensors as it is; "
            "disarm it, or choose Force Accel Calibration in a ground station"
        )


def restart(vehicle: Vehicle) -> int:
    """Have the vehicle restart; returns its time since boot in ms just before. Raises UserError."""
    before = vehicle.request(dialect.MAVLINK_MSG_ID_SYSTEM_TIME)
    if vehicle.command(dialect.MAV_CMD_PREFLIGHT_REBOOT_SHUTDOWN, 1) != _ACCEPTED:
        raise UserError("the vehicle refuses to restart; disarm it, or switch its power off and on")
    return 0 if before is None else int(before.time_boot_ms)


@contextmanager
def restarted(url: str, key: bytes | None, boot_ms: int) -> Iterator[Vehicle]:
    """The vehicle once it is back from a restart that came at `boot_ms` of its time. Raises UserError."""
    asked_s = time.monotonic()
    with ExitStack() as opened:
        while True:
            time.sleep(SETTLE_S)
            try:
                attempt = ExitStack()
                with attempt:
                    vehicle = attempt.enter_context(connected(url, key, RETRY_S))
                    now = vehicle.request(dialect.MAVLINK_MSG_ID_SYSTEM_TIME)
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
