"""Settings of a companion, by the standard parameter protocol."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Callable

from agent.fcu.parameters import Parameter, ParameterError, within
from agent.mavlink.exchange import Messages
from agent.mavlink.parameters import ParameterServer

TABLE = (
    Parameter("AVD_ENABLE", 1, 0, 1, "", "1 steers around what is in the way"),
    Parameter("AVD_HORIZON", 12.0, 2.0, 60.0, "s", "how far ahead collisions are looked for"),
    Parameter("AVD_MARGIN", 3.0, 0.5, 30.0, "m", "water kept between hull and obstacle"),
    Parameter("AVD_RANGE", 60.0, 5.0, 260.0, "m", "obstacles farther away are left alone"),
    Parameter("HULL_LENGTH", 2.3, 0.2, 100.0, "m", "of the vessel"),
    Parameter("HULL_WATER", 0.15, -5.0, 10.0, "m", "from the body's origin down to the water at rest"),
    Parameter("HULL_WIDTH", 1.6, 0.1, 50.0, "m", "of the vessel"),
    Parameter("LIDAR_YAW", 0.0, -180.0, 180.0, "deg", "where the lidar looks, clockwise from the bow"),
    Parameter("MAP_CELL", 0.1, 0.02, 5.0, "m", "edge of the cells of the map, one point each"),
    Parameter("MAP_ENABLE", 1, 0, 1, "", "1 keeps a map"),
    Parameter("MAP_RANGE", 60.0, 1.0, 260.0, "m", "farther points are not mapped"),
    Parameter("ODO_AIDED", 1, 0, 1, "", "1 lets the autopilot's attitude and velocity aid the odometry"),
    Parameter("ODO_ENABLE", 1, 0, 1, "", "1 runs the odometry"),
    Parameter("ODO_RANGE", 150.0, 5.0, 260.0, "m", "farther points are not used for it"),
    Parameter("ODO_VOXEL", 1.0, 0.05, 10.0, "m", "edge of the cells of its local map"),
    Parameter("WP_SPEED", 3.0, 0.1, 30.0, "m/s", "of the mission, where it does not say"),
)
_INDEX = {row.name: index for index, row in enumerate(TABLE)}


def checked_parameter(name: str, value: float) -> float:
    """The value as it would be kept. Raises ParameterError for an unknown name, NaN or a value out of range."""
    index = _INDEX.get(name)
    if index is None:
        raise ParameterError(f"{name} is no setting of a companion; use one of {', '.join(_INDEX)}")
    return within(TABLE[index], value)


class CompanionParameters:
    """Values by name; what is set holds from the next run's first cloud, or at once before it.

    refused: hears why a value is refused.
    """

    def __init__(self, refused: Callable[[str], object] = lambda problem: None) -> None:
        self._values = {row.name: float(row.default) for row in TABLE}
        self._refused = refused
        self._server = ParameterServer(
            tuple(_INDEX), self._values.__getitem__, self._set, self._on_refused, per_poll=len(TABLE)
        )

    def __getitem__(self, name: str) -> float:
        return self._values[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def handle(self, message: Any) -> Messages:
        """Answers to PARAM_SET, PARAM_REQUEST_READ and PARAM_REQUEST_LIST."""
        handler = self._server.handlers.get(message.get_msgId())
        return [] if handler is None else [*handler(message, 0), *self._server.poll()]

    def _set(self, name: str, value: float) -> None:
        self._values[name] = checked_parameter(name, value)

    def _on_refused(self, problem: str) -> Messages:
        self._refused(problem)
        return []
