"""Axes of a plan: values of lists, ranges and distributions, and the points that follow."""

from __future__ import annotations

import math
from collections import Counter

import numpy as np
import pytest
import scipy

from xitl_cli.plugins.campaign.axes import Axis, combinations, raw_count, read_axes
from xitl_cli.plugins.campaign.expression import parse_expression
from xitl_cli.profile.files.entry import Origin, ProfileError
from xitl_cli.profile.files.yaml_file import parse_yaml


def axis(text: str, key: str = "environment.wind.mean_mps") -> Axis:
    (found,) = read_axes(parse_yaml(f"{key}: {text}", "plan.yaml"))
    return found


def points(
    *axes: Axis, combine: str = "grid", samples: int | None = None, seed: int = 1, only: tuple[str, ...] = ()
) -> list:
    constraints = [parse_expression(text, [one.key for one in axes]) for text in only]
    return list(combinations(axes, combine, samples, seed, constraints, {one.key: None for one in axes}))


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("[0, 4.5, 8]", (0, 4.5, 8)),
        ("{from: 0, to: 8, step: 2}", (0, 2, 4, 6, 8)),
        ("{from: 0, to: 7, step: 2}", (0, 2, 4, 6)),
        ("{from: 0.0, to: 0.3, step: 0.1}", (0.0, 0.1, 0.2, 0.3)),
        ("{from: 1, to: 2, count: 5}", (1.0, 1.25, 1.5, 1.75, 2.0)),
        ("{from: 0.01, to: 10, count: 4, scale: log}", (0.01, 0.1, 1.0, 10.0)),
        ("{from: 1, to: 16, step: 4, scale: log}", (1, 4, 16)),
    ],
)
def test_values_of_lists_and_ranges(text: str, values: tuple[float, ...]) -> None:
    found = axis(text).grid_values(1)
    assert found == values
    assert list(map(type, found)) == list(map(type, values))


@pytest.mark.parametrize(
    ("text", "law", "parameters"),
    [
        ("{uniform: [2, 5]}", "uniform", (2, 3)),
        ("{loguniform: [0.1, 10]}", "loguniform", (0.1, 10)),
        ("{normal: [3, 0.5]}", "norm", (3, 0.5)),
        ("{lognormal: [2, 0.4]}", "lognorm", (0.4, 0, 2)),
        ("{triangular: [1, 2, 5]}", "triang", (0.25, 1, 4)),
        ("{normal: [0, 1], within: [-1, 2]}", "truncnorm", (-1, 2)),
        ("{from: 2, to: 5}", "uniform", (2, 3)),
        ("{from: 0.1, to: 10, scale: log}", "loguniform", (0.1, 10)),
    ],
)
def test_quantiles_are_those_of_scipy(text: str, law: str, parameters: tuple[float, ...]) -> None:
    one, theirs = axis(text), getattr(scipy.stats, law)(*parameters)
    for share in (0.001, 0.1, 0.25, 0.4, 0.5, 0.9, 0.999):
        assert one.quantile(share) == pytest.approx(theirs.ppf(share), rel=1e-9, abs=1e-9)


@pytest.mark.medium
def test_whole_numbers_and_choices_come_in_their_shares() -> None:
    shares = (np.arange(1000) + 0.5) / 1000
    assert Counter(axis("{integers: [3, 6]}").quantile(share) for share in shares) == dict.fromkeys((3, 4, 5, 6), 250)
    chosen = Counter(axis("{choice: [a, b], weights: [3, 1]}").quantile(share) for share in shares)
    assert chosen == {"a": 750, "b": 250}


def test_a_grid_has_every_pair_in_order() -> None:
    found = points(axis("[0, 4]"), axis("[a, b, c]", "autopilot.kind"))
    assert [(one["environment.wind.mean_mps"], one["autopilot.kind"]) for one in found] == [
        (0, "a"), (0, "b"), (0, "c"), (4, "a"), (4, "b"), (4, "c"),
    ]  # fmt: skip


def test_a_latin_hypercube_meets_every_layer_once() -> None:
    found = points(axis("{from: 0, to: 1}"), axis("{normal: [0, 1]}", "b"), combine="latin_hypercube", samples=64)
    layers = [int(one["environment.wind.mean_mps"] * 64) for one in found]
    assert sorted(layers) == list(range(64))
    assert sorted(int(scipy.stats.norm.cdf(one["b"]) * 64) for one in found) == list(range(64))
    assert abs(scipy.stats.spearmanr(layers, [one["b"] for one in found]).statistic) < 0.5  # not drawn together


def test_an_axis_keeps_its_draws_when_another_is_added() -> None:
    one, other = axis("{uniform: [0, 1]}"), axis("{uniform: [0, 1]}", "b")
    alone = points(one, combine="latin_hypercube", samples=9)
    both = points(other, one, combine="latin_hypercube", samples=9)
    assert [point[one.key] for point in alone] == [point[one.key] for point in both]
    assert alone != points(one, combine="latin_hypercube", samples=9, seed=2)


def test_one_at_a_time_begins_with_the_base() -> None:
    found = points(axis("[1, 2]"), axis("[5]", "b"), combine="one_at_a_time")
    assert found == [{}, {"environment.wind.mean_mps": 1}, {"environment.wind.mean_mps": 2}, {"b": 5}]
    base = {"environment.wind.mean_mps": 1, "b": 5}
    again = combinations((axis("[1, 2]"), axis("[5]", "b")), "one_at_a_time", None, 1, (), base)
    assert list(again) == [{}, {"environment.wind.mean_mps": 2}]


def test_constraints_leave_points_out() -> None:
    found = points(
        axis("{from: 0, to: 9, step: 1}"), axis("[0, 1]", "b.c"), only=("environment.wind.mean_mps + 5 * b.c < 7",)
    )
    assert len(found) == 7 + 2


def test_counts_without_making_the_points() -> None:
    many = [axis(f"{{from: 0, to: 1, count: {1000 + number}}}", f"k{number}") for number in range(4)]
    assert raw_count(many, "grid", None) == math.prod(range(1000, 1004))


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[]", "has no value"),
        ("[1, 1]", "has 1 twice"),
        ("5", "is a single value"),
        ("{from: 0}", "has no `to`"),
        ("{from: 3, to: 1, count: 2}", "`to` must be the larger"),
        ("{from: 0, to: 1, count: 3, scale: log}", "start above 0"),
        ("{from: 0, to: 1, step: -1}", "use a value above 0"),
        ("{from: 0, to: 1, step: 0.5, count: 2}", "remove one of them"),
        ("{from: 0, to: 1, step: 1e-12}", "use fewer"),
        ("{from: 0, to: 1, cuont: 3}", "did you mean 'count'"),
        ("{from: a, to: 1, count: 3}", "is not a number"),
        ("{gauss: [0, 1]}", "one of uniform"),
        ("{normal: [0]}", "needs [mean, standard deviation]"),
        ("{normal: [0, -1]}", "correct it"),
        ("{uniform: [1, 0]}", "correct it"),
        ("{integers: [1.5, 3]}", "correct it"),
        ("{choice: [a, b], weights: [1]}", "give one per value"),
        ("{uniform: [0, 1], normal: [0, 1]}", "is both"),
        ("{from: 0, to: 1, scale: loud}", "is not a scale; write linear or log"),
        ("{from: 1, to: 8, step: 1, scale: log}", "= 1 is a factor here; use more than 1"),
        ("{from: 0, to: 1, step: 0}", "use a value above 0"),
        ("{from: 1, to: 1, count: 2}", "`to` must be the larger"),
        ("{from: 0, to: 1, count: 1}", "does not make a range; use at least 2"),
        ("{from: 0, to: 1, count: true}", "is not a count"),
        ("{uniform: [0, 1], count: 0}", "= 0 is not a count"),
        ("{uniform: [0, 1], count: 1.5}", "= 1.5 is not a count"),
        ("{choice: a}", "is not a list of values"),
        ("{choice: []}", "is not a list of values"),
        ("{choice: [a, b], weights: [0, 0]}", "are not 2 shares"),
        ("{choice: [a, b], weights: [-1, 2]}", "are not 2 shares"),
        ("{loguniform: [0, 1]}", "correct it"),
        ("{lognormal: [0, 1]}", "correct it"),
        ("{normal: [0, 0]}", "correct it"),
        ("{triangular: [1, 5, 2]}", "correct it"),
        ("{triangular: [1, 1, 1]}", "correct it"),
        ("{normal: [0, 1], within: [1]}", "give two increasing numbers"),
        ("{normal: [0, 1], within: [1, 1]}", "give two increasing numbers"),
    ],
)
def test_an_axis_that_is_wrong_says_where_and_how(text: str, said: str) -> None:
    with pytest.raises(ProfileError) as error:
        axis(text)
    assert str(error.value).startswith("plan.yaml:1: environment.wind.mean_mps")
    assert said in str(error.value)


@pytest.mark.parametrize("text", ["{uniform: [0, 1]}", "{from: 0, to: 1}"])
def test_a_grid_needs_values(text: str) -> None:
    with pytest.raises(ProfileError, match="add count"):
        axis(text).grid_values(1)
    assert Axis("a", Origin("x"), (1,)).example() == 1


@pytest.mark.parametrize(
    ("text", "numeric"),
    [
        ("[1, 2.5]", True),
        ("[1, true]", False),
        ("[a, 1]", False),
        ("{from: 0, to: 1}", True),
        ("{normal: [0, 1]}", True),
    ],
)
def test_axes_of_numbers(text: str, numeric: bool) -> None:
    assert axis(text).numeric is numeric


@pytest.mark.parametrize(
    ("within", "low", "high"), [("[-1, 11]", 0.0, 10.0), ("[2, 4]", 2.0, 4.0), ("[0, 10]", 0.0, 10.0)]
)
def test_limits_of_a_distribution_that_has_ends(within: str, low: float, high: float) -> None:
    limited = axis(f"{{uniform: [0, 10], within: {within}}}")
    for share in (0.0, 0.25, 0.999):
        assert limited.quantile(share) == pytest.approx(low + share * (high - low), abs=1e-9)


def test_a_choice_without_a_weight_is_never_made() -> None:
    chosen = axis("{choice: [a, b, c], weights: [0, 1, 0]}")
    assert {chosen.quantile(share) for share in (0.0, 0.5, 0.999999)} == {"b"}
    thirds = axis("{choice: [a, b, c]}")
    assert [thirds.quantile(share) for share in (0.0, 0.333, 0.334, 0.666, 0.667, 0.9999999999999999)] == [*"aabbcc"]


def test_a_distribution_with_a_count_is_drawn_for_a_grid() -> None:
    drawn = axis("{uniform: [2, 3], count: 50}").grid_values(7)
    assert len(drawn) == 50
    assert all(isinstance(value, float) and 2.0 <= value < 3.0 for value in drawn)
    assert (
        drawn
        == axis("{uniform: [2, 3], count: 50}").grid_values(7)
        != axis("{uniform: [2, 3], count: 50}").grid_values(8)
    )
    assert axis("{uniform: [2, 3], count: 1}").grid_values(7) == drawn[:1]


def test_a_whole_fault_is_on_or_off() -> None:
    with pytest.raises(ProfileError, match=r"is a whole fault, on or off; write \[off, on\]"):
        axis("5", "faults.gnss-dropout")


def test_two_ends_are_a_range() -> None:
    assert axis("{from: 0, to: 1, count: 2}").grid_values(1) == (0.0, 1.0)
