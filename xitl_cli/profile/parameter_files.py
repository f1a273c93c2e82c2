"""The parameter files an autopilot starts with: shipped ones by name, others by path."""

from __future__ import annotations

import difflib
from pathlib import Path

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
