"""A plan: the YAML file of a campaign, checked before anything runs.

base: sitl
set: {environment.wind.mean_mps: 6}
axes:
  environment.current.speed_mps: {from: 0, to: 0.6, count: 4}
seeds: 1-20
verdicts: [mission.cross_track_rms_m < 2, driver.completed]
"""

from __future__ import annotations

import difflib
import hashlib
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

from sim_core.dataclass import dataclass
from sim_core.keys import Bounds, Positive, Seed, Specification, SpecificationError, ValueProblem
from xitl_cli.errors import UserError
from xitl_cli.paths import user_path
from xitl_cli.plugins.campaign import figures
from xitl_cli.plugins.campaign.axes import EXTENDS, Axis, Combine, RunPoint, combinations, raw_count, read_axes
from xitl_cli.plugins.campaign.base import BaseProfile
from xitl_cli.plugins.campaign.expression import Expression, ExpressionError, parse_expression
from xitl_cli.plugins.campaign.search_spec import Search, SearchSpec, SensitivitySpec, make_search
from xitl_cli.profile.files.catalogue import SUFFIXES, shown_path
from xitl_cli.profile.files.entry import Entry, Problem, ProfileError, shown
from xitl_cli.profile.files.yaml_file import read_yaml
from xitl_cli.profile.reader import read_group

Recordings = Literal["none", "failures", "all"]
_SEEDS = re.compile(r"(\d+)(?:\s*-\s*(\d+))?")
MOST_SEEDS = 1_000_000


class PlanError(UserError):
    """The plan cannot be carried out. `str()` is the first problem and a count; `problems` holds all of them."""

    def __init__(self, problems: tuple[Problem, ...]) -> None:
        self.problems = problems
        more = len(problems) - 1
        places = ", ".join(dict.fromkeys(str(problem.origin) for problem in problems[1:4]))
        super().__init__(f"{problems[0]}" + (f" (and {more} more: {places})" if more else ""))


def seeds_of(value: object) -> tuple[int, ...]:
    """Parse `1-20`, `1-5, 9`, a count n (1 to n) or a list. Raises ValueError with text to follow `seeds = value`."""
    if isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= MOST_SEEDS:
        return tuple(range(1, value + 1))
    if isinstance(value, str):
        seeds: list[int] = []
        for part in value.split(","):
            match = _SEEDS.fullmatch(part.strip())
            first = int(match[1]) if match else 0
            last = int(match[2]) if match and match[2] else first
            if not match or not first <= last or last - first >= MOST_SEEDS:
                raise ValueError("is not a range of seeds; write 1-20, a count or a list")
            seeds += range(first, last + 1)
        value = tuple(seeds)
    if not isinstance(value, (tuple, list)) or not value or any(type(seed) is not int or seed < 0 for seed in value):
        raise ValueError("is not a range of seeds; write 1-20, a count or a list")
    if len(set(value)) < len(value):
        raise ValueError("contains a seed twice; remove one of them")
    return tuple(value)


def _seeds_problem(value: object) -> str | None:
    try:
        if value is not None:
            seeds_of(value)
    except ValueError as error:
        return str(error)
    return None


_UNCHECKED = ValueProblem(lambda value: None)


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitsSpec(Specification):
    """Limits of a run."""

    time_s: Annotated[Positive, "wall time"] = 3600.0
    memory_mb: Annotated[Positive | None, "memory of all processes of the run together; null: no limit"] = 4096.0
    attempts: Annotated[
        int, Bounds(at_least=1, at_most=100), "attempts for a run that crashes, exceeds a limit or is killed"
    ] = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanSpec(Specification):
    """The keys of a plan."""

    description: str = ""
    base: Annotated[str, "profile of every run: a shipped name, or a path relative to the plan"]
    set: Annotated[dict[str, Any], _UNCHECKED, "keys of the profile with one value for all runs"] = None  # type: ignore[assignment]
    axes: Annotated[dict[str, Any], _UNCHECKED, "keys of the profile with their values"] = None  # type: ignore[assignment]
    seeds: Annotated[Any, ValueProblem(_seeds_problem), "1-20, a count or a list; null: the seed of the base"] = None
    combine: Annotated[Combine, "how the axes are combined to runs"] = "grid"
    samples: Annotated[int | None, Bounds(at_least=1, at_most=10_000_000), "size of a Latin hypercube"] = None
    seed: Annotated[Seed, "seed of the plan's random draws"] = 1
    constraints: Annotated[tuple[str, ...], "conditions on axes; only points that satisfy all of them are run"] = ()
    keep: Annotated[tuple[str, ...] | None, "figures to keep from each summary; null: the usual ones"] = None
    verdicts: Annotated[
        tuple[str, ...] | None, "conditions on figures; a run passes if it satisfies all; null: driver.completed"
    ] = None
    recordings: Annotated[Recordings, "runs whose folders are kept"] = "failures"
    search: Annotated[SearchSpec | None, "searches for the boundary of failure instead of running all points"] = None
    sensitivity: Annotated[SensitivitySpec | None, "ranks the axes by their effect on figures"] = None
    limits: LimitsSpec = LimitsSpec()


SAME_RUNS = ("description", "limits", "recordings")
"""Keys that may change when a campaign is resumed."""


@dataclass(frozen=True)
class CampaignPlan:
    """A checked plan."""

    name: str
    path: Path
    spec: PlanSpec
    entry: Entry
    """The file, for the position of keys."""
    base: BaseProfile
    axes: tuple[Axis, ...]
    seeds: tuple[int, ...]
    constraints: tuple[Expression, ...]
    verdicts: tuple[Expression, ...]
    keep: tuple[str, ...]
    """Figures by path, including those of the verdicts."""

    @property
    def axis_keys(self) -> tuple[str, ...]:
        """Columns of the table, one per axis."""
        return tuple(axis.key for axis in self.axes)

    def points(self) -> Iterator[RunPoint]:
        """Yield all runs in order: every seed for each combination of values. For a search, yield its first round."""
        spec = self.spec
        if self.search is not None:
            from xitl_cli.plugins.campaign.search import first_points

            yield from first_points(self.search)
            return
        if spec.sensitivity is not None:
            from xitl_cli.plugins.campaign.sensitivity import sensitivity_points

            yield from sensitivity_points(spec.sensitivity, self.axes, self.seeds, spec.seed)
            return
        points = combinations(self.axes, spec.combine, spec.samples, spec.seed, self.constraints, self.base_values)
        number = 0
        for values in points:
            for seed in self.seeds:
                number += 1
                yield RunPoint(number, values, seed)

    def most_runs(self) -> int:
        """Return the number of runs before constraints, or the largest number of a search."""
        if self.search is not None:
            return self.search.most_runs
        if self.spec.sensitivity is not None:
            return self.spec.sensitivity.places(len(self.axes)) * len(self.seeds)
        return raw_count(self.axes, self.spec.combine, self.spec.samples) * len(self.seeds)

    @cached_property
    def search(self) -> Search | None:
        """Return the search. Raises PlanError if the axes do not fit it."""
        if self.spec.search is None:
            return None
        try:
            return make_search(self.spec.search, self.axes, self.base_values, self.seeds, self.spec.seed)
        except SpecificationError as error:
            keys = ("search", *error.path)
            raise self.problem("/".join(map(str, keys)), f"{'.'.join(map(str, keys))} {error.text}") from None

    def analysis(self) -> dict[str, Any]:
        """Return the requested analyses as plain JSON for the campaign's folder."""
        requested: dict[str, Any] = {"base_values": dict(self.base_values)}
        if self.search is not None:
            requested["search"] = self.search.document()
        if self.spec.sensitivity is not None:
            from xitl_cli.plugins.campaign.sensitivity import sample_places

            rows = sample_places(self.spec.sensitivity, self.axes, self.spec.seed)[1]
            requested["sensitivity"] = {"spec": asdict(self.spec.sensitivity), "places": rows}
        return requested

    @cached_property
    def base_values(self) -> Mapping[str, Any]:
        """Return the values of the base at the keys of the axes."""
        return {axis.key: self.base.value(axis.key) for axis in self.axes}

    def document(self) -> dict[str, Any]:
        """Return the plan as plain JSON for the record in the campaign's folder."""
        plain: Any = self.entry.plain()
        return {**json.loads(json.dumps(plain)), "base_digest": self.base.digest}

    def digest(self) -> str:
        """Digest of everything that determines the runs."""
        relevant = {key: value for key, value in self.document().items() if key not in SAME_RUNS}
        return hashlib.sha256(json.dumps(relevant, sort_keys=True).encode()).hexdigest()[:16]

    def problem(self, key: str, sentence: str) -> PlanError:
        """Return an error about a key of the plan, at its position."""
        keys = tuple(int(part) if part.isdigit() else part for part in key.split("/"))
        return PlanError((Problem(self.entry.nearest(keys)[0].origin, sentence),))


def find_plan(name: str) -> Path:
    """Return the file of a plan: a path, or the name of a shipped one. Raises UserError."""
    from xitl_cli.shipped import campaigns_dir

    path = user_path(name)
    if path.is_file():
        return path
    try:
        shipped = {plan.stem: plan for plan in sorted(campaigns_dir().glob("*.yaml"))}
    except UserError:
        shipped = {}
    if not name.endswith(SUFFIXES) and name in shipped:
        return shipped[name]
    problem = "is a folder" if path.is_dir() else "does not exist"
    known = f"; shipped plans: {', '.join(shipped)}" if shipped else ""
    raise UserError(f"{shown_path(path)} {problem}; check the path{known}")


def read_plan(path: Path) -> CampaignPlan:
    """Read the plan in a file, load its base and try every axis on it. Raises PlanError with every problem."""
    try:
        entry = _with_seeds_at_top(read_yaml(path, shown_path(path)))
        spec = read_group(entry, PlanSpec, path.name)
        axes = read_axes(entry.child("axes"))
        base = BaseProfile.load(spec.base, entry.child("base"), entry.child("set"), path.parent)
        base.check_axes(axes)
        seeds = base.own_seeds() if spec.seeds is None else seeds_of(spec.seeds)
        constraints = _expressions(entry, "constraints", spec.constraints, [axis.key for axis in axes])
        verdicts = _expressions(entry, "verdicts", spec.verdicts or (figures.COMPLETED,), ())
        usual = figures.usual_figures(base.vessels)
        keep = tuple(dict.fromkeys([*(usual if spec.keep is None else spec.keep), *_names(verdicts)]))
        plan = CampaignPlan(path.stem, path, spec, entry, base, axes, seeds, constraints, verdicts, keep)
        _check(plan)
    except ProfileError as error:
        raise PlanError(error.problems) from None
    return plan


def _with_seeds_at_top(entry: Entry) -> Entry:
    """Move `seeds` from `axes:` to the top level, which has the same meaning."""
    axes = entry.child("axes")
    if axes is None or (seeds := axes.child("seeds")) is None:
        return entry
    assert isinstance(entry.value, dict)
    assert isinstance(axes.value, dict)
    if "seeds" in entry.value:
        raise ProfileError([Problem(seeds.origin, "the plan has both axes.seeds and `seeds:`; remove one of them")], "")
    rest = {key: below for key, below in axes.value.items() if key != "seeds"}
    return Entry({**entry.value, "axes": Entry(rest, axes.origin), "seeds": seeds}, entry.origin)


def _expressions(entry: Entry, key: str, texts: tuple[str, ...], known: Any) -> tuple[Expression, ...]:
    expressions, problems = [], []
    for number, text in enumerate(texts):
        origin = entry.nearest((key, number))[0].origin
        try:
            expression = parse_expression(text, known)
        except ExpressionError as error:
            problems.append(Problem(origin, f"{key}: {shown(text)} {error}"))
            continue
        expressions.append(expression)
        if not expression.names:
            problems.append(Problem(origin, f"{key}: {shown(text)} is the same in every run; name an axis or a figure"))
    if problems:
        raise ProfileError(problems, "")
    return tuple(expressions)


def _names(expressions: tuple[Expression, ...]) -> list[str]:
    return [name for expression in expressions for name in expression.names]


def _check(plan: CampaignPlan) -> None:
    """Check conditions between keys of a plan. Raises PlanError."""
    spec, keys = plan.spec, plan.axis_keys
    draws = spec.combine == "latin_hypercube" or any(plan.entry.child(way) for way in ("search", "sensitivity"))
    if not draws:
        for axis in plan.axes:
            axis.grid_values(spec.seed)
    if spec.combine == "latin_hypercube":
        if spec.samples is None:
            raise plan.problem("combine", "combine: latin_hypercube needs `samples:`; add the number of runs")
        if not plan.axes:
            raise plan.problem("combine", "combine: latin_hypercube needs axes; add some under `axes:`")
    elif spec.samples is not None:
        raise plan.problem("samples", "samples needs combine: latin_hypercube; add it, or remove samples")
    for number, constraint in enumerate(plan.constraints):
        for name in constraint.names:
            if name not in keys:
                known = f"; axes: {', '.join(keys)}" if keys else ", which has no axes"
                raise plan.problem(f"constraints/{number}", f"constraints: {name} is not an axis of this plan{known}")
    for number, name in enumerate(spec.keep or ()):
        if not re.fullmatch(r"[\w-]+(\.[\w-]+)*", name):
            raise plan.problem(
                f"keep/{number}", f"keep: {shown(name)} is not a figure; write for example {figures.USUAL[1]}"
            )
    known_heads = base_heads()
    for key, names in (("verdicts", _names(plan.verdicts)), ("keep", spec.keep or ())):
        for name in names:
            head, dot, rest = name.partition(".")
            if head not in known_heads:
                close = difflib.get_close_matches(head, known_heads, n=1)
                fix = f"did you mean {close[0]}{dot}{rest}?" if close else "docs/recording.md lists them"
                raise plan.problem(key, f"{key}: {name} is not a figure of a summary; {fix}")
    _check_way(plan)
    if EXTENDS in keys and any(key.startswith(f"{EXTENDS}.") for key in keys):
        raise plan.problem("axes", "axes: extends and extends.NAME cannot be mixed; give each axis a name")


def _check_way(plan: CampaignPlan) -> None:
    """Check that a plan defines its runs in only one way. Raises PlanError."""
    spec = plan.spec
    ways = [way for way in ("search", "sensitivity") if getattr(spec, way) is not None]
    if not ways:
        return
    if len(ways) > 1:
        raise plan.problem("sensitivity", "search and sensitivity need separate plans; remove one of them")
    if spec.combine != "grid":
        raise plan.problem(
            "combine", f"combine: {spec.combine} has no effect, because {ways[0]} chooses the points; remove one"
        )
    if spec.constraints:
        raise plan.problem("constraints", f"constraints do not apply to {ways[0]}; narrow the axes instead")
    if spec.sensitivity is not None:
        if len(plan.axes) < 2:
            raise plan.problem("axes", "axes: sensitivity ranks axes; add a second one")
        for name in spec.sensitivity.figures:
            if name not in plan.keep:
                raise plan.problem("sensitivity/figures", f"sensitivity.figures: {name} is not kept; add it to `keep:`")
    elif plan.search is not None:
        # A search starts at both ends of each searched axis.
        searched = [axis for axis in plan.axes if axis.ends is not None]
        plan.base.check_axes([replace(axis, values=axis.ends or (), ends=None) for axis in searched])


def base_heads() -> tuple[str, ...]:
    """Return the sections of summaries, including those of fleets and encounters."""
    from xitl_cli.run.summary import OF_THE_GRAPH, merged

    top = ("format", "xitl", "profile", "technique", "seed", "clock", "started_utc", "ended", "error", "verdict")
    more = ("wdri", "duration_s", "physics", "wall_s", "real_time_factor", "driver", "vessels", "encounters")
    return (*top, *more, *(key for key in merged([]) if key not in OF_THE_GRAPH))
