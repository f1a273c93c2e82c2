"""The compiled kernel: found beside this module, or compiled once by the C compiler of this machine and kept."""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path
from typing import Any

SWITCH = "XITL_PHYSICS"
"""Environment variable: `numpy` for the physics without compiled code."""
_SOURCE = Path(__file__).with_name("kernel.c")
_FLAGS = ("-O3", "-march=native", "-ffp-contract=off", "-fno-math-errno", "-std=gnu11", "-shared", "-fPIC")
_COMPILE_S = 60.0
_POINTERS = 7


class NoKernelError(Exception):
    """There is no compiled kernel. The text gives the reason and what to do."""


class Kernel:
    """The functions of kernel.c. Calls release the GIL."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.run_tape: Any = ctypes.CDLL(str(path)).run_tape
        self.run_tape.restype = None
        self.run_tape.argtypes = [ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64, *[ctypes.c_void_p] * _POINTERS]


@cache
def load_kernel() -> Kernel:
    """Return the kernel, compiled at the first use on a machine. Raises NoKernelError."""
    if os.environ.get(SWITCH) == "numpy":
        raise NoKernelError(f"{SWITCH}=numpy is set")
    path = _compiled()
    try:
        return Kernel(path)
    except OSError as error:
        raise NoKernelError(f"{path} cannot be loaded ({error}); delete it to compile it again") from error


def why_not_compiled() -> str | None:
    """Return why the physics runs in numpy, None if its compiled kernel can run."""
    try:
        load_kernel()
    except NoKernelError as error:
        return str(error)
    return None


def _compiled() -> Path:
    source = _SOURCE.read_bytes()
    compiler = shutil.which(os.environ.get("CC") or "cc") or shutil.which("gcc") or shutil.which("clang")
    if sys.platform == "win32" or compiler is None:
        raise NoKernelError("there is no C compiler; install gcc or clang for a faster simulation")
    marks = (source, " ".join(_FLAGS), compiler, str(os.stat(compiler).st_mtime_ns), platform.machine(), _processor())
    name = hashlib.sha256("\0".join(map(str, marks)).encode()).hexdigest()[:20]
    folder = _folder()
    path = folder / f"kernel-{name}.so"
    if not path.exists():
        _compile(compiler, path)
    return path


def _processor() -> str:
    """Return the features of the processor, for which the kernel is compiled."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as info:
            return next((line for line in info if line.startswith(("flags", "Features"))), "")
    except OSError:
        return platform.processor()


def _folder() -> Path:
    """Return the private folder of compiled kernels. Raises NoKernelError if others may write there."""
    base = os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    folder = Path(base).expanduser() / "xitl"
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        status = folder.stat()
    except (OSError, RuntimeError) as error:
        raise NoKernelError(f"{folder} cannot be made ({error}); set XDG_CACHE_HOME to a folder of yours") from error
    if status.st_uid != os.getuid() or status.st_mode & 0o022:
        raise NoKernelError(f"others may write to {folder}; use chmod 700 {folder}")
    return folder


def _compile(compiler: str, path: Path) -> None:
    """Compile beside the path and move it there, so that runs beside this one see a whole file or none."""
    with tempfile.TemporaryDirectory(dir=path.parent) as beside:
        made = Path(beside) / path.name
        command = [compiler, *_FLAGS, "-o", str(made), str(_SOURCE), "-lm"]
        try:
            subprocess.run(command, check=True, capture_output=True, text=True, timeout=_COMPILE_S)
        except (OSError, subprocess.SubprocessError) as error:
            output = getattr(error, "stderr", None) or str(error)
            raise NoKernelError(f"{compiler} cannot compile {_SOURCE.name}: {output.strip()[-300:]}") from error
        made.replace(path)
