"""Makes a Python on Linux look like one on Windows or macOS to xitl's own modules. See tests/other_systems.py.

Python imports this file at its start if its folder is on PYTHONPATH, also in the child processes of a run. Packages
and the standard library see the real system, because their own code for the other system cannot run here.
"""

from __future__ import annotations

import builtins
import ctypes  # noqa: F401  loads the library of the process, which the hook below refuses
import errno
import json
import os
import socket
import subprocess
import sys
import sysconfig
import types
from typing import Any

SETTINGS = "XITL_TEST_OTHER_SYSTEM"
_asked = json.loads(os.environ[SETTINGS])
_platform: str = _asked["platform"]
_root: str = _asked["root"]
_hidden: dict[str, list[str]] = _asked["hidden"]
"""Names that each module of the standard library lacks on the other system; "*": there is no such module."""
_own = tuple(f"{_root}/{package}/" for package in ("agent", "sim_core", "xitl", "xitl_cli"))
_libraries = tuple({f"{sysconfig.get_path('stdlib')}/", "<frozen"})
_in_names = '<>"|?*:' if _platform == "win32" else ""
_linux_folders = ("/proc", "/sys", "/dev", "/run", "/etc")


def _asked_by_xitl() -> bool:
    """Whether the nearest caller outside of the standard library is a module of xitl."""
    frame: types.FrameType | None = sys._getframe(1)
    while frame is not None:
        file = frame.f_code.co_filename
        if file != __file__ and not (file.startswith(_libraries) and "/site-packages/" not in file):
            return file.startswith(_own)
        frame = frame.f_back
    return False


class _StandIn(types.ModuleType):
    """A module of the standard library as the other system has it."""

    def __init__(self, module: types.ModuleType) -> None:
        super().__init__(module.__name__, module.__doc__)
        self.__dict__["_module"] = module
        self.__dict__["_absent"] = frozenset(_hidden.get(module.__name__, ()))

    def __getattr__(self, name: str) -> Any:
        if name in self._absent:
            raise AttributeError(f"module {self.__name__!r} has no attribute {name!r} on {_platform}")
        if (self.__name__, name) == ("sys", "platform"):
            return _platform
        if (self.__name__, name) == ("os", "name") and _platform == "win32":
            return "nt"
        return getattr(self._module, name)

    def __setattr__(self, name: str, value: Any) -> None:
        setattr(self._module, name, value)


_stand_ins: dict[str, _StandIn] = {}
_import = builtins.__import__


def _import_as_there(name: str, globals: Any = None, locals: Any = None, fromlist: Any = (), level: int = 0) -> Any:
    if level or not str((globals or {}).get("__file__", "")).startswith(_own):
        return _import(name, globals, locals, fromlist, level)
    top = name.partition(".")[0]
    if "*" in _hidden.get(top, ()):
        raise ModuleNotFoundError(f"No module named {top!r}", name=top)
    module = _import(name, globals, locals, fromlist, level)
    if module.__name__ not in (*_hidden, "sys"):
        return module
    return _stand_ins.setdefault(module.__name__, _StandIn(module))


builtins.__import__ = _import_as_there


def _refuse(event: str, arguments: tuple[Any, ...]) -> None:
    """Audit hook: files that the other system does not have, and actions that it refuses."""
    if event == "open" and isinstance(arguments[0], (str, os.PathLike)):
        path = str(arguments[0])
        inside = path.startswith(_linux_folders) and path != os.devnull and path.count("/") > 1
        if inside and _asked_by_xitl():
            raise FileNotFoundError(errno.ENOENT, "No such file or directory", path)
        if any(mark in path for mark in _in_names) and _asked_by_xitl():
            raise OSError(errno.EINVAL, "Invalid argument", path)
    elif event in ("os.mkdir", "os.rename", "os.listdir", "os.scandir"):
        for path in (str(argument) for argument in arguments[:2] if isinstance(argument, (str, os.PathLike))):
            if path.startswith(_linux_folders) and _asked_by_xitl():
                raise FileNotFoundError(errno.ENOENT, "No such file or directory", path)
            if any(mark in path for mark in _in_names) and _asked_by_xitl():
                raise OSError(errno.EINVAL, "Invalid argument", path)
        if event == "os.rename" and _platform == "win32":
            _refuse_open(arguments[:2])
    elif event == "os.remove" and _platform == "win32":
        _refuse_open(arguments[:1])
    elif (
        event == "socket.__new__"
        and _platform == "darwin"
        and arguments[1:3] == (socket.AF_UNIX, socket.SOCK_SEQPACKET)
    ):
        if _asked_by_xitl():
            raise OSError(errno.EPROTONOSUPPORT, "Protocol not supported")
    elif event == "ctypes.dlopen" and arguments[0] is None and _platform == "win32" and _asked_by_xitl():
        raise TypeError("argument of type 'NoneType' is not iterable")


def _refuse_open(paths: tuple[Any, ...]) -> None:
    """Raise PermissionError if this process has one of the files open: Windows neither removes nor moves it then."""
    if not _asked_by_xitl():
        return
    wanted = {os.path.realpath(os.fsdecode(path)) for path in paths if isinstance(path, (str, bytes, os.PathLike))}
    for number in range(256):
        try:
            path = os.readlink(f"/proc/self/fd/{number}")  # noqa: PTH115
        except OSError:
            continue
        if path in wanted:
            raise PermissionError(errno.EACCES, "the file is in use by this process", path)


sys.addaudithook(_refuse)
_stat = os.stat


def _stat_as_there(path: Any, **options: Any) -> os.stat_result:
    if isinstance(path, (str, os.PathLike)) and str(path).startswith(_linux_folders) and _asked_by_xitl():
        raise FileNotFoundError(errno.ENOENT, "No such file or directory", str(path))
    return _stat(path, **options)


for _able in (os.supports_dir_fd, os.supports_fd, os.supports_follow_symlinks):
    if _stat in _able:
        _able.add(_stat_as_there)
os.stat = _stat_as_there  # type: ignore[assignment]

if _platform == "win32":
    _begin = subprocess.Popen.__init__

    def _begin_as_there(self: Any, *words: Any, **options: Any) -> None:
        if _asked_by_xitl():
            if options.get("preexec_fn") is not None:
                raise ValueError("preexec_fn is not supported on Windows platforms")
            assert not options.get("pass_fds"), "pass_fds not supported on Windows."
        _begin(self, *words, **options)

    subprocess.Popen.__init__ = _begin_as_there  # type: ignore[method-assign]
