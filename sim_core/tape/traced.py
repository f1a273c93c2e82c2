"""Arrays that record the numpy operations on them.

    recorder = TapeRecorder()
    position = recorder.input((1, 3))
    result = function(position)  # a numpy function
    recorder.operations  # each operation that the function did

An array holds the numbers of its values. Indexing, reshaping, broadcasting and joining move these numbers and record
nothing. An operation that needs the values themselves, such as a branch, raises NotRecordableError.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, Never

import numpy as np
from numpy import float64, int64
from numpy.lib.mixins import NDArrayOperatorsMixin
from numpy.typing import NDArray

from sim_core.dataclass import dataclass
from sim_core.frames import Array

Numbers = NDArray[int64]

ELEMENT_WISE = (
    *("negative", "absolute", "sqrt", "sin", "cos", "rint", "isnan", "logical_not", "floor", "sign", "square"),
    *("exp", "log", "tan", "tanh", "arccos", "arcsin", "arctan", "cbrt", "expm1"),
    *("add", "subtract", "multiply", "divide", "maximum", "minimum", "less", "less_equal", "greater"),
    *("greater_equal", "equal", "not_equal", "logical_and", "logical_or", "arctan2", "power", "hypot", "where"),
)
"""Operations on each value, in the order of kernel.c."""
MATMUL, DOT, INTERP, SIN_COS = "matmul", "dot", "interp", "sin_cos"
SUM_OF_PRODUCTS, DIFFERENCE_OF_PRODUCTS, SPARSE = "sum_of_products", "difference_of_products", "sparse"
OPERATIONS = (*ELEMENT_WISE, MATMUL, DOT, INTERP, SIN_COS, SUM_OF_PRODUCTS, DIFFERENCE_OF_PRODUCTS, SPARSE)


class NotRecordableError(Exception):
    """A function needs more than recorded operations. The text names what."""


@dataclass(frozen=True, slots=True, eq=False)
class TapeOperation:
    """One operation on arrays."""

    name: str
    """One of OPERATIONS."""
    result: Numbers
    """Numbers of the result's values, (count,), consecutive."""
    operands: tuple[Numbers, ...]
    """Numbers of the operands' values: (count,); (rows * inner,) for matmul; two of (terms * count,) for dot."""
    tables: tuple[Array, ...] = ()
    """Constants that are not values: the matrix of matmul, (inner, columns); abscissae and ordinates of interp."""


class TapeRecorder:
    """Numbers all values and keeps the operations in their order."""

    def __init__(self) -> None:
        self.operations: list[TapeOperation] = []
        self.constants: dict[int, float] = {}
        self.inputs: list[Numbers] = []
        self._next = 0
        self._same: dict[bytes, Numbers] = {}

    def input(self, shape: tuple[int, ...]) -> Any:
        """Return a `Traced` array whose values are given at each run. It stands for an array of numpy."""
        numbers = self._new(int(np.prod(shape)))
        self.inputs.append(numbers)
        return self._array(numbers, shape)

    def numbers(self, values: Traced | Array | float) -> Numbers:
        """Return the numbers of an array, which are new for constants."""
        if isinstance(values, Traced):
            if values.recorder is not self:
                raise NotRecordableError("two recordings are mixed")
            return values.cells
        array = np.asarray(values, dtype=float64)
        key = array.tobytes()
        if key not in self._same:
            numbers = self._new(array.size)
            self.constants.update(zip(numbers.tolist(), array.ravel().tolist(), strict=True))
            self._same[key] = numbers
        return self._same[key].reshape(array.shape)

    def apply(self, name: str, *operands: Traced | Array | float) -> Traced:
        """Record an operation on each value."""
        cells = np.broadcast_arrays(*(self.numbers(operand) for operand in operands))
        result = self._new(cells[0].size)
        self.operations.append(TapeOperation(name, result, tuple(cell.flatten() for cell in cells)))
        return self._array(result, cells[0].shape)

    def matmul(self, left: Numbers, matrix: Array) -> Traced:
        """Record (..., inner) @ (inner, columns) with a constant matrix."""
        inner, columns = matrix.shape
        result = self._new(left.size // inner * columns)
        constant = np.ascontiguousarray(matrix, dtype=float64)
        self.operations.append(TapeOperation(MATMUL, result, (left.flatten(),), (constant,)))
        return self._array(result, (*left.shape[:-1], columns))

    def dot(self, left: Numbers, right: Numbers) -> Traced:
        """Record the sums over the last axis of the products of two (..., terms)."""
        left, right = np.broadcast_arrays(left, right)
        *shape, terms = left.shape
        result = self._new(left.size // terms)
        first, second = (np.moveaxis(side, -1, 0).flatten() for side in (left, right))
        self.operations.append(TapeOperation(DOT, result, (first, second), (np.empty(terms),)))
        return self._array(result, tuple(shape))

    def interp(self, x: Traced, abscissae: Array, ordinates: Array) -> Traced:
        """Record a linear interpolation in a constant table."""
        result = self._new(x.size)
        tables = (np.array(abscissae, dtype=float64), np.array(ordinates, dtype=float64))
        self.operations.append(TapeOperation(INTERP, result, (x.cells.flatten(),), tables))
        return self._array(result, x.shape)

    def _array(self, numbers: Numbers, shape: tuple[int, ...]) -> Traced:
        return Traced(self, numbers.reshape(shape).copy())  # assignments change the array, and not the operation

    def _new(self, count: int) -> Numbers:
        first = self._next
        self._next += count
        return np.arange(first, self._next)


class Traced(NDArrayOperatorsMixin):
    """An array of recorded values. It supports what numpy code does with an array, except to look at the values."""

    __slots__ = ("cells", "recorder")
    __array_priority__ = 1000.0

    def __init__(self, recorder: TapeRecorder, cells: Numbers) -> None:
        self.recorder = recorder
        self.cells = cells

    # What numpy code asks of an array

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape, with one vessel."""
        return self.cells.shape

    @property
    def ndim(self) -> int:
        """Number of axes."""
        return self.cells.ndim

    @property
    def size(self) -> int:
        """Number of values."""
        return self.cells.size

    @property
    def T(self) -> Traced:  # noqa: N802  numpy's name
        """Transposed view."""
        return Traced(self.recorder, self.cells.T)

    def __len__(self) -> int:
        return len(self.cells)

    def __getitem__(self, key: Any) -> Traced:
        return Traced(self.recorder, np.asarray(self.cells[key]))

    def __setitem__(self, key: Any, value: Traced | Array | float) -> None:
        self.cells[key] = self.recorder.numbers(value)

    def reshape(self, *shape: Any) -> Traced:
        """Return the same values in another shape."""
        return Traced(self.recorder, self.cells.reshape(*shape))

    def copy(self) -> Traced:
        """Return an array that later assignments leave unchanged."""
        return Traced(self.recorder, self.cells.copy())

    def astype(self, dtype: Any) -> Traced:
        """Return a copy. All recorded values are of float64."""
        if dtype is not float64:
            raise NotRecordableError(f"a conversion to {dtype}")
        return self.copy()

    def dot(self, other: Traced | Array) -> Traced:
        """Return the matrix product."""
        return _matmul(self.recorder, self, other)

    def sum(self, axis: int | None = None, keepdims: bool = False) -> Traced:
        """Return the sum over an axis, or over all values."""
        cells = self.cells.ravel() if axis is None else np.moveaxis(self.cells, axis, -1)
        total = self.recorder.dot(cells, self.recorder.numbers(1.0))
        return Traced(self.recorder, np.expand_dims(total.cells, axis)) if keepdims and axis is not None else total

    def mean(self, axis: int | None = None) -> Traced:
        """Return the mean over an axis, or over all values."""
        total = self.sum(axis)
        return self.recorder.apply("divide", total, float(self.size // max(total.size, 1)))

    # What only values could answer

    def _refuse(self, what: str) -> Never:
        raise NotRecordableError(f"{what} of a value that is known only when the step runs")

    def __bool__(self) -> bool:
        self._refuse("a branch on the truth")

    def __float__(self) -> float:
        self._refuse("a conversion to float")

    def __int__(self) -> int:
        self._refuse("a conversion to int")

    def __array__(self, *_: Any, **__: Any) -> Array:
        self._refuse("a conversion to an array")

    # What numpy does with it

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **options: Any) -> Traced:
        out = options.pop("out", (None,))[0]
        if method != "__call__" or options:
            raise NotRecordableError(f"numpy.{ufunc.__name__} by {method} with {', '.join(options) or 'no options'}")
        recorder = self.recorder
        if ufunc is np.matmul:
            result = _matmul(recorder, *inputs)
        elif ufunc is np.vecdot:
            result = recorder.dot(*(recorder.numbers(value) for value in inputs))
        elif ufunc is np.power and isinstance(inputs[1], int | float) and inputs[1] in (2, 3):
            result = inputs[0] * inputs[0] if inputs[1] == 2 else inputs[0] * inputs[0] * inputs[0]
        elif ufunc.__name__ in ELEMENT_WISE:
            result = recorder.apply(ufunc.__name__, *inputs)
        else:
            raise NotRecordableError(f"numpy.{ufunc.__name__}")
        if out is None:
            return result
        if not isinstance(out, Traced):
            raise NotRecordableError(f"numpy.{ufunc.__name__} into an array of numpy")
        out.cells[...] = result.cells
        return out

    def __array_function__(
        self, function: Callable[..., Any], types: Any, arguments: Sequence[Any], options: dict[str, Any]
    ) -> Traced:
        record = _FUNCTIONS.get(function)
        if record is None:
            raise NotRecordableError(f"numpy.{function.__name__}")
        traced: Traced = record(self.recorder, *arguments, **options)
        return traced


def _matmul(recorder: TapeRecorder, left: Traced | Array, right: Traced | Array) -> Traced:
    """Record `left @ right`."""
    if isinstance(left, Traced) and not isinstance(right, Traced) and right.ndim == 2:
        return recorder.matmul(left.cells, right)
    first, second = recorder.numbers(left), recorder.numbers(right)
    if second.ndim == 1:
        return recorder.dot(first, second)
    if first.ndim == 1:
        return recorder.dot(first, np.swapaxes(second, -1, -2))
    return recorder.dot(first[..., :, None, :], np.swapaxes(second, -1, -2)[..., None, :, :])


def _joined(recorder: TapeRecorder, arrays: Sequence[Traced | Array], axis: int = 0) -> Traced:
    return Traced(recorder, np.concatenate([recorder.numbers(array) for array in arrays], axis=axis))


def _stacked(recorder: TapeRecorder, arrays: Sequence[Traced | Array], axis: int = 0) -> Traced:
    return Traced(recorder, np.stack([recorder.numbers(array) for array in arrays], axis=axis))


def _filled(value: float) -> Callable[..., Traced]:
    def filled(recorder: TapeRecorder, like: Traced, shape: tuple[int, ...] | None = None) -> Traced:
        number = recorder.numbers(value)
        return Traced(recorder, np.full(like.shape if shape is None else shape, number))

    return filled


def _where(recorder: TapeRecorder, *operands: Traced | Array | float) -> Traced:
    if len(operands) != 3:
        raise NotRecordableError("numpy.where without values")
    return recorder.apply("where", *operands)


def _clip(recorder: TapeRecorder, values: Traced, low: Traced | Array | float, high: Traced | Array | float) -> Traced:
    return recorder.apply("minimum", recorder.apply("maximum", values, low), high)


def _interp(recorder: TapeRecorder, x: Traced, abscissae: Array, ordinates: Array) -> Traced:
    if isinstance(abscissae, Traced) or isinstance(ordinates, Traced):
        raise NotRecordableError("numpy.interp in a table that is known only when the step runs")
    return recorder.interp(x, abscissae, ordinates)


def _same_cells(function: Callable[..., Any]) -> Callable[..., Traced]:
    def moved(recorder: TapeRecorder, values: Traced, *arguments: Any, **options: Any) -> Traced:
        return Traced(recorder, function(values.cells, *arguments, **options))

    return moved


_FUNCTIONS: dict[Callable[..., Any], Callable[..., Traced]] = {
    np.concatenate: _joined,
    np.stack: _stacked,
    np.empty_like: _filled(0.0),
    np.zeros_like: _filled(0.0),
    np.ones_like: _filled(1.0),
    np.where: _where,
    np.clip: _clip,
    np.interp: _interp,
    np.moveaxis: _same_cells(np.moveaxis),
    np.swapaxes: _same_cells(np.swapaxes),
    np.expand_dims: _same_cells(np.expand_dims),
    np.broadcast_to: _same_cells(np.broadcast_to),
    np.dot: _matmul,
}
