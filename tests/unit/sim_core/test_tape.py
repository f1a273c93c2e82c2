"""Recorded numpy functions, run by the compiled kernel, against numpy itself."""

from __future__ import annotations

import os
import stat
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from kernel import needs_kernel

from sim_core.tape import library
from sim_core.tape.library import NoKernelError, compiled_kernel, load_kernel
from sim_core.tape.program import Program
from sim_core.tape.traced import ELEMENT_WISE, NotRecordableError, TapeRecorder

pytestmark = needs_kernel
WIDTH = 6
MATRIX = np.random.default_rng(1).normal(size=(WIDTH, 5))
SPARSE = np.where(np.arange(WIDTH * 9).reshape(WIDTH, 9) % 7 == 1, np.arange(1.0, 10.0), 0.0)  # with columns of zeros
ABSCISSAE, ORDINATES = np.array([-2.0, -0.5, 0.0, 1.0, 3.0]), np.array([1.0, -1.0, 4.0, 4.0, 0.5])


def compiled(function: Callable[..., Any]) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """Return a function of (N, WIDTH) and (N, WIDTH) that runs the recording of `function`, a function of two rows."""
    recorder = TapeRecorder()
    result = function(recorder.input((1, WIDTH)), recorder.input((1, WIDTH)))
    program = Program(load_kernel(), recorder, [result])

    def run(first: np.ndarray, second: np.ndarray) -> np.ndarray:
        program.other(len(first))[:] = second
        state = np.ascontiguousarray(first)
        return program.run(len(state), state.ctypes.data, WIDTH)[0]

    return run


def in_place(a: Any, b: Any) -> Any:
    change = a * b
    kept = change.copy()
    change -= b
    change[:, 1:3] = a[:, ::2][:, :2]
    change[:, 3:] += 2.0
    np.maximum(change, kept, out=change)
    return np.concatenate((kept, change), axis=1)


def filled(a: Any, b: Any) -> Any:
    cube = np.empty_like(a, shape=(1, 3, WIDTH))
    np.subtract(a, b, out=cube[:, 0])
    cube[:, 1] = b
    cube[:, 2] = np.zeros_like(a)
    return cube.reshape(1, -1)


FUNCTIONS: dict[str, Callable[..., Any]] = {
    "a constant matrix": lambda a, b: a @ MATRIX + b[:, :5],
    "a constant matrix of three rows": lambda a, b: (a.reshape(1, 2, 3) @ MATRIX[:3] * b[:, :2, None]).reshape(1, -1),
    "a sparse matrix": lambda a, b: a @ SPARSE + (b * 2.0) @ SPARSE,
    "a sparse matrix of three rows": lambda a, b: (a.reshape(1, 2, 3)[:, ::-1] @ SPARSE[:3]).reshape(1, -1),
    "two matrices": lambda a, b: (a.reshape(1, 2, 3) @ b.reshape(1, 3, 2)).reshape(1, -1),
    "a matrix and a vector": lambda a, b: np.vecdot(a.reshape(1, 2, 3), b[:, None, :3]),
    "dot": lambda a, b: a.dot(MATRIX) * 2.0 - b[:, 1:],
    "an outer product": lambda a, b: (a[:, :, None] * b[:, None, :]).reshape(1, -1),
    "sums": lambda a, b: np.stack((a.sum(axis=1), b.mean(axis=1)), axis=1),
    "where, clip and interp": lambda a, b: np.where(a > b, np.clip(a, -1.0, 1.0), np.interp(b, ABSCISSAE, ORDINATES)),
    "powers": lambda a, b: np.abs(a) ** 3 - b**2,
    "sine and cosine of one angle": lambda a, b: np.sin(a) * np.cos(a) + np.sin(b),
    "remainder of turns": lambda a, b: a - np.rint(a) + np.floor(b) * np.sign(a),
    "in place": in_place,
    "a filled array": filled,
    "a constant result": lambda a, b: np.ones((1, 2)),
}


@pytest.mark.medium
@pytest.mark.parametrize("name", FUNCTIONS)
@given(seed=st.integers(0, 2**32 - 1), rows=st.sampled_from([1, 2, 3, 8, 19]))
def test_a_recording_gives_what_numpy_gives(name: str, seed: int, rows: int) -> None:
    function, draw = FUNCTIONS[name], np.random.default_rng(seed)
    first, second = draw.normal(scale=3.0, size=(2, rows, WIDTH))
    results = compiled(function)(first, second)
    wanted = [function(first[row : row + 1].copy(), second[row : row + 1].copy()) for row in range(rows)]
    np.testing.assert_allclose(results, np.concatenate(wanted), rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("name", [name for name in ELEMENT_WISE if name != "where"])
def test_each_operation_on_values_is_that_of_numpy(name: str) -> None:
    ufunc: np.ufunc = getattr(np, name)
    draw = np.random.default_rng(2)
    first, second = draw.normal(size=(2, 40, WIDTH))
    first[:, 0], second[0] = np.nan, first[0]
    if name in ("sqrt", "log", "power"):
        first = np.abs(first)
    if name in ("arccos", "arcsin"):
        first = np.clip(first, -1.0, 1.0)
    results = compiled(lambda a, b: ufunc(a) if ufunc.nin == 1 else ufunc(a, b))(first, second)
    numpys = ufunc(first) if ufunc.nin == 1 else ufunc(first, second)
    np.testing.assert_allclose(results, numpys.astype(float), rtol=4e-16, atol=4e-16)


@pytest.mark.medium
@given(arrays(np.float64, (3, WIDTH), elements=st.floats(-1e9, 1e9)))
def test_sine_and_cosine_are_right_to_two_units_in_the_last_place(angles: np.ndarray) -> None:
    results = compiled(lambda a, b: np.concatenate((np.sin(a), np.cos(a), np.sin(b)), axis=1))(angles, angles)
    wanted = np.concatenate((np.sin(angles), np.cos(angles), np.sin(angles)), axis=1)
    assert np.all(np.abs(results - wanted) <= 2.0 * np.spacing(np.abs(wanted)))


def test_sine_and_cosine_of_no_number() -> None:
    angles = np.tile([np.nan, np.inf, -np.inf, 0.0, 1e300, -0.0], (9, 1))
    with np.errstate(invalid="ignore"):
        wanted = np.sin(angles)
    results = compiled(lambda a, _: np.sin(a))(angles, angles)
    np.testing.assert_array_equal(results, wanted)


def test_arc_cosines_at_their_ends_and_beyond() -> None:
    values = np.tile([1.0, -1.0, 0.5, -0.5, 1.0 + 1e-15, -3.0], (9, 1))
    with np.errstate(invalid="ignore"):
        wanted = np.arccos(values)
    results = compiled(lambda a, _: np.arccos(a))(values, values)
    np.testing.assert_allclose(results, wanted, rtol=3e-16, atol=0.0)


@pytest.mark.parametrize("rows", [1, 2, 3, 8, 19])
def test_sums_of_products_have_the_bits_of_separate_operations(rows: int) -> None:
    """Rotations as those of the waves, products that something else needs too, and sums of three products."""

    def rotated(a: Any, b: Any) -> Any:
        shared = a * a
        return np.concatenate((a * b - b * b, a * 0.5 + b * a, shared + b * 2.0, shared, a * b + b + a * a), axis=1)

    first, second = np.random.default_rng(rows).normal(size=(2, rows, WIDTH))
    np.testing.assert_array_equal(compiled(rotated)(first, second), rotated(first, second))


def test_a_row_has_the_same_result_alone_and_among_others() -> None:
    draw = np.random.default_rng(3)
    first, second = draw.normal(size=(2, 21, WIDTH))
    run = compiled(
        lambda a, b: np.concatenate(
            (
                np.cos(a * b) @ MATRIX + np.arctan2(a, b)[:, 1:] * np.arccos(np.tanh(a))[:, 1:] - (a * b)[:, 1:],
                a @ SPARSE,
            ),
            axis=1,
        )
    )
    together = run(first, second)
    alone = np.concatenate([run(first[row : row + 1], second[row : row + 1]) for row in range(21)])
    np.testing.assert_array_equal(together, alone)


def test_earlier_results_stay_as_they_are() -> None:
    run = compiled(lambda a, b: a + b)
    values = np.arange(float(WIDTH))[None]
    results = [run(values, values * number) for number in range(200)]
    for number, result in enumerate(results):
        np.testing.assert_array_equal(result, values * (1 + number))


@pytest.mark.parametrize(
    ("function", "says"),
    [
        (lambda a, b: a if a[0, 0] > 0.0 else b, "a branch on the truth"),
        (lambda a, b: a * float(b[0, 0]), "a conversion to float"),
        (lambda a, b: np.linalg.norm(a), "numpy.norm"),
        (lambda a, b: np.add.reduce(a), "numpy.add by reduce"),
        (lambda a, b: np.add(a, b, out=np.empty((1, WIDTH))), "numpy.add into an array of numpy"),
        (lambda a, b: np.nextafter(a, b), "numpy.nextafter"),
        (lambda a, b: np.interp(1.0, a[0], ORDINATES), "a table that is known only when the step runs"),
        (lambda a, b: a.astype(np.float32), "a conversion to"),
        (lambda a, b: TapeRecorder().input((1, WIDTH)) + a, "two recordings"),
    ],
)
def test_what_cannot_be_recorded_says_so(function: Callable[..., Any], says: str) -> None:
    recorder = TapeRecorder()
    with pytest.raises(NotRecordableError, match=says):
        function(recorder.input((1, WIDTH)), recorder.input((1, WIDTH)))


@pytest.mark.medium
def test_the_kernel_is_compiled_once_into_a_private_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XITL_CACHE", str(tmp_path / "cache"))
    path = compiled_kernel()
    assert path.parent == tmp_path / "cache" / "physics"
    assert stat.S_IMODE(path.parent.stat().st_mode) == 0o700
    made = path.stat().st_mtime_ns
    assert compiled_kernel().stat().st_mtime_ns == made
    assert [entry.name for entry in path.parent.iterdir()] == [path.name]


@pytest.mark.parametrize("part", ["cache", "physics"])
def test_no_kernel_is_taken_from_a_folder_in_which_others_may_write(
    part: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XITL_CACHE", str(tmp_path / "cache"))
    folder = tmp_path / "cache" / "physics"
    folder.mkdir(parents=True)
    writable = folder if part == "physics" else folder.parent
    writable.chmod(0o777)
    with pytest.raises(NoKernelError, match=r"others may write to .*chmod 700"):
        compiled_kernel()


def test_a_machine_without_a_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr(library, "_COMPILERS", ("no-such-compiler",))
    with pytest.raises(NoKernelError, match=r"no C compiler \(no-such-compiler\); install gcc or clang"):
        compiled_kernel()


def test_a_compiler_that_fails(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XITL_CACHE", str(tmp_path / "cache"))
    compiler = tmp_path / "broken"
    compiler.write_text("#!/bin/sh\necho 'fatal error: math.h: No such file' >&2\nexit 1\n")
    compiler.chmod(0o700)
    monkeypatch.setenv("CC", str(compiler))
    with pytest.raises(NoKernelError, match=r"cannot compile kernel\.c: fatal error: math\.h"):
        compiled_kernel()
    assert list((tmp_path / "cache" / "physics").iterdir()) == []


def test_the_switch_chooses_numpy() -> None:
    program = "from sim_core.tape.library import load_kernel\ntry: load_kernel()\nexcept Exception as e: print(e)"
    environment = {**os.environ, library.SWITCH: "numpy"}
    run = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True)
    assert run.stdout == "XITL_PHYSICS=numpy is set; unset it\n"
