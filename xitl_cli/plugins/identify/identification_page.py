"""The result of `xitl identify vessel` as a file of the vehicle and as sections of a page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import takewhile
from pathlib import Path

from xitl_cli.logs.model.sections import Finding, Grid, Plot, Section, Trace
from xitl_cli.logs.signals.series import rounded, significant
from xitl_cli.plugins.identify.identification import Identification
from xitl_cli.plugins.identify.prediction import SCORES
from xitl_cli.profile import Profile, resolved_yaml

_MOST_PLOTS = 6
_COMPARED_S, _CLEARLY = 5.0, 0.8
_MOTIONS = (("surge", "m/s"), ("sway", "m/s"), ("yaw rate", "rad/s"))


def vehicle_text(result: Identification, profile: Profile, extends: str, command: str) -> str:
    """Return a profile that extends the first one with the identified vehicle, with errors in comments above it."""
    lines = [f"# Identified by `{command}`", f"# from {', '.join(Path(name).name for name in result.trained)}.", "#"]
    for own in result.keys:
        unsure = f"; not determined: {own.advice}" if own.advice else ""
        lines.append(f"# {own.key}: {own.value:.4g} ± {own.sigma:.2g} (before {own.start:.4g}){unsure}")
    resolved = resolved_yaml(replace(profile, vehicle=result.vessel)).splitlines()
    first = resolved.index("vehicle:")
    group = [resolved[first], *takewhile(lambda line: line.startswith((" ", "-")), resolved[first + 1 :])]
    return "\n".join([*lines, f"extends: {extends}", *group, ""])


def sections(result: Identification) -> list[Section]:
    """Return the sections of the page, the answers first."""
    figures = Grid(
        "figures", "Inertia and damping", ("figure", "value", "standard error", "unit"), tuple(figure_rows(result))
    )
    heads = ("key", "before", "identified", "standard error", "determined by")
    keys = Grid("keys", "Keys of the vehicle", heads, tuple(key_rows(result)))
    columns = ("window (s)", "model", "windows", *SCORES)
    scores = Grid("scores", "Root mean square errors on the tested logs", columns, tuple(score_rows(result)))
    rows = tuple(
        (log, name, rounded(value, 4), rounded(sigma, 4), unit) for log, name, value, sigma, unit in result.nuisance
    )
    nuisance = Grid(
        "nuisance", "Current, wind, biases and delays", ("log", "quantity", "value", "standard error", "unit"), rows
    )
    noise = tuple((name, significant(value, 3)) for name, value in result.noise.items())
    return [
        Section("vehicle", "Identified vehicle", findings=tuple(findings(result)), grids=(figures, keys)),
        Section("predictions", "Predictions", grids=(scores,), plots=tuple(_plots(result))),
        Section(
            "surroundings",
            "Surroundings and sensors",
            grids=(nuisance, Grid("noise", "Noise", ("quantity", "σ"), noise)),
        ),
    ]


def findings(result: Identification) -> list[Finding]:
    """Return what the logs do not determine, and what depends on each other."""
    found = [
        Finding.warning(
            "identify.undetermined",
            f"{own.key} is not determined: {own.value:.3g} ± {own.sigma:.2g}",
            (),
            f"{own.advice[:1].upper()}{own.advice[1:]}; or fix the key with --fix {own.key}.",
        )
        for own in result.keys
        if own.advice
    ]
    found += [
        Finding.notice(
            "identify.correlated",
            f"{first} and {second} are correlated ({value:+.2f}): their errors compensate",
            (),
            "Use them together, or fix one with --fix.",
        )
        for first, second, value in result.correlated
    ]
    if errors := _no_better_than_persistence(result):
        found.append(
            Finding.warning(
                "identify.persistence",
                f"a boat that keeps its velocity predicts as well: {errors[0]:.3g} m/s in surge and "
                f"{errors[2]:.3g} rad/s in yaw rate after 5 s, by the vehicle",
                (),
                "Check order, sign and neutral of the outputs and angles; record faster manoeuvres.",
            )
        )
    found += [
        Finding.warning(
            "identify.linear",
            f"a linear model predicts the {motion} better: {line:.3g} after 5 s, and {own:.3g} by the vehicle",
            (),
            "Check order, sign and neutral of the outputs, and the positions of the propellers; free further keys.",
        )
        for motion, own, line in _worse_than_linear(result)
    ]
    return found


def _no_better_than_persistence(result: Identification) -> tuple[float, ...]:
    """Return the vehicle's errors over 5 s if they are not clearly below those of a boat that keeps its velocity."""
    errors = {own.model: own.errors for own in result.scores if own.horizon_s == _COMPARED_S}
    if not errors:
        return ()
    pairs = zip(errors["identified"][:3], errors["persistence"][:3], strict=True)
    return () if any(own < _CLEARLY * kept for own, kept in pairs) else errors["identified"]


def _worse_than_linear(result: Identification) -> list[tuple[str, float, float]]:
    """Return the motions that a linear model predicts clearly better over 5 s, with both errors."""
    errors = {own.model: own.errors for own in result.scores if own.horizon_s == _COMPARED_S}
    if not errors:
        return []
    pairs = zip(SCORES[:3], errors["identified"], errors["linear"], strict=False)
    return [(motion, own, line) for motion, own, line in pairs if line < _CLEARLY * own]


def figure_rows(result: Identification) -> list[tuple[str, float | None, float | None, str]]:
    """Return name, value, standard error and unit of each figure."""
    return [(own.name, significant(own.value), significant(own.sigma, 2), own.unit) for own in result.figures]


def key_rows(result: Identification) -> list[tuple[str, float | None, float | None, float | None, str]]:
    """Return name, value before, value, standard error, and what would determine a key."""
    return [
        (own.key, significant(own.start), significant(own.value), significant(own.sigma, 2), own.advice)
        for own in result.keys
    ]


def score_rows(result: Identification) -> list[tuple[str | float | int | None, ...]]:
    """Return length, model, number of windows and errors."""
    return [
        (own.horizon_s, own.model, own.windows, *(significant(error, 3) for error in own.errors))
        for own in result.scores
    ]


def _plots(result: Identification) -> Sequence[Plot]:
    shown = result.predictions[:_MOST_PLOTS]
    return [
        Plot(
            f"prediction {number} {name}",
            f"{Path(own.source).name} from {own.time_s[0]:.0f} s: {name}",
            f"{name} ({unit})",
            (
                Trace("measured", own.time_s, own.measured[:, axis]),
                Trace("predicted", own.time_s, own.predicted[:, axis]),
                Trace("by the first vehicle", own.time_s, own.before[:, axis]),
            ),
            kind="xy",
            x_label="time (s)",
        )
        for number, own in enumerate(shown)
        for axis, (name, unit) in enumerate(_MOTIONS)
    ]
