"""Hook of hatchling: puts the compiled kernel of the physics into a wheel for one platform.

    XITL_WHEEL=x86_64-linux python -m hatchling build -t wheel

`make wheels` builds the wheels of all platforms. Zig's C compiler (`pip install ziglang`) compiles for each of them on
any machine. Without XITL_WHEEL, a wheel has no compiled code and runs everywhere; the first run compiles the kernel
there. The kernel does not use Python's headers, so one wheel of a platform is for all versions of Python.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

CHOICE = "XITL_WHEEL"
TAPE = Path("sim_core/tape")
FLAGS = ("-O3", "-ffp-contract=off", "-fno-math-errno", "-std=gnu11", "-fPIC", "-g0")
"""The flags of sim_core/tape/library.py, but for the processor."""
_V3 = ("-mavx2", "-mfma")
LEVELS = {"v1": (), "v3": _V3, "v4": (*_V3, "-mavx512f", "-mavx512dq", "-mavx512cd", "-mavx512bw", "-mavx512vl")}
"""Levels of x86-64 processors for which a wheel has a kernel, and what the compiler may use. levels.c chooses one."""


class Platform(NamedTuple):
    """A platform. target: for Zig. tag: of the wheel. library: name of the kernel's file there."""

    target: str
    tag: str
    library: str

    @property
    def x86_64(self) -> bool:
        return self.target.startswith("x86_64")


PLATFORMS = {
    "x86_64-linux": Platform("x86_64-linux-gnu.2.17", "manylinux_2_17_x86_64", "kernel.so"),
    "aarch64-linux": Platform("aarch64-linux-gnu.2.17", "manylinux_2_17_aarch64", "kernel.so"),
    "x86_64-macos": Platform("x86_64-macos.11.0", "macosx_11_0_x86_64", "kernel.dylib"),
    "arm64-macos": Platform("aarch64-macos.11.0", "macosx_11_0_arm64", "kernel.dylib"),
    "x86_64-windows": Platform("x86_64-windows-gnu", "win_amd64", "kernel.dll"),
}


class KernelHook(BuildHookInterface[Any]):
    """Compiles the kernel for the platform of XITL_WHEEL."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the kernel and the platform's tag to the wheel. Raises ValueError for an unknown platform."""
        chosen = os.environ.get(CHOICE)
        if not chosen:
            return
        if chosen not in PLATFORMS:
            raise ValueError(f"{CHOICE}={chosen} is no platform; choose one of {', '.join(PLATFORMS)}")
        platform = PLATFORMS[chosen]
        self._folder = tempfile.TemporaryDirectory()
        library = Path(self._folder.name) / platform.library
        compiler = (sys.executable, "-m", "ziglang", "cc", "-target", platform.target)
        compile_kernel(compiler, Path(self.root) / TAPE, library, levels=platform.x86_64)
        build_data["force_include"][str(library)] = str(TAPE / platform.library)
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{platform.tag}"

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:
        """Remove the compiled files."""
        if "tag" in build_data:
            self._folder.cleanup()


def compile_kernel(compiler: Sequence[str], source: Path, library: Path, levels: bool) -> None:
    """Compile the kernel of the folder `source` to `library`. levels: for each of LEVELS, with a choice at run time."""
    link = [*compiler, *FLAGS, "-shared", "-s", "-o", str(library)]
    if not levels:
        subprocess.run([*link, str(source / "kernel.c"), "-lm"], check=True)
        return
    with tempfile.TemporaryDirectory() as folder:
        objects = []
        for level, features in LEVELS.items():
            objects.append(f"{folder}/{level}.o")
            of_level = [*features, f"-DRUN_TAPE=run_tape_{level}", "-c", "-o", objects[-1]]
            subprocess.run([*compiler, *FLAGS, *of_level, str(source / "kernel.c")], check=True)
        subprocess.run([*link, str(source / "levels.c"), *objects, "-lm"], check=True)
