"""Speed, attitude and height of both, over their common time."""

from __future__ import annotations

from xitl_cli.logs import signals
from xitl_cli.logs.compare.common_time import Pairing
from xitl_cli.logs.compare.profile_grid import grid, plot, profile_or_why
from xitl_cli.logs.log import Log
from xitl_cli.logs.sections import Section
from xitl_cli.logs.signals import Of, Series
from xitl_cli.logs.signals.series import column, first


def motion_section(a: Log, b: Log, pairing: Pairing, of_a: Of, of_b: Of) -> Section | None:
    """Speed over ground, yaw, altitude, roll, pitch, and the height of the estimators' origins where both log it."""
    found, lacks = [], []
    for name, in_a, in_b in (
        ("speed over ground", signals.ground_speed(a, of_a), signals.ground_speed(b, of_b)),
        ("yaw", signals.yaw(a, of_a), signals.yaw(b, of_b)),
        ("altitude", _altitude(a, of_a), _altitude(b, of_b)),
        ("roll", signals.roll(a, of_a), signals.roll(b, of_b)),
        ("pitch", signals.pitch(a, of_a), signals.pitch(b, of_b)),
        ("EKF origin height", *_origin_heights(a, b)),
    ):
        both = profile_or_why(name, in_a, in_b, pairing)
        if not isinstance(both, str):
            found.append(both)
        elif name != "EKF origin height":
            lacks.append(both)
    if not found and not lacks:
        return None
    plots = tuple(plot("motion", each) for each in found)
    return Section("motion", "Motion", grids=grid("motion", found), plots=plots, lacks=tuple(lacks))


def _altitude(log: Log, of: Of) -> Series | None:
    found = signals.position_geodetic(log, of)
    if found is None:
        return None
    return Series(found.stamp_ns, found.values[:, 2], "m", f"{found.source} altitude", dropped=found.dropped)


def _origin_heights(a: Log, b: Log) -> tuple[Series | None, Series | None]:
    in_a, in_b = (
        first(log, lambda log: column(log, "XKF1", "OH", "m"), lambda log: column(log, "NKF1", "OH", "m"))
        for log in (a, b)
    )
    return in_a, in_b
