"""Pulse widths from a DataFlash log: RCOU, when it was armed (ARM), and what the outputs were used for (PARM)."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from xitl_cli.errors import UserError
from xitl_cli.replay.pulses import PulseLog, is_pulse

HEAD = b"\xa3\x95"
_FUNCTION = re.compile(r"SERVO([0-9]{1,2})_FUNCTION")
_CHANNEL = re.compile(r"C([0-9]{1,2})")


def read_dataflash(path: Path) -> PulseLog:
    """Read RCOU (channels 1 to 14) from the .bin log of any ArduPilot vehicle or of the embedded autopilot.

    A record that jumps back in time is dropped. Raises UserError when the file is no log or holds no outputs.
    """
    try:
        with path.open("rb") as file:
            head = file.read(len(HEAD))
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}); check the path") from error
    if head != HEAD:
        raise UserError(f"{path}: is no DataFlash log; give a .bin as ArduPilot writes it, or a .csv")
    from pymavlink import DFReader  # type: ignore[import-untyped]  # takes half a second, and few runs need it

    try:
        log = DFReader.DFReader_binary(str(path), zero_time_base=True)
    except Exception as error:
        raise _damaged(path, error) from error
    try:
        return _read(log, path)
    finally:
        log.data_map.close()
        log.filehandle.close()


def _read(log: Any, path: Path) -> PulseLog:
    at_s: list[float] = []
    pulses: dict[int, list[float]] = {}
    armed_s: float | None = None
    functions: dict[int, int] = {}
    while True:
        try:
            message = log.recv_match(type=["RCOU", "ARM", "PARM"])
            if message is None:
                break
            kind = message.get_type()
            if kind == "PARM":
                if match := _FUNCTION.fullmatch(message.Name):
                    functions[int(match[1])] = int(message.Value)
                continue
            now_s = message.TimeUS * 1e-6
            if kind == "ARM":
                armed_s = now_s if armed_s is None and message.ArmState else armed_s
                continue
            outputs = {
                int(match[1]): float(getattr(message, name))
                for name in message.get_fieldnames()
                if (match := _CHANNEL.fullmatch(name))
            }
        except Exception as error:
            raise _damaged(path, error) from error
        if at_s and now_s <= at_s[-1]:
            continue
        at_s.append(now_s)
        for channel, pulse in outputs.items():
            pulses.setdefault(channel, []).append(pulse if is_pulse(pulse) else 0.0)
    if not at_s:
        raise UserError(f"{path}: holds no motor outputs (RCOU); log with bit RC OUT of LOG_BITMASK set")
    return PulseLog(
        str(path), tuple(at_s), {channel: tuple(values) for channel, values in pulses.items()}, armed_s, functions
    )


def _damaged(path: Path, error: Exception) -> UserError:
    return UserError(f"{path}: is damaged ({type(error).__name__}: {error}); download the log again")
