"""Which vessels of a fleet set out together: who has to be ready before whom."""

from __future__ import annotations

from collections.abc import Sequence

from xitl_cli.profile.schema import RunProfile


def departs_after(profiles: Sequence[RunProfile]) -> dict[str, tuple[str, ...]]:
    """By each vessel's name, those that have to be ready before it sets out.

    Its followers, their own followers too; all others; or nobody: `driver.departs_with`.
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
