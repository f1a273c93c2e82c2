"""A recorded function, encoded for kernel.c.

The code is a list of 32-bit integers. Each operation is its number, the count of its values, the first value of its
result, the number of operands, and for each operand where it lies and a number: RUN and the first of consecutive
values, SAME and the one value, TABLE and a place in the table of values. Then follow the sizes and places that kernel.c
names.
"""

from __future__ import annotations

import ctypes
import math
import threading
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy import float64, int32
from numpy.typing import NDArray

from sim_core.frames import Array
from sim_core.tape.library import Kernel
from sim_core.tape.traced import (
    DIFFERENCE_OF_PRODUCTS,
    DOT,
    ELEMENT_WISE,
    INTERP,
    MATMUL,
    OPERATIONS,
    SIN_COS,
    SPARSE,
    SUM_OF_PRODUCTS,
    Numbers,
    TapeOperation,
    TapeRecorder,
    Traced,
)

_RUN, _SAME, _TABLE = range(3)
_LANES = (1, 8)
_PARTS = 64  # rows of results that are made at once
_ALONE = (0, 0)  # no later steps
Results = tuple[Any, ...]
"""An array (rows, columns) of all results, its address, and its part for each output, (rows, ...)."""
_LONG = 16  # values that are worth an operation of their own
_SPLIT = {*ELEMENT_WISE, SUM_OF_PRODUCTS, DIFFERENCE_OF_PRODUCTS}
_OF_PRODUCTS = {"add": SUM_OF_PRODUCTS, "subtract": DIFFERENCE_OF_PRODUCTS}


class _Tape(ctypes.Structure):
    """The structure `tape` of kernel.c."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("code", "tables", "matrices", "outputs")),
        *((name, ctypes.c_int64) for name in ("operations", "constants", "state_inputs")),
        *((name, ctypes.c_int64) for name in ("other_inputs", "step_inputs", "output_count", "room_size")),
    )


def _aligned(count: int) -> Array:
    """Return zeros that begin with a line of the cache: vectors across two lines take a fifth more time."""
    line = 64
    room = np.zeros(count + line // 8)
    first = -room.ctypes.data % line // room.itemsize
    return room[first : first + count]


class _Room:
    """Working memory of one thread."""

    def __init__(self, constants: Array, values: int, operands: int) -> None:
        self.other: dict[int, tuple[Array, int]] = {}
        """For each number of rows, the array of the other inputs and its address."""
        self.results: dict[int, Iterator[Results]] = {}
        """For each number of rows, new arrays for results."""
        self._arrays: list[Array] = []
        for lanes in _LANES:
            of_lanes = _aligned(values * lanes).reshape(values, lanes)
            of_lanes[: len(constants)] = constants[:, None]
            self._arrays += [of_lanes, _aligned(4 * operands * lanes)]
        self.addresses = tuple(array.ctypes.data for array in self._arrays)
        self._later, self._later_address = np.empty((0, 0)), 0

    def later_address(self, inputs: Sequence[Sequence[float]]) -> int:
        """Return the address of the step inputs (K, I) of further steps."""
        count, width = len(inputs), len(inputs[0])
        if count > len(self._later):
            self._later = np.empty((count, width))
            self._later_address = self._later.ctypes.data
        self._later[:count] = inputs
        return self._later_address


def _new_results(rows: int, shapes: Sequence[tuple[int, ...]]) -> Iterator[Results]:
    """Yield new arrays for the results of N rows. Small ones are parts of one, which costs less."""
    ends = np.cumsum([math.prod(shape) for shape in shapes]).tolist()
    reshaped = [number for number, shape in enumerate(shapes) if len(shape) != 1]
    parts = max(_PARTS // rows, 1)
    while True:
        block = np.empty((parts, rows, ends[-1]))
        size = block.itemsize * rows * ends[-1]
        addresses = range(block.ctypes.data, block.ctypes.data + parts * size, size)
        outputs = [block[:, :, start:end] for start, end in pairwise([0, *ends])]
        for number in reshaped:
            outputs[number] = outputs[number].reshape(parts, rows, *shapes[number])
        yield from zip(block, addresses, *outputs, strict=True)


class Program:
    """A recorded function of (N, state) and (N, other) inputs that returns (N, outputs).

    recorder: its first input is the row of the state, its second input the other values.
    outputs: the arrays of one vessel to return, in this order. They begin with the state after the step.
    step_inputs: number of the other values, at their beginning, that differ from step to step.
    """

    def __init__(
        self, kernel: Kernel, recorder: TapeRecorder, outputs: Sequence[Traced | Array], step_inputs: int = 0
    ) -> None:
        self._run = kernel.run_tape
        state, other = recorder.inputs
        wanted = np.concatenate([recorder.numbers(output).ravel() for output in outputs])
        operations = _paired(_with_products(_needed(recorder.operations, wanted), wanted))
        # Places of the values: constants, inputs, results
        constants = sorted(recorder.constants)
        fixed = np.concatenate([np.array(constants, dtype=np.int64), state, other])
        place = _places(fixed, operations, wanted)
        operations = [part for operation in operations for part in _parts(operation, place)]
        # The code
        tables: list[NDArray[int32]] = []
        matrices: list[Array] = []
        code = [number for operation in operations for number in _encoded(operation, place, tables, matrices)]
        self._shapes = [output.shape[1:] for output in outputs]
        self._code, self._tables, self._matrices, self._outputs = (
            np.array(code, dtype=int32),
            np.concatenate([np.zeros(0, int32), *tables]),
            np.concatenate([np.zeros(0), *matrices]),
            place[wanted].astype(int32),
        )
        room = max([operand.size for operation in operations for operand in operation.operands], default=1)
        self._tape = _Tape(
            *(array.ctypes.data for array in (self._code, self._tables, self._matrices, self._outputs)),
            *(len(operations), len(constants), len(state), len(other), step_inputs, len(wanted), room),
        )
        self._address = ctypes.addressof(self._tape)
        self._constants = np.array([recorder.constants[number] for number in constants])
        self._values, self._operands, self._other = int(place.max()) + 1, room, len(other)
        self._threads = threading.local()

    def other(self, rows: int) -> Array:
        """Return this thread's (rows, other) array. Fill it before `run`."""
        room = self._room_of_thread()
        if rows not in room.other:
            array = np.empty((rows, self._other))
            room.other[rows] = array, array.ctypes.data
            room.results[rows] = _new_results(rows, self._shapes)
        return room.other[rows][0]

    def run(self, rows: int, state_address: int, state_columns: int, later: Sequence[Sequence[float]] = ()) -> Results:
        """Return the results after one step and a further one for each of `later`, in new arrays.

        The state lies at an address, (rows, state_columns) of float64, of which the first columns are the inputs.
        later: the step inputs of each further step. All other values stay.
        """
        room = self._room_of_thread()
        results = next(room.results[rows])
        other_address, count = room.other[rows][1], len(later)
        steps = (count, room.later_address(later)) if count else _ALONE
        self._run(self._address, rows, state_columns, state_address, other_address, results[1], *steps, *room.addresses)
        return results

    def _room_of_thread(self) -> _Room:
        room: _Room | None = getattr(self._threads, "room", None)
        if room is None:
            room = self._threads.room = _Room(self._constants, self._values, self._operands)
        return room


def _needed(operations: Sequence[TapeOperation], wanted: Numbers) -> list[TapeOperation]:
    """Return the operations on which the wanted values depend, in their order."""
    needed = set(wanted.tolist())
    kept = []
    for operation in reversed(operations):
        if not needed.isdisjoint(operation.result.tolist()):
            kept.append(operation)
            for operand in operation.operands:
                needed.update(operand.tolist())
    return kept[::-1]


def _with_products(operations: Sequence[TapeOperation], wanted: Numbers) -> list[TapeOperation]:
    """Return the operations with each sum and difference of two products as one, which has the same result."""
    values = max([int(wanted.max(initial=-1)), *(int(operation.result.max()) for operation in operations)]) + 1
    uses = np.zeros(values, dtype=int)
    np.add.at(uses, wanted, 1)
    for operation in operations:
        for operand in operation.operands:
            np.add.at(uses, operand, 1)
    factors = np.full((values, 2), -1)
    fused = []
    for operation in operations:
        if operation.name == "multiply":
            factors[operation.result] = np.stack(operation.operands, axis=1)
        elif operation.name in _OF_PRODUCTS and all(
            (factors[part, 0] >= 0).all() and (uses[part] == 1).all() for part in operation.operands
        ):
            of_products = tuple(factors[part, side] for part in operation.operands for side in (0, 1))
            operation = TapeOperation(_OF_PRODUCTS[operation.name], operation.result, of_products)
        fused.append(operation)
    return _needed(fused, wanted)


def _paired(operations: Sequence[TapeOperation]) -> list[TapeOperation]:
    """Return the operations with sine and cosine of equal angles as one."""
    paired: list[TapeOperation] = []
    first: dict[bytes, int] = {}
    for operation in operations:
        if operation.name not in ("sin", "cos"):
            paired.append(operation)
            continue
        angles = operation.operands[0].tobytes()
        index = first.setdefault(angles, len(paired))
        if index == len(paired) or paired[index].name in (SIN_COS, operation.name):
            paired.append(operation)
            continue
        both = sorted((paired[index], operation), key=lambda part: part.name == "cos")
        paired[index] = TapeOperation(SIN_COS, np.concatenate([part.result for part in both]), operation.operands)
    return paired


def _places(fixed: Numbers, operations: Sequence[TapeOperation], wanted: Numbers) -> Numbers:
    """Return the place of each value. A result takes the place of results that are needed no more.

    fixed: the values that keep the first places.
    """
    values = max([int(fixed.max(initial=-1)), *(int(operation.result.max()) for operation in operations)]) + 1
    # The last operation that needs each value
    last = np.full(values, -1)
    for number, operation in enumerate(operations):
        for operand in operation.operands:
            last[operand] = number
    last[wanted] = len(operations)
    # Places for each result, which it gives back after that operation
    place = np.full(values, -1)
    place[fixed] = np.arange(len(fixed))
    free = [(len(fixed), sum(operation.result.size for operation in operations))]
    given_back: dict[int, list[tuple[int, int]]] = {}
    for number, operation in enumerate(operations):
        wide = operation.result.size
        index = next(index for index, (_, size) in enumerate(free) if size >= wide)
        first, size = free[index]
        free[index : index + 1] = [(first + wide, size - wide)] if size > wide else []
        place[operation.result] = np.arange(first, first + wide)
        given_back.setdefault(max(int(last[operation.result].max()), number), []).append((first, wide))
        free = _merged([*free, *given_back.pop(number, [])])
    return place


def _merged(spans: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """Return spans of places (first, size) in order, neighbours joined."""
    merged: list[tuple[int, int]] = []
    for first, size in sorted(spans):
        if merged and sum(merged[-1]) == first:
            merged[-1] = merged[-1][0], merged[-1][1] + size
        else:
            merged.append((first, size))
    return merged


def _parts(operation: TapeOperation, place: Numbers) -> list[TapeOperation]:
    """Return an operation on values as parts with consecutive operands, if these are long.

    Values that repeat for each point of a hull need not be gathered then.
    """
    length = operation.result.size
    for operand in operation.operands if operation.name in _SPLIT else ():
        steps = np.diff(place[operand])
        if steps.any():
            length = math.gcd(length, *(np.flatnonzero(steps != 1) + 1).tolist())
    if not _LONG <= length < operation.result.size:
        return [operation]
    slices = [slice(start, start + length) for start in range(0, operation.result.size, length)]
    return [
        TapeOperation(operation.name, operation.result[part], tuple(operand[part] for operand in operation.operands))
        for part in slices
    ]


def _encoded(
    operation: TapeOperation, place: Numbers, tables: list[NDArray[int32]], matrices: list[Array]
) -> list[int]:
    if operation.name == MATMUL and 2 * np.count_nonzero(operation.tables[0]) < operation.tables[0].size:
        return _sparse(operation, place, tables, matrices)
    count = operation.operands[0].size if operation.name == SIN_COS else operation.result.size
    code = [OPERATIONS.index(operation.name), count, int(place[operation.result[0]])]
    code.append(len(operation.operands))
    for operand in operation.operands:
        code += _operand(place[operand], tables)
    if operation.name == DOT:
        code.append(operation.tables[0].size)
    elif operation.name == MATMUL:
        code += [*operation.tables[0].shape, _stored(operation.tables[0], matrices)]
    elif operation.name == INTERP:
        abscissae, ordinates = operation.tables
        code += [abscissae.size, _stored(abscissae, matrices), _stored(ordinates, matrices)]
    return code


def _sparse(operation: TapeOperation, place: Numbers, tables: list[NDArray[int32]], matrices: list[Array]) -> list[int]:
    """Encode a product with a matrix of mostly zeros by its other terms, which the kernel sums in the same order."""
    (matrix,) = operation.tables
    columns = [(np.flatnonzero(column), column[column != 0.0]) for column in matrix.T]
    rows = place[operation.operands[0]].reshape(-1, len(matrix))
    terms = [np.concatenate([[used.size], row[used]]) for row in rows for used, _ in columns]
    factors = [values for _ in rows for _, values in columns]
    start = sum(table.size for table in tables)
    tables.append(np.concatenate(terms).astype(int32))
    code = [OPERATIONS.index(SPARSE), operation.result.size, int(place[operation.result[0]]), 0]
    return [*code, start, _stored(np.concatenate(factors), matrices)]


def _operand(places: Numbers, tables: list[NDArray[int32]]) -> tuple[int, int]:
    first = int(places[0])
    if (places == first).all():
        return (_SAME, first) if places.size > 1 else (_RUN, first)
    if (np.diff(places) == 1).all():
        return _RUN, first
    start = sum(table.size for table in tables)
    tables.append(places.astype(int32))
    return _TABLE, start


def _stored(values: Array, matrices: list[Array]) -> int:
    start = sum(matrix.size for matrix in matrices)
    matrices.append(values.astype(float64).ravel())
    return start
