"""`search:` and `sensitivity:` of a plan: their keys, and their requirements on the axes. No numpy import."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, field
from itertools import product
from math import log
from typing import Annotated, Any, Literal

from sim_core.dataclass import dataclass
from sim_core.keys import Bounds, Items, Positive, Specification, SpecificationError
from xitl_cli.plugins.campaign.axes import Axis, AxisValue

Within = Annotated[float, Bounds(above=0, below=1)]


@dataclass(frozen=True, slots=True, kw_only=True)
class SearchSpec(Specification):
    """Search for the boundary of failure, along the axes that are ranges without count or step.

    One such axis is bisected, once for each combination of the others; several are explored together.
    """

    pass_rate: Annotated[Within, "share of passing runs that defines the boundary"] = 0.5
    confidence: Annotated[Within, "confidence of intervals"] = 0.95
    width: Annotated[
        Positive | None,
        "width of the boundary's interval: in the unit of a single axis, else as a share of the ranges; null: 5 %",
    ] = None
    runs_per_point: Annotated[
        int | None, Bounds(at_least=1, at_most=10_000), "runs with different seeds; null: 10 along one axis, else 3"
    ] = None
    points: Annotated[
        int | None, Bounds(at_least=2, at_most=10_000), "one axis: first points, with both ends; several: all points"
    ] = None
    most_runs: Annotated[int | None, Bounds(at_least=1), "limit of runs for one boundary"] = None
    batch: Annotated[
        int, Bounds(at_least=1), "points per round along several axes; the number of workers does not change it"
    ] = 8
    nominal: Annotated[dict[str, float], "nominal values by axis; default: the values of the base"] = field(
        default_factory=dict
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class SensitivitySpec(Specification):
    """Ranking of the axes by their effect on figures; every axis is a range or a distribution."""

    method: Annotated[
        Literal["morris", "sobol"], "morris: few runs, a ranking; sobol: many, shares of the variance"
    ] = "morris"
    samples: Annotated[
        int,
        Bounds(at_least=2),
        "samples; runs per seed for D axes: samples · (D + 1) for morris, samples · (D + 2) for sobol (a power of two)",
    ] = 16
    figures: Annotated[tuple[str, ...], Items(), "figures by path; empty: all kept figures that are numbers"] = ()
    confidence: Annotated[Within, "confidence of intervals"] = 0.95

    def places(self, axes: int) -> int:
        """Return the number of places of the sample for a number of axes."""
        return self.samples * (axes + (2 if self.method == "sobol" else 1))

    def check(self) -> None:
        if self.method == "sobol" and self.samples & (self.samples - 1):
            near = 1 << self.samples.bit_length()
            raise SpecificationError(("samples",), f"= {self.samples} is not a power of two; use {near // 2} or {near}")


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
        ranges = tuple(AxisRange(**axis) for axis in document["ranges"])
        spec = SearchSpec(**document["spec"])
        rest = (tuple(document["groups"]), tuple(document["nominal"]), document["first_seed"], document["seed"])
        return cls(spec, ranges, *rest)

    @property
    def most_runs(self) -> int:
        """Return the largest number of runs of all groups together."""
        of_group = self.spec.most_runs or (MOST_RUNS_ONE_AXIS if len(self.ranges) == 1 else MOST_RUNS_SEVERAL)
        return of_group * len(self.groups)


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
        raise SpecificationError((), "has no axis to search along; add one as {from: …, to: …} without count or step")
    ranges = tuple(AxisRange(axis.key, *axis.ends, axis.log) for axis in searched if axis.ends is not None)
    for key in spec.nominal:
        if key not in {axis.key for axis in ranges}:
            known = ", ".join(axis.key for axis in ranges)
            raise SpecificationError(("nominal", key), f"is not a searched axis; searched axes: {known}")
    combined = product(*(axis.grid_values(seed) for axis in others))
    groups = tuple({axis.key: value for axis, value in zip(others, values, strict=True)} for values in combined)
    nominal = tuple(_nominal(spec, axis, base_values.get(axis.key)) for axis in ranges) if len(ranges) > 1 else ()
    return Search(spec, ranges, groups, nominal, min(seeds), seed)


def _nominal(spec: SearchSpec, axis: AxisRange, of_base: Any) -> float:
    value = spec.nominal.get(axis.key, of_base)
    if not isinstance(value, (int, float)) or isinstance(value, bool):
        raise SpecificationError(("nominal",), f"needs {axis.key}, because the base has no number there; add it")
    if not axis.low <= value <= axis.high:
        source = "" if axis.key in spec.nominal else " from the base"
        raise SpecificationError(
            ("nominal",),
            f"has {axis.key} = {value:g}{source}, outside the axis from {axis.low:g} to {axis.high:g}; "
            "use a value within it",
        )
    return axis.share(float(value))
