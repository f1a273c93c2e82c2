"""The kernel that a wheel for one platform brings, compiled here by the compiler of this machine."""

from __future__ import annotations

import ctypes
import platform
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from kernel import needs_kernel

from sim_core.tape import library
from sim_core.tape.library import Kernel, load_kernel
from sim_core.tape.program import Program
from sim_core.tape.traced import TapeRecorder
from tools import kernel_hook
from tools.kernel_hook import LEVELS, PLATFORMS, KernelHook, compile_kernel

pytestmark = needs_kernel
ROOT = Path(__file__).parents[3]
ROWS, WIDTH = 9, 21
WAVE = np.random.default_rng(3).normal(size=(WIDTH, 5))


@pytest.fixture(scope="module")
def wheel_kernel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    compiler = shutil.which("cc") or shutil.which("gcc") or "clang"
    path = tmp_path_factory.mktemp("kernel") / "kernel.so"
    compile_kernel([compiler], ROOT / kernel_hook.TAPE, path, levels=platform.machine() == "x86_64")
    return path


def results_of(kernel: Kernel) -> np.ndarray:
    """Return what a kernel makes of sines, products and sums, for eight vessels together and one alone."""
    recorder = TapeRecorder()
    a, b = recorder.input((1, WIDTH)), recorder.input((1, WIDTH))
    result = np.concatenate((np.sin(a) * np.cos(a) @ WAVE, np.exp(-np.abs(b)) / (1.0 + a * a)), axis=1)
    program = Program(kernel, recorder, [result])
    draw = np.random.default_rng(4)
    state = draw.normal(scale=5.0, size=(ROWS, WIDTH))
    program.other(ROWS)[:] = draw.normal(size=(ROWS, WIDTH))
    return program.run(ROWS, state.ctypes.data, WIDTH)[0].copy()


@pytest.mark.slow
def test_each_level_gives_the_bits_of_the_kernel_compiled_here(wheel_kernel: Path) -> None:
    here, kernel = results_of(load_kernel()), Kernel(wheel_kernel)
    assert np.isfinite(here).all()
    assert results_of(kernel).tobytes() == here.tobytes()
    if platform.machine() != "x86_64":
        return
    opened = ctypes.CDLL(str(wheel_kernel))
    runs_here = [level for level in LEVELS if int(level[1:]) <= opened.processor_level()]
    for level in runs_here:
        run: Any = opened[f"run_tape_{level}"]
        run.restype, run.argtypes = None, kernel.run_tape.argtypes
        kernel.run_tape = run
        assert results_of(kernel).tobytes() == here.tobytes(), level


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/cpuinfo").exists(), reason="needs the flags of Linux")
def test_the_level_follows_from_what_the_processor_has(wheel_kernel: Path) -> None:
    if platform.machine() != "x86_64":
        return
    flags = set(library._processor().split())
    level = 4 if {"avx512f", "avx512dq", "avx512bw", "avx512vl"} <= flags else 3 if {"avx2", "fma"} <= flags else 1
    assert ctypes.CDLL(str(wheel_kernel)).processor_level() == level


@pytest.fixture
def fresh_load() -> Iterator[None]:
    load_kernel.cache_clear()
    yield
    load_kernel.cache_clear()


@pytest.mark.slow
def test_a_machine_without_a_compiler_runs_the_kernel_of_the_wheel(
    wheel_kernel: Path, fresh_load: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(library, "_COMPILERS", ("no-such-compiler",))
    monkeypatch.setattr(library, "_SHIPPED", wheel_kernel)
    assert np.isfinite(results_of(load_kernel())).all()


def test_wheels_and_first_runs_compile_with_the_same_flags() -> None:
    here = set(library._FLAGS) - {"-march=native", "-shared"}
    assert set(kernel_hook.FLAGS) - {"-g0"} == here


def hook() -> KernelHook:
    return KernelHook(str(ROOT), {}, None, None, "", "wheel")


def test_without_the_choice_of_a_platform_a_wheel_has_no_compiled_code(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(kernel_hook.CHOICE, raising=False)
    data: dict[str, Any] = {"force_include": {}, "pure_python": True}
    hook().initialize("standard", data)
    assert data == {"force_include": {}, "pure_python": True}


@pytest.mark.parametrize("name", PLATFORMS)
def test_a_wheel_for_a_platform_has_its_kernel_and_its_tag(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[str, bool]] = []

    def compiled(compiler: tuple[str, ...], source: Path, made: Path, levels: bool) -> None:
        assert (source / "kernel.c").exists()
        asked.append((compiler[-1], levels))
        made.write_bytes(b"kernel")

    monkeypatch.setattr(kernel_hook, "compile_kernel", compiled)
    monkeypatch.setenv(kernel_hook.CHOICE, name)
    data: dict[str, Any] = {"force_include": {}, "pure_python": True}
    builder = hook()
    builder.initialize("standard", data)
    wanted = PLATFORMS[name]
    assert asked == [(wanted.target, name.startswith("x86_64"))]
    assert (data["tag"], data["pure_python"]) == (f"py3-none-{wanted.tag}", False)
    ((made, place),) = data["force_include"].items()
    assert Path(made).read_bytes() == b"kernel"
    assert place == f"sim_core/tape/{wanted.library}"
    builder.finalize("standard", data, "")
    assert not Path(made).exists()


def test_an_unknown_platform_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(kernel_hook.CHOICE, "amiga")
    with pytest.raises(ValueError, match=r"XITL_WHEEL=amiga is no platform; choose one of x86_64-linux, "):
        hook().initialize("standard", {"force_include": {}})
