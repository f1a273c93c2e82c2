"""Sensitivity of figures to axes: samples and indices of Sobol and Morris by SALib, elasticities of one-at-a-time
plans.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, Literal

import numpy as np

from sim_core.dataclass import dataclass
from xitl_cli.plugins.campaign.axes import Axis, AxisValue, RunPoint
from xitl_cli.plugins.campaign.execution import RAN
from xitl_cli.plugins.campaign.search_spec import SensitivitySpec
from xitl_cli.plugins.campaign.statistics import Floats, Interval, mean_interval

Method = Literal["sobol", "morris"]
MORRIS_LEVELS = 4
Row = Mapping[str, Any]


@dataclass(frozen=True, slots=True)
class AxisEffect:
    """Effect of an axis on a figure, with its interval.

    sobol: `main` is the first-order index, `total` the total one, as shares of the variance. morris uses the elementary
    effects in the figure's unit over the whole range: `main` is their mean mu, `total` the mean of their magnitudes
    mu*, and `interaction` their deviation sigma.
    """

    axis: str
    total: float
    total_interval: Interval
    main: float
    main_interval: Interval | None
    interaction: float | None = None


@dataclass(frozen=True, slots=True)
class Sensitivity:
    """Sensitivity of one figure."""

    figure: str
    method: str
    effects: tuple[AxisEffect, ...]
    """Effects, the strongest axis first."""
    used: int
    """Number of used groups of runs."""
    dropped: int
    """Number of dropped groups of runs."""
    why: str = ""
    """Reason for missing effects."""


def unit_sample(method: Method, axes: int, samples: int, seed: int) -> Floats:
    """Return (R, axes) of shares in [0, 1].

    R = samples·(axes + 2) for Sobol (Saltelli's scheme), samples·(axes + 1) for Morris. Groups of axes + 2 or axes + 1
    rows belong together. samples: a power of two for Sobol.
    """
    problem = _problem(axes)
    if method == "sobol":
        from SALib.sample import sobol  # type: ignore[import-untyped]

        return np.asarray(sobol.sample(problem, samples, calc_second_order=False, seed=seed), dtype=np.float64)
    from SALib.sample import morris

    return np.asarray(morris.sample(problem, samples, num_levels=MORRIS_LEVELS, seed=seed), dtype=np.float64)


def axis_effects(
    figure: str, method: Method, axes: Sequence[str], sample: Floats, values: Floats, confidence: float, seed: int
) -> Sensitivity:
    """Compute effects. sample: from `unit_sample`. values (R,): the figure at each row, NaN for none, which drops the
    group.

    Intervals of Sobol are symmetric, from resampling. An index plus its interval may exceed [0, 1].
    """
    group = len(axes) + (2 if method == "sobol" else 1)
    whole = np.isfinite(values.reshape(-1, group)).all(axis=1)
    used, dropped = int(whole.sum()), int((~whole).sum())
    in_whole_group = np.repeat(whole, group)
    values, sample = values[in_whole_group], sample[in_whole_group]

    def without(why: str) -> Sensitivity:
        return Sensitivity(figure, method, (), used, dropped, why)

    if used < 2:
        return without(f"only {used} of {used + dropped} groups of runs are complete")
    if float(np.ptp(values)) == 0.0:
        return without(f"it is {values[0]:g} in every run")
    settings: dict[str, Any] = {"conf_level": confidence, "num_resamples": 1000, "seed": seed}
    problem = _problem(len(axes))
    effects = []
    if method == "sobol":
        from SALib.analyze import sobol  # type: ignore[import-untyped]

        indices = sobol.analyze(problem, values, calc_second_order=False, **settings)
        for axis, *row in zip(axes, *(indices[name] for name in ("ST", "ST_conf", "S1", "S1_conf")), strict=True):
            total, total_half, main, main_half = map(float, row)
            effects.append(AxisEffect(axis, total, _about(total, total_half), main, _about(main, main_half)))
    else:
        from SALib.analyze import morris

        indices = morris.analyze(problem, sample, values, num_levels=MORRIS_LEVELS, **settings)
        for axis, *row in zip(
            axes, *(indices[name] for name in ("mu_star", "mu_star_conf", "mu", "sigma")), strict=True
        ):
            total, half, mean, sigma = map(float, row)
            effects.append(AxisEffect(axis, total, _about(total, half), mean, None, sigma))
    return Sensitivity(figure, method, tuple(sorted(effects, key=lambda effect: -effect.total)), used, dropped)


def _problem(axes: int) -> dict[str, Any]:
    return {"num_vars": axes, "names": [str(axis) for axis in range(axes)], "bounds": [[0.0, 1.0]] * axes}


def _about(middle: float, half: float) -> Interval:
    return Interval(middle - half, middle + half)


def sample_places(
    spec: SensitivitySpec, axes: Sequence[Axis], seed: int
) -> tuple[list[dict[str, AxisValue]], list[int]]:
    """Return the distinct places of a sample, and the index of the place of each row: Morris repeats some."""
    places: list[dict[str, AxisValue]] = []
    known: dict[str, int] = {}
    rows = []
    for shares in unit_sample(spec.method, len(axes), spec.samples, seed):
        values = {axis.key: axis.quantile(float(share)) for axis, share in zip(axes, shares, strict=True)}
        number = known.setdefault(json.dumps(values), len(places))
        if number == len(places):
            places.append(values)
        rows.append(number)
    return places, rows


def sensitivity_points(
    spec: SensitivitySpec, axes: Sequence[Axis], seeds: Sequence[int], seed: int
) -> Iterator[RunPoint]:
    """Yield each place of the sample with every seed. Equal seeds everywhere keep their effect out of the axes'
    effects.
    """
    for number, values in enumerate(sample_places(spec, axes, seed)[0]):
        for index, run_seed in enumerate(seeds):
            yield RunPoint(number * len(seeds) + index + 1, values, run_seed)


def sensitivities(
    spec: SensitivitySpec,
    axes: Sequence[str],
    figures: Sequence[str],
    rows: Iterable[Row],
    places: Sequence[int],
    seeds: int,
    seed: int,
) -> list[Sensitivity]:
    """Compute the sensitivity of each figure, averaged over seeds. rows: by number. A place with a missing run has no
    figure.

    places: place of each row of the sample, from `sample_places`.
    """
    sample = unit_sample(spec.method, len(axes), spec.samples, seed)
    by_number = {row["number"]: row for row in rows}
    results = []
    for figure in figures:
        values = np.full((max(places) + 1, seeds), np.nan)
        for number, row in by_number.items():
            value = row.get(figure)
            ran = row.get("status") in RAN
            if ran and isinstance(value, (int, float)) and 1 <= number <= values.size:
                values.flat[number - 1] = float(value)
        of_sample = values.mean(axis=1)[np.asarray(places)]
        results.append(axis_effects(figure, spec.method, axes, sample, of_sample, spec.confidence, seed))
    return results


@dataclass(frozen=True, slots=True)
class Elasticity:
    """Elasticity of a figure along an axis at nominal: its change in per cent for one per cent of the axis."""

    axis: str
    elasticity: float | None
    """None if the axis or the figure is zero at nominal."""
    slope: float
    """Figure's unit per unit of the axis."""
    interval: Interval | None
    """Interval over seeds of the elasticity, or of the slope without an elasticity; None for a single seed."""
    seeds: int


def elasticities(
    nominal: Mapping[str, float], series: Mapping[str, Mapping[int, Sequence[tuple[float, float]]]], confidence: float
) -> list[Elasticity]:
    """Compute elasticities, the strongest axis first.

    series: for each axis and seed, the pairs of axis value and figure, nominal included. A straight line is fitted for
    each seed, so that common effects of seeds cancel. The result is its slope at nominal over the mean of the figure
    there.
    """
    results = []
    for axis, by_seed in series.items():
        slopes, levels = [], []
        for pairs in by_seed.values():
            at, value = np.array(sorted(pairs), dtype=np.float64).T
            if len(at) < 2 or float(np.ptp(at)) == 0.0:
                continue
            slope, constant = np.polyfit(at, value, 1)
            slopes.append(float(slope))
            levels.append(float(constant + slope * nominal[axis]))
        if not slopes:
            continue
        level = float(np.mean(levels))
        factor = nominal[axis] / level if level and nominal[axis] else None
        of_seeds = np.array(slopes) * (1.0 if factor is None else factor)
        slope = float(np.mean(slopes))
        elasticity = None if factor is None else factor * slope
        results.append(Elasticity(axis, elasticity, slope, mean_interval(of_seeds, confidence), len(slopes)))
    return sorted(results, key=lambda result: -abs(result.elasticity or 0.0))
