"""References of figures: value, tolerance, and a source whose kind states how independent it is of the simulation.

This module and those with references (`closed_forms`, `published`, `published_tables`) import no equation of
`sim_core`. They may import its declarations of data.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from enum import StrEnum

from sim_core.dataclass import dataclass


class ReferenceKind(StrEnum):
    """Kinds of references, the most independent first."""

    MEASURED = "measured"
    """Measured on a boat or a model of it."""
    PUBLISHED = "published"
    """Printed in a paper, a standard or a data sheet, or computed by the equations of a published model."""
    PANEL_CODE = "panel code"
    """Computed by a boundary element code for linear waves."""
    CLOSED_FORM = "closed form"
    """A formula of textbooks with the vessel's data, implemented separately."""
    SAME_EQUATIONS = "same equations"
    """The simulation's own equations, implemented and solved again, or a property that the program claims to have."""

    @property
    def from_outside(self) -> bool:
        """Whether the value comes from outside the project."""
        return self in (ReferenceKind.MEASURED, ReferenceKind.PUBLISHED, ReferenceKind.PANEL_CODE)


@dataclass(frozen=True, slots=True)
class Source:
    """Source of references."""

    kind: ReferenceKind
    text: str
    """Paper, standard or theory."""


@dataclass(frozen=True, slots=True)
class FigureReference:
    """Reference of a figure: value, largest error in the figure's unit, and source."""

    value: float
    allowed: float
    source: Source
    disputed: str = ""
    at_most: bool = False
    """True if the figure may be any amount smaller."""


def kind_shares(references: Iterable[FigureReference | None]) -> dict[ReferenceKind, int]:
    """Return the number of references of each kind, of all kinds in their order."""
    found = Counter(reference.source.kind for reference in references if reference is not None)
    return {kind: found[kind] for kind in ReferenceKind}
