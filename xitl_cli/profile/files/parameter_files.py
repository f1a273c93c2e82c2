"""The parameter files an autopilot starts with: shipped ones by name, others by path."""

from __future__ import annotations

import difflib
from pathlib import Path

from agent.fcu.parameters import ParameterError, Parameters, load_parm
from xitl_cli.errors import UserError
from xitl_cli.shipped import firmware_params_dir

SUFFIXES = (".parm", ".param")


def find_parameter_file(name: str) -> Path:
    """The file of `name`: a path if it ends in .parm or .param, else a shipped one. UserError if there is none."""
    if name.endswith(SUFFIXES):
        path = Path(name).expanduser()
        if path.is_file():
            return path
        raise UserError(f"{path} does not exist; check the path, or name a shipped parameter file")
    root = firmware_params_dir()
    shipped = {path.relative_to(root).with_suffix("").as_posix(): path for path in sorted(root.rglob("*.parm"))}
    if name in shipped:
        return shipped[name]
    close = difflib.get_close_matches(name, shipped, n=1)
    hint = f"did you mean {close[0]!r}?" if close else f"shipped ones: {', '.join(shipped) or 'none'}"
    raise UserError(f"there is no parameter file {name!r}; {hint} (a path ends in .parm)")


def read_parameter_file(name: str, embedded: bool = False) -> dict[str, float]:
    """Names and values in the file of `name`, as `find_parameter_file` finds it.

    Raises UserError for a file that is none or, if it is for the embedded autopilot, that this would refuse.
    """
    path = find_parameter_file(name)
    try:
        text = path.read_text(encoding="utf-8")
        if embedded:
            Parameters().load(text, str(path))
        return load_parm(text, str(path))
    except OSError as error:
        raise UserError(f"{path}: cannot be read ({error.strerror}); check the path") from error
    except UnicodeDecodeError:
        raise UserError(f"{path}: is not text; give a .parm file, one NAME value a line") from None
    except ParameterError as error:
        raise UserError(str(error)) from error
