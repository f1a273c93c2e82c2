"""The compiled kernel: from the wheel, or compiled once by this machine's C compiler and kept in the user's cache."""

from __future__ import annotations

import ctypes
import os
import platform
import shutil
import sys
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any

SWITCH = "XITL_PHYSICS"
"""Environment variable: `numpy` for the physics without compiled code."""
_SOURCE = Path(__file__).with_name("kernel.c")
_SHIPPED = _SOURCE.with_suffix({"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so"))
"""In a wheel for this platform, see tools/kernel_hook.py."""
_FLAGS = ("-O3", "-march=native", "-ffp-contract=off", "-fno-math-errno", "-std=gnu11", "-shared", "-fPIC")
_COMPILERS = ("cc", "gcc", "clang")
_COMPILE_S = 60.0


class NoKernelError(Exception):
    """There is no compiled kernel. The text gives the reason and what to do."""


class Kernel:
    """The function of kernel.c. A call releases the GIL."""

    def __init__(self, path: Path) -> None:
        self.run_tape: Any = ctypes.CDLL(str(path)).run_tape
        self.run_tape.restype = None
        number, address = ctypes.c_int64, ctypes.c_void_p
        self.run_tape.argtypes = [address, number, number, *[address] * 3, number, *[address] * 5]


@cache
def load_kernel() -> Kernel:
    """Return the kernel of the wheel, or the one that the first use on a machine compiles. Raises NoKernelError."""
    chosen = os.environ.get(SWITCH)
    if chosen == "numpy":
        raise NoKernelError(f"{SWITCH}=numpy is set; unset it")
    path = _SHIPPED if _SHIPPED.exists() else compiled_kernel()
    try:
        return Kernel(path)
    except (OSError, AttributeError) as error:
        raise NoKernelError(f"{path} cannot be loaded ({error}); delete it, and a C compiler makes it again") from error


def compiled_kernel() -> Path:
    """Return the compiled kernel of this version, compiler and processor. Raises NoKernelError."""
    if sys.platform == "win32":
        raise NoKernelError("only xitl's wheel for Windows has compiled physics; install that wheel, or use WSL")
    wanted = os.environ.get("CC")
    compiler = next(filter(None, map(shutil.which, [wanted] if wanted else _COMPILERS)), None)
    if compiler is None:
        raise NoKernelError(f"no C compiler ({wanted or ', '.join(_COMPILERS)}); install gcc or clang")
    try:
        source, changed_ns = _SOURCE.read_text(encoding="utf-8"), Path(compiler).stat().st_mtime_ns
    except OSError as error:
        raise NoKernelError(f"{error.filename} cannot be read ({error.strerror}); reinstall xitl") from error
    marks = (source, *_FLAGS, compiler, changed_ns, _processor())
    path = _folder() / f"kernel-{sha256(repr(marks).encode()).hexdigest()[:20]}.so"
    if not path.exists():
        _compile(compiler, path)
    return path


def _processor() -> str:
    """Return kind and features of the processor, for which the kernel is compiled."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    return platform.machine() + next((line for line in lines if line.startswith(("flags", "Features"))), "")


def _folder() -> Path:
    """Return the private folder of compiled kernels. Raises NoKernelError if others may write there."""
    own, base = os.environ.get("XITL_CACHE"), os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    try:
        root = Path(own or f"{base}/xitl").expanduser().absolute()
        folder = root / "physics"
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        for part in (root, folder):
            status = part.stat()
            if os.name == "posix" and (status.st_uid != os.getuid() or status.st_mode & 0o022):
                raise NoKernelError(f"others may write to {part}; make it yours, and chmod 700 {part}")
    except (OSError, RuntimeError) as error:
        raise NoKernelError(f"no folder for the kernel ({error}); set XITL_CACHE to a folder of yours") from error
    return folder


def _compile(compiler: str, path: Path) -> None:
    """Compile beside the path and move it there, so that other runs see a whole file or none. Raises NoKernelError."""
    import subprocess  # only the first run on a machine compiles
    import tempfile

    try:
        with tempfile.TemporaryDirectory(dir=path.parent) as beside:
            made = Path(beside) / path.name
            command = [compiler, *_FLAGS, "-o", str(made), str(_SOURCE), "-lm"]
            subprocess.run(command, check=True, capture_output=True, text=True, timeout=_COMPILE_S)
            made.replace(path)
    except (OSError, subprocess.SubprocessError) as error:
        said = str(getattr(error, "stderr", None) or error).strip().splitlines()
        raise NoKernelError(f"{compiler} cannot compile {_SOURCE.name}: {said[0] if said else error}") from error
