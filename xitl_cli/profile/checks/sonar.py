"""A sonar that scans a sector that can be, and whose device can be served where it is said."""

from __future__ import annotations

from collections.abc import Iterator

from xitl_cli.profile.checks.link import problem_of_url
from xitl_cli.profile.entry import KeyPath
from xitl_cli.profile.problems import shown
from xitl_cli.profile.schema import Profile

_SERVE = "use udp://127.0.0.1:9092, serial:///dev/ttyUSB0?baud=115200 or serial://pty"


def check(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """A sector that goes the wrong way round or on for more than a turn, a line that is none."""
    if profile.sensors is None or profile.sensors.sonar is None:
        return
    sonar = profile.sensors.sonar
    first_deg, last_deg = sonar.sector_deg
    if not 0.0 <= last_deg - first_deg <= 360.0:
        yield (
            ("sensors", "sonar", "sector_deg"),
            f"sensors.sonar.sector_deg = [{first_deg:g}, {last_deg:g}] does not go clockwise by at most a turn; "
            "give where it begins on the left first, like [-90, 90]",
        )
    if sonar.serve is not None and (problem := _problem_of_serve(sonar.serve)) is not None:
        yield ("sensors", "sonar", "serve"), f"sensors.sonar.serve = {shown(sonar.serve)} {problem}"


def _problem_of_serve(url: str) -> str | None:
    scheme, _, rest = url.partition("://")
    if scheme == "serial" and (rest == "pty" or rest.startswith("pty/")):
        return None
    if scheme in ("tcp", "can"):
        return f"is no line that a Ping360 has; {_SERVE}"
    return problem_of_url(url)
