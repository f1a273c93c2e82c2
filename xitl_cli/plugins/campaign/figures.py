"""Figures of a run: dotted paths into its summary, with the units of the summary (docs/recording.md)."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

USUAL = (
    "duration_s",
    "mission.waypoints_reached",
    "mission.cross_track_rms_m",
    "mission.cross_track_max_m",
    "estimation.position_rms_m",
    "estimation.heading_rms_deg",
    "collisions.count",
)
"""Default figures of every summary."""
COMPLETED = "driver.completed"
"""Default verdict."""
RUN_FIGURES = ("duration_s", "driver", "verdict", "ended", "wall_s", "real_time_factor", "encounters", "debris", "pace")
_MISSING = object()


def figure(summary: Mapping[str, Any], path: str) -> Any:
    """Return the value at a dotted path (`links.0.lost`), None if it or a parent is null.

    Raises KeyError for a missing path.
    """
    value: Any = summary
    for key in path.split("."):
        below: Any = _MISSING
        if value is None:
            return None
        if isinstance(value, Mapping):
            below = value.get(key, _MISSING)
        elif isinstance(value, Sequence) and not isinstance(value, str) and key.isdigit():
            below = value[int(key)] if int(key) < len(value) else _MISSING
        if below is _MISSING:
            raise KeyError(path)
        value = below
    return value


def figures(summary: Mapping[str, Any] | None, paths: Iterable[str]) -> dict[str, Any]:
    """Return figures of a summary by path; None for groups and for missing values, for example after a crash."""
    kept = {}
    for path in paths:
        try:
            value = None if summary is None else figure(summary, path)
        except KeyError:
            value = None
        kept[path] = value if isinstance(value, (str, int, float, bool, list)) else None
    return kept


def null_group(summary: Mapping[str, Any], path: str) -> str | None:
    """Return the null group on the path to a figure, such as `companion` without a companion."""
    keys = path.split(".")
    for depth in range(1, len(keys)):
        above = ".".join(keys[:depth])
        try:
            if figure(summary, above) is None:
                return above
        except KeyError:
            return None
    return None


def absent_figure(summary: Mapping[str, Any], paths: Iterable[str]) -> tuple[str, str] | None:
    """Return the first path that this summary lacks, or that is a group, and how to fix it."""
    for path in paths:
        try:
            value = figure(summary, path)
        except KeyError:
            known = sorted(_paths(summary, ""))
            last = path.rpartition(".")[2]
            close = [known_path for known_path in known if known_path.rpartition(".")[2] == last][:2]
            close = close or difflib.get_close_matches(path, known, n=1, cutoff=0.5)
            fix = f"did you mean {' or '.join(close)}?" if close else "docs/recording.md lists them"
            return path, f"is not a figure of a summary; {fix}"
        if isinstance(value, Mapping):
            members = ", ".join(f"{path}.{key}" for key in list(value)[:4])
            return path, f"is a group of figures; name one of them: {members}"
    return None


def _paths(value: Any, above: str) -> Iterator[str]:
    if isinstance(value, Mapping):
        for key, below in value.items():
            yield from _paths(below, f"{above}.{key}" if above else str(key))
    elif isinstance(value, Sequence) and not isinstance(value, str) and value and isinstance(value[0], Mapping):
        for number, below in enumerate(value):
            yield from _paths(below, f"{above}.{number}")
    else:
        yield above


def usual_figures(vessels: Sequence[str] = ()) -> tuple[str, ...]:
    """Return `USUAL`, for a fleet once per vessel with its name."""
    if not vessels:
        return USUAL
    run = [path for path in USUAL if path.split(".")[0] in RUN_FIGURES]
    own = [path for path in USUAL if path not in run]
    return (*run, *(f"vessels.{vessel}.{path}" for vessel in vessels for path in own))
