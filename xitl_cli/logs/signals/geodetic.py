"""Latitude, longitude and altitude as a table has them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.log import Log
from xitl_cli.logs.signals.series import Series, series, vectors, whole

HIGHEST_M = 10e3  # beyond it a local frame has no meaning


def geodetic(log: Log, table: str, names: tuple[str, str, str]) -> Series | None:
    found = whole(log, table)
    if found is None or (values := vectors(found, names)) is None:
        return None
    return on_earth(found.stamp_ns, values, table)


def on_earth(stamp_ns: NDArray[np.int64], values: NDArray[np.float64], source: str) -> Series | None:
    """Without the zeros of a receiver that has no fix yet."""
    with np.errstate(invalid="ignore"):
        fixed = (np.abs(values[:, 0]) <= 90.0) & (np.abs(values[:, 1]) <= 180.0)
        fixed &= (values[:, 0] != 0.0) | (values[:, 1] != 0.0)
        fixed &= np.abs(values[:, 2]) <= HIGHEST_M
    return series(stamp_ns[fixed], values[fixed], "deg, deg, m", source)
