"""A recorded function, encoded for kernel.c.

The code is a list of 32-bit integers. Each operation is its number, the count of its values, the first value of its
result, the number of operands, and for each operand where it lies and a number: RUN and the first of consecutive
values, SAME and the one value, TABLE and a place in the table of values. Then follow the sizes and places that kernel.c
names.
"""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy import float64, int32
from numpy.typing import NDArray

from sim_core.frames import Array
from sim_core.tape.library import Kernel
from sim_core.tape.traced import DOT, INTERP, MATMUL, OPERATIONS, Numbers, Operation, Recorder, Traced

_RUN, _SAME, _TABLE = range(3)
_LANES = (1, 8)


class _Tape(ctypes.Structure):
    """The structure `tape` of kernel.c."""

    _fields_ = (
        *((name, ctypes.c_void_p) for name in ("code", "tables", "matrices", "outputs")),
        *((name, ctypes.c_int64) for name in ("operations", "constants", "state_inputs")),
        *((name, ctypes.c_int64) for name in ("other_inputs", "output_count", "room_size")),
    )


class _Room(NamedTuple):
    """Working memory of one thread."""

    arrays: tuple[Array, ...]
    addresses: tuple[int, ...]


class Program:
    """A recorded function of (N, state) and (N, other) inputs that returns (N, outputs).

    recorder: its first input is the row of the state, its second input the other values.
    outputs: the arrays of one vessel to return, in this order.
    """

    def __init__(self, kernel: Kernel, recorder: Recorder, outputs: Sequence[Traced | Array]) -> None:
        self._kernel = kernel
        state, other = recorder.inputs
        wanted = np.concatenate([recorder.numbers(output).ravel() for output in outputs])
        operations = _needed(recorder.operations, wanted)
        # Places of the values: constants, inputs, results
        constants = sorted(recorder.constants)
        order = np.concatenate([np.array(constants, dtype=np.int64), state, other, *(o.result for o in operations)])
        place = np.full(int(order.max()) + 1, -1)
        place[order] = np.arange(len(order))
        # The code
        tables: list[NDArray[int32]] = []
        matrices: list[Array] = []
        code = [number for operation in operations for number in _encoded(operation, place, tables, matrices)]
        self.outputs = len(wanted)
        self._code, self._tables, self._matrices, self._outputs = (
            np.array(code, dtype=int32),
            np.concatenate([np.zeros(0, int32), *tables]),
            np.concatenate([np.zeros(0), *matrices]),
            place[wanted].astype(int32),
        )
        room = max([operand.size for operation in operations for operand in operation.operands], default=1)
        self._tape = _Tape(
            *(array.ctypes.data for array in (self._code, self._tables, self._matrices, self._outputs)),
            *(len(operations), len(constants), len(state), len(other), self.outputs, room),
        )
        self._address = ctypes.addressof(self._tape)
        self._constants = np.array([recorder.constants[number] for number in constants])
        self._values, self._room = len(order), room
        self._threads = threading.local()

    def run(self, state: Array, other: Array) -> Array:
        """Return (N, outputs). Both inputs are contiguous, of float64. `state` may have more columns than are read."""
        room = getattr(self._threads, "room", None) or self._make_room()
        rows = len(state)
        outputs = np.empty((rows, self.outputs))
        self._kernel.run_tape(
            self._address,
            rows,
            state.shape[1],
            state.ctypes.data,
            other.ctypes.data,
            outputs.ctypes.data,
            *room.addresses,
        )
        return outputs

    def _make_room(self) -> _Room:
        arrays: list[Array] = []
        for lanes in _LANES:
            values = np.zeros((self._values, lanes))
            values[: len(self._constants)] = self._constants[:, None]
            arrays += [values, np.empty(3 * self._room * lanes)]
        room = _Room(tuple(arrays), tuple(array.ctypes.data for array in arrays))
        self._threads.room = room
        return room


def _needed(operations: Sequence[Operation], wanted: Numbers) -> list[Operation]:
    """Return the operations on which the wanted values depend, in their order."""
    needed = set(wanted.tolist())
    kept = []
    for operation in reversed(operations):
        if not needed.isdisjoint(operation.result.tolist()):
            kept.append(operation)
            for operand in operation.operands:
                needed.update(operand.tolist())
    return kept[::-1]


def _encoded(operation: Operation, place: Numbers, tables: list[NDArray[int32]], matrices: list[Array]) -> list[int]:
    code = [OPERATIONS.index(operation.name), operation.result.size, int(place[operation.result[0]])]
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
