"""A row of the bench, and the size at which the rows measure."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple, TypeVar

T = TypeVar("T")

_tiny = False


class Figure(NamedTuple):
    """One figure. `measure` returns a value for each run."""

    name: str
    """Unique among all figures. Results of two commits are matched by it."""
    wanted: str
    """Limit such as `>= 10` or `< 0.5`, empty without. `>` also says that more is better."""
    unit: str
    measure: Callable[[], Sequence[float]]


def scaled(full: T, tiny: T) -> T:
    """Return `full`, or `tiny` if the bench only has to show that its rows work."""
    return tiny if _tiny else full


def use_tiny_sizes(tiny: bool = True) -> None:
    """Choose what `scaled` returns from now on."""
    global _tiny
    _tiny = tiny
