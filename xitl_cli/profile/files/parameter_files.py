"""The parameter files of an autopilot: shipped ones by name, others by path."""

from __future__ import annotations

import difflib
from pathlib import Path

from agent.fcu.parameters import checked, checked_parm
from agent.files import read_text
from agent.mavlink.parameter_rows import ParameterError, load_parm
from xitl_cli.errors import UserError
from xitl_cli.profile.files.station_file import SUFFIX, is_station_file, load_station_file
from xitl_cli.shipped import firmware_params_dir

SUFFIXES = (".parm", ".param", SUFFIX)
SHIPPED = ("*.parm", f"*{SUFFIX}")


def find_parameter_file(name: str) -> Path:
    """Return the file of `name`: a path if it ends in .parm, .param or .params, otherwise a shipped one.

    Raises UserError.
    """
    if name.endswith(SUFFIXES):
        path = Path(name).expanduser()
        if path.is_file():
            return path
        what = "is no regular file" if path.exists() else "does not exist"
        raise UserError(f"{path} {what}; check the path, or name a shipped parameter file")
    root = firmware_params_dir()
    paths = sorted(path for pattern in SHIPPED for path in root.rglob(pattern))
    shipped = {path.relative_to(root).with_suffix("").as_posix(): path for path in paths}
    if name in shipped:
        return shipped[name]
    close = difflib.get_close_matches(name, shipped, n=1)
    hint = f"did you mean {close[0]!r}?" if close else f"shipped ones: {', '.join(shipped) or 'none'}"
    raise UserError(f"there is no parameter file {name!r}; {hint} (a path ends in .parm or .params)")


def read_parameter_file(name: str, embedded: bool = False) -> dict[str, float]:
    """Return names and values in the file of `name`, as `find_parameter_file` finds it.

    Raises UserError for an invalid file and, with `embedded`, for a file that the embedded autopilot would refuse.
    """
    path = find_parameter_file(name)
    try:
        text = read_text(path)
        if is_station_file(text):
            return _known(load_station_file(text, str(path)), path) if embedded else load_station_file(text, str(path))
        if embedded:
            checked_parm(text, str(path))
        return load_parm(text, str(path))
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}); check the path") from error
    except UnicodeDecodeError:
        raise UserError(
            f"{path}: is not text; give a .parm file, one NAME value a line, or a .params file of QGroundControl"
        ) from None
    except ParameterError as error:
        raise UserError(str(error)) from error


def _known(values: dict[str, float], path: Path) -> dict[str, float]:
    """Return the values if the embedded autopilot accepts them. Raises ParameterError."""
    for name, value in values.items():
        try:
            checked(name, value)
        except ParameterError as error:
            raise ParameterError(f"{path}: {error}") from None
    return values
