"""Point clouds of a recording, against points that were packed into them."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
import pytest

from sim_core.frames import euler_to_quat
from xitl_cli.plugins.view.tracks import MOST_CLOUD_POINTS, GrowingMap, packed_points

FLOAT32, UINT8 = 7, 1


class Clouds:
    """A table of foxglove.PointCloud: x, y, z and intensity, in 16 bytes of which the last three are empty."""

    FIELDS = (("x", 0, FLOAT32), ("y", 4, FLOAT32), ("z", 8, FLOAT32), ("intensity", 12, UINT8))

    def __init__(self, *clouds: list[tuple[float, float, float, int]]) -> None:
        self.stamp_ns = np.arange(len(clouds), dtype=np.int64) * 1_000_000_000
        self._columns: dict[str, list[Any]] = {
            "data": [b"".join(struct.pack("<fffB3x", *point) for point in cloud) for cloud in clouds],
            "point_stride": [16] * len(clouds),
        }
        for number, field in enumerate(self.FIELDS):
            for part, value in zip(("name", "offset", "type"), field, strict=True):
                self._columns[f"fields[{number}].{part}"] = [value] * len(clouds)

    @property
    def columns(self) -> tuple[str, ...]:
        return tuple(self._columns)

    def __len__(self) -> int:
        return len(self.stamp_ns)

    def values(self, column: str, rows: np.ndarray) -> list[Any]:
        return [self._columns[column][row] for row in rows]


def seconds(stamp_ns: np.ndarray) -> np.ndarray:
    return stamp_ns * 1e-9


def test_the_fields_of_a_cloud_are_those_that_were_packed() -> None:
    table: Any = Clouds([(1.0, 2.0, 3.0, 7), (4.0, 5.0, 6.0, 255)], [(-1.5, 0.25, 8.0, 0)])
    points = packed_points(table, 0)
    assert points.dtype.names == ("x", "y", "z", "intensity")
    assert points.tolist() == [(1.0, 2.0, 3.0, 7), (4.0, 5.0, 6.0, 255)]
    assert packed_points(table, 1).tolist() == [(-1.5, 0.25, 8.0, 0)]


@pytest.mark.parametrize("lacking", ["fields[0].name", "fields[2].name"])
def test_a_cloud_without_an_axis_has_no_points(lacking: str) -> None:
    table: Any = Clouds([(1.0, 2.0, 3.0, 7)])
    del table._columns[lacking]
    assert len(packed_points(table, 0)) == 0


def test_a_map_grows_by_the_points_of_each_message_in_the_map_of_the_scene() -> None:
    table: Any = Clouds([(1.0, 0.0, 0.0, 0)], [(0.0, 2.0, 0.0, 0), (0.0, 0.0, 3.0, 0)])
    east = euler_to_quat(np.array([[0.0, 0.0, np.pi / 2]]))[0]
    growing = GrowingMap(table, seconds, np.array([10.0, 20.0, 30.0]), east)
    assert growing.at(-0.1) is None
    first, both = growing.at(0.5), growing.at(1.0)
    np.testing.assert_allclose(first, [[10.0, 21.0, 30.0]], atol=1e-5)
    np.testing.assert_allclose(both, [[10.0, 21.0, 30.0], [8.0, 20.0, 30.0], [10.0, 20.0, 33.0]], atol=1e-5)


@pytest.mark.medium
def test_a_large_map_is_thinned_and_still_grows() -> None:
    many = MOST_CLOUD_POINTS
    table: Any = Clouds([(float(n), 0.0, 0.0, 0) for n in range(many)], [(-1.0, 0.0, 0.0, 0)] * many)
    growing = GrowingMap(table, seconds, np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0]))
    first, both = growing.at(0.5), growing.at(1.5)
    assert first is not None
    assert both is not None
    assert (len(first), len(both)) == (many // 2, many)
    assert first[:, 0].tolist() == list(range(0, many, 2))
