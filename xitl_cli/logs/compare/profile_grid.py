"""Profiles as a table and plots."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.compare.common_time import Pairing
from xitl_cli.logs.compare.profiles import Profile, profile
from xitl_cli.logs.sections import Grid, Plot, Trace, Value
from xitl_cli.logs.signals import Series

_COLUMNS = ("quantity", "unit", "IAE", "RMS", "most", "mean", "B later (s)", "correlation")


def profile_or_why(name: str, a: Series | None, b: Series | None, pairing: Pairing) -> Profile | str:
    """Or the sentence why there is none."""
    if a is None or b is None:
        without = "either log" if a is None and b is None else "A" if a is None else "B"
        return f"{_capital(name)} is not in {without}."
    if a.unit != b.unit:
        return f"{_capital(name)} is in {a.unit or 'commands'} in A and in {b.unit or 'commands'} in B."
    return profile(name, a, b, pairing) or f"{_capital(name)} has no common time in both."


def grid(key: str, found: Sequence[Profile]) -> tuple[Grid, ...]:
    """A row a profile; none without profiles."""
    return (Grid(f"{key}.differences", "B less A", _COLUMNS, tuple(map(_row, found))),) if found else ()


def plot(key: str, found: Profile) -> Plot:
    return Plot(
        f"{key}.{found.name.replace(' ', '_')}",
        _capital(found.name),
        found.unit or "command",
        (
            Trace(f"A ({found.sources[0]})", found.stamp_ns, _unbroken(found, found.a)),
            Trace(f"B ({found.sources[1]})", found.stamp_ns, _unbroken(found, found.b)),
        ),
    )


def _row(found: Profile) -> tuple[Value, ...]:
    lag_s = None if found.lag_s is None else round(found.lag_s, 3) + 0.0
    alike = None if found.correlation is None else round(found.correlation, 4)
    numbers = (float(f"{each:.4g}") for each in (found.iae, found.rms, found.most, found.mean))
    return (found.name, found.unit, *numbers, lag_s, alike)


def _unbroken(found: Profile, values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Without the stroke across the plot where 360 becomes 0."""
    if found.unit != "deg" or np.ptp(values) < 180.0:
        return values
    drawn = values.astype(np.float64).copy()
    drawn[1:][np.abs(np.diff(values)) > 180.0] = np.nan
    return drawn


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
