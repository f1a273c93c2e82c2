"""Check of the map of a view: a chart that reaches the missions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from xitl_cli.logs.model.errors import LogError
from xitl_cli.profile.files.entry import KeyPath, finding
from xitl_cli.profile.schema import Profile, RunProfile

if TYPE_CHECKING:
    from xitl_cli.logs.charts.chart import Chart


def mission_chart(file: str, vessels: Sequence[Profile | RunProfile]) -> Chart:
    """Return the chart of `view.map` around the missions. Raises LogError as `read_chart` does.

    vessels: their common site is known.
    """
    import numpy as np  # few profiles have a map

    from xitl_cli.logs.charts.chart import read_chart

    site = vessels[0].site
    assert site is not None
    course = [place for vessel in vessels if vessel.mission is not None for place in vessel.mission.course_ned_m]
    places_en_m = np.array([(east_m, north_m) for north_m, east_m in course] or [(0.0, 0.0)])
    return read_chart(Path(file), (site.latitude_deg, site.longitude_deg, site.altitude_m), places_en_m)


def check(profile: Profile, vessels: Sequence[Profile]) -> Iterator[tuple[KeyPath, str]]:
    """Yield a map that does not exist, cannot be read, or is of another place. vessels: the simulated ones."""
    if profile.view is None or profile.view.map is None:
        return
    file = Path(profile.view.map)
    try:
        if not file.exists():
            yield ("view", "map"), f"view.map: {file} does not exist; check the path"
        elif vessels and vessels[0].site is not None:  # the place of a part is unknown
            mission_chart(profile.view.map, vessels)
    except (LogError, OSError, ValueError) as error:
        yield finding("view.map", f"= {error}")
