"""`vessels`: what one of several vessels in one water may have of its own, and how one entry stands for many."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from sim_core.keys import Bounds, Positive, Specification, SpecificationError
from xitl_cli.profile.schema.agents import MOST_VESSELS

SAILED = ("vehicle", "ais", "sensors", "mission", "driver", "autopilot", "companion", "faults", "plugins")
"""The groups that a vessel may have of its own; what it does not write of them is the profile's."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FormationSpec(Specification):
    """Positions relative to each other, along the axes of the heading at the start.

    `mission.start` is the position of the first vessel. In a line abreast it is the middle, in a wedge the point,
    in a circle the centre, and in a grid the middle of the first row.
    """

    shape: Literal["column", "line_abreast", "wedge", "circle", "grid"]
    spacing_m: Annotated[
        Positive, "distance from each vessel to the next; in a wedge along its arms, which go back at 45 degrees"
    ] = 10.0
    waypoints: Annotated[
        Literal["shifted", "shared"],
        "waypoints, offsets and tracks move with the start, or are the same for all vessels",
    ] = "shifted"


@dataclass(frozen=True, slots=True, kw_only=True)
class SpreadSpec(Specification):
    """Positions drawn from `clock.seed`, uniform over the free area of a circle about `mission.start`."""

    radius_m: Positive
    apart_m: Annotated[Positive, "smallest distance between two vessels"] = 10.0
    waypoints: Annotated[Literal["shifted", "shared"], "as in a formation"] = "shifted"


@dataclass(frozen=True, slots=True, kw_only=True)
class SeveralSpec(Specification):
    """One vessel, or several alike: `follower` with a `count` becomes `follower_1`, `follower_2` and so on.

    A given system id or MMSI belongs to the first vessel, and the others count up from it.
    """

    count: Annotated[
        Annotated[int, Bounds(at_least=1, at_most=MOST_VESSELS)] | None,
        "number of vessels; null: one vessel, without a number in its name",
    ] = None
    formation: FormationSpec | None = None
    spread: SpreadSpec | None = None

    def check(self) -> None:
        if self.formation is not None and self.spread is not None:
            raise SpecificationError(("spread",), "and formation are both there; leave out one of them (null)")
        if self.count is None and (self.formation is not None or self.spread is not None):
            key = "formation" if self.formation is not None else "spread"
            raise SpecificationError((key,), "is of several vessels; add count")
        if self.count is not None and self.count > 1 and self.formation is None and self.spread is None:
            raise SpecificationError(
                ("count",), f"= {self.count} puts them all in one place; add formation: {{shape: column}} or a spread"
            )
