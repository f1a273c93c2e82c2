"""Sensors of the same model on several vessels of a fleet, measured together.

A sample of one vessel costs as much as one of all vessels. Every vessel keeps its own random generator and gets the
values that it would get alone.
"""

from __future__ import annotations

from dataclasses import fields
from typing import Any, TypeVar

import numpy as np
from numpy.random import Generator

from sim_core.frames import Array
from sim_core.kinematics import Kinematics
from sim_core.simulation import Simulation, SimulationState

T = TypeVar("T")

DRAWN_AHEAD = 64
"""Samples for which a generator draws at once: one call for many numbers takes a fraction of the time."""


class FleetNormals:
    """Standard normal numbers of M generators, row by row, as a sensor model of M vessels asks for them.

    Each generator gives the numbers of its own calls in the same order.
    """

    def __init__(self, generators: list[Generator]) -> None:
        self._generators = generators
        self._drawn: Array = np.empty((0, len(generators), 0))
        self._next = 0

    def standard_normal(self, shape: tuple[int, int]) -> Array:
        """Return (M, K) numbers; every call must ask for the same shape."""
        if self._next == len(self._drawn):
            drawn = [generator.standard_normal((DRAWN_AHEAD, shape[1])) for generator in self._generators]
            self._drawn, self._next = np.stack(drawn, axis=1), 0
        numbers: Array = self._drawn[self._next]
        self._next += 1
        return numbers


class FleetSensor:
    """A sensor model on M vessels. `add` all vessels before the first measurement."""

    def __init__(self, sensor: Any) -> None:
        self._sensor = sensor
        self._rows: list[int] = []
        self._generators: list[Generator] = []
        self._states: list[Any] = []
        self._state: Any = None
        self._sample: Any = None
        self._time_ns = -1

    def add(self, row: int, generator: Generator) -> int:
        """Add the vessel in this row of the state; return the row of its samples."""
        self._rows.append(row)
        self._generators.append(generator)
        self._states.append(self._sensor.initial(1, generator))
        return len(self._rows) - 1

    def measure(self, simulation: Simulation, state: SimulationState) -> Any:
        """Return the sample of all vessels (M, ...) at this state. It is taken once for an instant."""
        if state.time_ns == self._time_ns:
            return self._sample
        if self._time_ns < 0:
            self._state, self._normals = joined(self._states), FleetNormals(self._generators)
        self._time_ns = state.time_ns
        motion = state.vessel.motion
        if self._rows != list(range(len(motion.pos_ned_m))):
            rows = np.array(self._rows)
            motion = Kinematics(*(getattr(motion, field.name)[rows] for field in fields(Kinematics)))
        self._state, self._sample = self._sensor.measure(self._state, motion, self._normals)
        return self._sample


def joined(records: list[T]) -> T:
    """Join records of arrays of one row each."""
    kind: Any = type(records[0])
    names = [field.name for field in fields(kind)]
    whole: T = kind(*(np.concatenate([getattr(record, name) for record in records]) for name in names))
    return whole


def row_of(record: T, row: int) -> T:
    """Return one row of a record of arrays."""
    kind: Any = type(record)
    own: T = kind(*(getattr(record, field.name)[row : row + 1] for field in fields(kind)))
    return own
