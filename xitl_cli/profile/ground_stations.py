"""The addresses at which ground stations reach the autopilot."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

from xitl_cli.profile.problems import shown

if TYPE_CHECKING:
    from xitl_cli.profile.schema import Profile, RunProfile

USUAL = ("udp://127.0.0.1:14550", "tcp://0.0.0.0:5760")
"""Where ground stations listen (UDP), and where they look for a simulated vehicle (TCP)."""

_URL = re.compile(r"(udp|tcp)://(\[[0-9A-Fa-f:.]+\]|[^\s:/\[\]@?#]+):([0-9]{1,5})")


def ground_stations_of(profile: Profile | RunProfile) -> tuple[str, ...]:
    """Where the autopilot of this profile talks to ground stations; on a board its own command line says so."""
    autopilot = profile.autopilot
    if autopilot is None or autopilot.kind == "none" or autopilot.runs == "board":
        return ()
    if autopilot.ground_stations is not None:
        return autopilot.ground_stations
    return USUAL if profile.clock is not None and profile.clock.mode == "realtime" else ()


def problems_of_urls(urls: Sequence[str]) -> Iterator[tuple[int, str]]:
    """(index, sentence) of each URL that is none, or that is there twice."""
    seen: dict[tuple[str, ...], int] = {}
    for number, url in enumerate(urls):
        key = f"autopilot.ground_stations.{number} = {shown(url)}"
        match = _URL.fullmatch(url)
        if match is None:
            yield number, f"{key} is not an address; write udp://host:port (sent to) or tcp://host:port (listened at)"
            continue
        if not 0 < int(match[3]) < 65536:
            yield number, f"{key} has no such port; use a port from 1 to 65535"
            continue
        # Two listeners on one TCP port clash whatever their addresses are.
        same = ("tcp", match[3]) if match[1] == "tcp" else (match[1], match[2].lower(), str(int(match[3])))
        if same in seen:
            yield number, f"{key} is there twice, first as number {seen[same]}; drop one"
        seen.setdefault(same, number)
