"""The parameter files of an autopilot: shipped ones by name, others by path.

A `.params` file of QGroundControl, also used for PX4, has vehicle, component, name, value and type, separated by tabs.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from agent.fcu.parameters import checked, checked_parm
from agent.files import read_text
from agent.mavlink.parameter_rows import ParameterError, load_parm
from xitl_cli.errors import UserError
from xitl_cli.paths import user_path
from xitl_cli.shipped import firmware_params_dir

if TYPE_CHECKING:
    from agent.mavlink.exchange import Target

STATION_SUFFIX = ".params"
COLUMNS = ("Vehicle-Id", "Component-Id", "Name", "Value", "Type")
AUTOPILOT_COMPONENT = 1
REAL32 = 9  # MAV_PARAM_TYPE
_REALS = (REAL32, 10)
_BITS = {1: (0, 8), 2: (1, 7), 3: (0, 16), 4: (1, 15), 5: (0, 32), 6: (1, 31), 7: (0, 64), 8: (1, 63)}
"""For each whole-number type: 1 with a sign, and the number of other bits."""

SUFFIXES = (".parm", ".param", STATION_SUFFIX)
SHIPPED = ("*.parm", f"*{STATION_SUFFIX}")


def find_parameter_file(name: str) -> Path:
    """Return the file of `name`: a path if it ends in .parm, .param or .params, otherwise a shipped one.

    Raises UserError.
    """
    if name.endswith(SUFFIXES):
        path = user_path(name)
        if path.is_file():
            return path
        problem = "is not a regular file" if path.exists() else "does not exist"
        raise UserError(f"{path} {problem}; check the path, or name a shipped parameter file")
    root = firmware_params_dir()
    paths = sorted(path for pattern in SHIPPED for path in root.rglob(pattern))
    shipped = {path.relative_to(root).with_suffix("").as_posix(): path for path in paths}
    if name in shipped:
        return shipped[name]
    close = difflib.get_close_matches(name, shipped, n=1)
    hint = f"did you mean {close[0]!r}?" if close else f"shipped files: {', '.join(shipped) or 'none'}"
    raise UserError(f"there is no parameter file {name!r}; {hint} (a path ends in .parm or .params)")


def read_parameter_file(name: str, embedded: bool = False) -> dict[str, float]:
    """Return names and values in the file of `name`, as `find_parameter_file` finds it.

    Raises UserError for an invalid file and, with `embedded`, for a file that the embedded autopilot would refuse.
    """
    path = find_parameter_file(name)
    try:
        text = read_text(path)
        if is_station_file(text):
            values = load_station_file(text, str(path))
            for parameter, value in values.items() if embedded else ():
                try:
                    checked(parameter, value)
                except ParameterError as error:
                    raise ParameterError(f"{path}: {error}") from None
            return values
        if embedded:
            checked_parm(text, str(path))
        return load_parm(text, str(path))
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}); check the path") from error
    except UnicodeDecodeError:
        raise UserError(
            f"{path}: is not text; use a .parm file with one NAME value per line, or a .params file of QGroundControl"
        ) from None
    except ParameterError as error:
        raise UserError(str(error)) from error


def is_station_file(text: str) -> bool:
    """Return True if the first line without a comment has five columns, with whole numbers in 1, 2 and 5."""
    rows = (line.split() for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#"))
    first = next(rows, [])
    return len(first) == len(COLUMNS) and all(first[number].isdecimal() for number in (0, 1, 4))


def load_station_file(text: str, source: str) -> dict[str, float]:
    """Return names and values of the autopilot. Other components are ignored, and the last value of a name counts.

    Raises ParameterError with file and line.
    """
    values: dict[str, float] = {}
    for line, raw in enumerate(text.splitlines(), start=1):
        fields = raw.split()
        if not fields or fields[0].startswith("#"):
            continue
        where = f"{source}:{line}"
        if len(fields) != len(COLUMNS) or not all(fields[number].isdecimal() for number in (0, 1, 4)):
            raise ParameterError(f"{where}: expected {' '.join(COLUMNS)}, found {raw.strip()[:60]!r}")
        if int(fields[1]) == AUTOPILOT_COMPONENT:
            values[fields[2].upper()] = _station_value(f"{where}: {fields[2]}", fields[3], int(fields[4]))
    if not values and text.strip():
        raise ParameterError(f"{source}: has no parameter of an autopilot (component {AUTOPILOT_COMPONENT})")
    return values


def _station_value(key: str, text: str, kind: int) -> float:
    try:
        value = float(text)
    except ValueError:
        raise ParameterError(f"{key} = {text[:40]!r} is not a number") from None
    if not math.isfinite(value):
        raise ParameterError(f"{key} = {text} is not a finite number")
    if kind in _REALS:
        return value
    if kind not in _BITS:
        raise ParameterError(f"{key} has an unknown type {kind} (MAV_PARAM_TYPE: 6 whole, 9 real)")
    signed, bits = _BITS[kind]
    if value != int(value) or not -signed * 2**bits <= value < 2**bits:
        raise ParameterError(f"{key} = {text} is not a value of its type {kind}; use a whole number within its range")
    return value


def station_file_text(
    values: Mapping[str, float],
    types: Mapping[str, int],
    target: Target,
    source: str,
    format_value: Callable[[float], str],
    now: datetime | None = None,
) -> str:
    """Return a file with a vehicle's parameters; a name without a type is a real number."""
    stamp = (now or datetime.now(UTC)).strftime("%Y-%m-%d %H:%M UTC")
    lines = [
        f"# Onboard parameters for Vehicle {target[0]}",
        f"# {len(values)} parameters of {source}, {stamp}",
        "#",
        f"# {' '.join(COLUMNS)}",
    ]
    for name, value in sorted(values.items()):
        kind = types.get(name, REAL32)
        text = format_value(value) if kind in _REALS else str(int(value))
        lines.append("\t".join((str(target[0]), str(target[1]), name, text, str(kind))))
    return "\n".join(lines) + "\n"
