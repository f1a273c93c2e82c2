"""`search:` and `sensitivity:` of a plan: their keys, and their requirements on the axes. No numpy import."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import product
from math import log
from typing import Annotated, Any, Literal

from sim_core.keys import Bounds, Items, Positive, Specification, SpecificationError
from xitl_cli.plugins.campaign.axes import Axis, AxisValue

Within = Annotated[float, Bounds(above=0, below=1)]


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchSpec(Specification):
    """Search for the boundary of failure, along the axes that are ranges without count or step.

    One such axis is bisected, once for each combination of the others; several are explored together.
    """

    pass_rate: Annotated[Within, "the boundary is where the share of runs that pass crosses it"] = 0.5
    confidence: Annotated[Within, "of intervals"] = 0.95
    width: Annotated[
        Positive | None, "of the boundary's interval, in the axis' unit, or of several in shares of a range; null: 5 %"
    ] = None
    runs_per_point: Annotated[
        int | None, Bounds(at_least=1, at_most=10_000), "each with a seed of its own; null: 10 along one axis, else 3"
    ] = None
    points: Annotated[
        int | None, Bounds(at_least=2, at_most=10_000), "one axis: to begin with, ends included; several: in all"
    ] = None
    most_runs: Annotated[int | None, Bounds(at_least=1), "of one boundary, where the search gives up"] = None
    batch: Annotated[int, Bounds(at_least=1), "points tried at a time, several axes; more workers change nothing"] = 8
    nominal: Annotated[dict[str, float], "where the vessel is at home, by axis; otherwise what the base has"] = field(
        default_factory=dict
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class SensitivitySpec(Specification):
    """Ranking of the axes by their effect on figures; every axis is a range or a distribution."""

    method: Annotated[
        Literal["morris", "sobol"], "morris: few runs, a ranking; sobol: many, shares of the variance"
    ] = "morris"
    samples: Annotated[
        int, Bounds(at_least=2), "with D axes: times D + 1 runs a seed (morris), times D + 2 (sobol, a power of two)"
    ] = 16
    figures: Annotated[tuple[str, ...], Items(), "paths; empty: all that are kept and are numbers"] = ()
    confidence: Annotated[Within, "of intervals"] = 0.95

    def places(self, axes: int) -> int:
        """Return the number of places of the sample for a number of axes."""
        return self.samples * (axes + (2 if self.method == "sobol" else 1))

    def check(self) -> None:
        if self.method == "sobol" and self.samples & (self.samples - 1):
            near = 1 << self.samples.bit_length()
            raise SpecificationError(("samples",), f"= {self.samples} is no power of two; use {near // 2} or {near}")


@dataclass(frozen=True, slots=True)
class AxisRange:
    """A searched axis, from low to high; with `log` on a logarithmic scale."""

    key: str
    low: float
    high: float
    log: bool = False

    def value(self, share: float) -> float:
        """Return the value at a share of the range, 0 to 1."""
        if share <= 0.0 or share >= 1.0:
            return self.low if share <= 0.0 else self.high
        exact = self.low * (self.high / self.low) ** share if self.log else self.low + share * (self.high - self.low)
        return float(f"{exact:.12g}")

    def share(self, value: float) -> float:
        """Return the share of a value in the range."""
        if self.log:
            return log(value / self.low) / log(self.high / self.low)
        return (value - self.low) / (self.high - self.low)


@dataclass(frozen=True)
class Search:
    """The search of a plan."""

    spec: SearchSpec
    ranges: tuple[AxisRange, ...]
    groups: tuple[Mapping[str, AxisValue], ...]
    """Values of the axes that are not searched, one boundary each."""
    nominal: tuple[float, ...]
    """Shares of the searched axes."""
    first_seed: int
    """Seed of each group's first run."""
    seed: int

    def document(self) -> dict[str, Any]:
        """Return the search as JSON for `read`."""
        return asdict(self)

    @classmethod
    def read(cls, document: Mapping[str, Any]) -> Search:
        """Create the search from a document."""
        ranges = tuple(AxisRange(**one) for one in document["ranges"])
        spec = SearchSpec(**document["spec"])
        rest = (tuple(document["groups"]), tuple(document["nominal"]), document["first_seed"], document["seed"])
        return cls(spec, ranges, *rest)

    @property
    def most_runs(self) -> int:
        """Return the largest number of runs of all groups together."""
        each = self.spec.most_runs or (MOST_RUNS_ONE_AXIS if len(self.ranges) == 1 else MOST_RUNS_SEVERAL)
        return each * len(self.groups)


MOST_RUNS_ONE_AXIS, MOST_RUNS_SEVERAL = 400, 1000


def make_search(
    spec: SearchSpec, axes: Sequence[Axis], base_values: Mapping[str, Any], seeds: Sequence[int], seed: int
) -> Search:
    """Create a search. base_values: values of the base at the keys of the axes.

    Raises SpecificationError, with its path below `search`.
    """
    searched = [axis for axis in axes if axis.ends is not None]
    others = [axis for axis in axes if axis.ends is None]
    if not searched:
        raise SpecificationError((), "has no axis to search along; give one as {from: …, to: …} without count or step")
    ranges = tuple(AxisRange(axis.key, *axis.ends, axis.log) for axis in searched if axis.ends is not None)
    for key in spec.nominal:
        if key not in {one.key for one in ranges}:
            known = ", ".join(one.key for one in ranges)
            raise SpecificationError(("nominal", key), f"is no axis that is searched; those are {known}")
    return Search(
        spec,
        ranges,
        tuple(_groups(others, seed)),
        tuple(_nominal(spec, one, base_values.get(one.key)) for one in ranges) if len(ranges) > 1 else (),
        min(seeds),
        seed,
    )


def _groups(axes: Sequence[Axis], seed: int) -> Iterator[dict[str, AxisValue]]:
    for values in product(*(axis.grid_values(seed) for axis in axes)):
        yield {axis.key: value for axis, value in zip(axes, values, strict=True)}


def _nominal(spec: SearchSpec, one: AxisRange, of_base: Any) -> float:
    value = spec.nominal.get(one.key, of_base)
    if not isinstance(value, (int, float)) or isinstance(value, bool):
        raise SpecificationError(("nominal",), f"needs {one.key}, of which the base has no number; add it")
    if not one.low <= value <= one.high:
        whose = "" if one.key in spec.nominal else " of the base"
        raise SpecificationError(
            ("nominal",),
            f"has {one.key} = {value:g}{whose}, outside the axis from {one.low:g} to {one.high:g}; give a value within",
        )
    return one.share(float(value))
