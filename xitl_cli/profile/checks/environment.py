"""Waves and gusts that the models can realise."""

from __future__ import annotations

from collections.abc import Iterator

from xitl_cli.profile.entry import KeyPath
from xitl_cli.profile.schema import Profile

FEWEST_COMPONENTS = 8


def check(profile: Profile) -> Iterator[tuple[KeyPath, str]]:
    """An irregular sea of too few components, a gust spectrum without the mean wind it is a function of."""
    if profile.environment is None:
        return
    waves, wind = profile.environment.waves, profile.environment.wind
    if waves.spectrum not in ("none", "regular") and waves.components < FEWEST_COMPONENTS:
        yield (
            ("environment", "waves", "components"),
            f"environment.waves.components = {waves.components} is too few for an irregular sea; "
            f"use {FEWEST_COMPONENTS} or more, or spectrum: regular",
        )
    if wind.gust.spectrum not in ("none", "ornstein-uhlenbeck") and wind.mean_mps == 0:
        yield (
            ("environment", "wind", "mean_mps"),
            f"environment.wind.mean_mps = 0 gives the gust spectrum {wind.gust.spectrum} nothing to scale with; "
            "use a mean above 0, or gust.spectrum: none or ornstein-uhlenbeck",
        )
