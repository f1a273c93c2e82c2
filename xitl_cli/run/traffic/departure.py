"""Order in which the vessels of a fleet set out: which vessels must be ready before each."""

from __future__ import annotations

from collections.abc import Sequence

from xitl_cli.profile.schema import RunProfile


def departs_after(profiles: Sequence[RunProfile]) -> dict[str, tuple[str, ...]]:
    """Return, by vessel, the vessels that must be ready before it sets out.

    By `driver.departs_with`, these are its followers with their followers, all others, or none.
    """
    leaders = {
        profile.vessel: profile.driver.follow.vessel
        for profile in profiles
        if profile.driver.kind == "follow" and profile.driver.follow is not None
    }

    def leads(name: str, other: str) -> bool:
        while other in leaders:
            other = leaders[other]
            if other == name:
                return True
        return False

    names = [profile.vessel for profile in profiles]
    found = {}
    for profile in profiles:
        own, departs_with = profile.vessel, profile.driver.departs_with
        others = [name for name in names if name != own]
        if departs_with == "followers":
            others = [name for name in others if leads(own, name)]
        found[own] = () if departs_with == "nobody" else tuple(others)
    return found
