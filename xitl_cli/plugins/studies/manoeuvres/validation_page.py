"""The validation of vessels as a page in the logs' format: figures, references and plots of each manoeuvre.

`advice` gives the importance of a difference, and the key of the vessel to change.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from xitl_cli.logs.clocks.time_line import TimeLine
from xitl_cli.logs.model.sections import Finding, Grid, Section
from xitl_cli.logs.report.page import FileCard, Page, PagePart
from xitl_cli.plugins.studies.manoeuvres.panel_reference import PANEL_CODE
from xitl_cli.plugins.studies.manoeuvres.references import ReferenceKind, kind_shares
from xitl_cli.plugins.studies.manoeuvres.validation import (
    ARCHIMEDES,
    HORIZONTAL,
    LINEAR,
    LOITER,
    LONG_WAVES,
    MIRRORED,
    STRIPS,
    SURGE_ALONE,
    ValidatedFigure,
    Validation,
)

NO_REFERENCE = "no reference"
COLUMNS = ("figure", "unit", "ours", "reference", "error", "agrees", "kind", "source")

_MUCH = 3.0
"""Number of tolerances up to which an omission in a closed form explains a difference."""
_ADVICE = {
    ARCHIMEDES: (
        "draft and trim shift drag, windage and natural periods",
        "check vehicle.mass_kg and vehicle.centre_of_gravity_frd_m, and raise `strips` of the hulls, because the "
        "closed form has whole hulls",
    ),
    SURGE_ALONE: (
        "it affects the times of missions and the distances to stop",
        "check the trim at top speed in `xitl vehicle check`. Lower the lever between thrust "
        "(vehicle.propellers.N.position_frd_m) and drag, because the closed form is level",
    ),
    HORIZONTAL: (
        "it affects turns at waypoints, but not straight legs",
        "check the heel in the turn in `xitl vehicle check`. Lower vehicle.centre_of_gravity_frd_m or raise "
        "vehicle.damping_linear.roll, because the closed form neither heels nor trims",
    ),
    MIRRORED: (
        "the boat turns better to one side, which an autopilot must compensate",
        "give propellers and rudders of both sides the same thrust and angle and opposite second coordinates, and set "
        "that of the centre of gravity to 0; leave it if the boat is asymmetric",
    ),
    LINEAR: (
        "it affects seas near the natural period, but not still water",
        "lower the quadratic damping of this motion (vehicle.damping_quadratic), or use hulls that change less near "
        "the waterline, because the closed form has small motions; a decay test of the boat shows which is right",
    ),
    PANEL_CODE: (
        "it affects only seas of this wavelength",
        "make the tables (vehicle.hydrodynamics_file) again with more panels, or check mass and inertia against them",
    ),
    STRIPS: (
        "it affects only seas of this wavelength",
        "raise the damping of this motion (vehicle.damping_linear) if its damping ratio is below 0.1, or `strips` of "
        "the hulls for short waves",
    ),
    LONG_WAVES: (
        "the boat does not follow a swell",
        "check vehicle.inertia_kgm2 and vehicle.added_mass: both have little effect in long waves",
    ),
    LOITER: (
        "it affects station keeping, but not the boat under way",
        "raise max_thrust_n against wind and current, or LOIT_RADIUS in autopilot.parameters",
    ),
}
"""By source of the reference: the importance of a difference, and the change that removes it."""
_ADVICE_ON_PUBLISHED = (
    "results are no longer those of the published vessel",
    "compare the file with docs/vehicles.md, or give your vessel another name (vehicle.name)",
)


def advice(figure: ValidatedFigure) -> str:
    """Return the importance of a difference and the key to change, in sentences; empty for a figure that agrees."""
    if figure.agrees is not False or figure.reference is None:
        return ""
    importance, change = _ADVICE.get(figure.reference.source, _ADVICE_ON_PUBLISHED)
    if figure.error is None:
        return f"It matters: the manoeuvre never reached it. To change it, {change}."
    times = abs(figure.error) / figure.reference.allowed if figure.reference.allowed else float("inf")
    weight = "It hardly matters" if times <= _MUCH else "It matters"
    return f"{weight}: the error is {times:.2g} times its tolerance, and {importance}. To change it, {change}."


def validation_page(validations: Sequence[Validation]) -> Page:
    """Return a page with a part for each manoeuvre of each vessel, and differences at the top."""
    several = len(validations) > 1
    parts = [
        PagePart(_section(section, validation), TimeLine(), validation.name if several else "")
        for validation in validations
        for section in validation.sections
    ]
    cards = []
    for validation in validations:
        agree, differ, unknown = counts(validation)
        facts = (
            *((("steered by", validation.steered_by),) if validation.steered_by else ()),
            ("agree with their reference", str(agree)),
            ("differ", str(differ)),
            (NO_REFERENCE, str(unknown)),
            *shares([validation]),
        )
        cards.append(FileCard(validation.name, facts))
    if several:
        cards.insert(0, FileCard("all", shares(validations)))
    names = ", ".join(validation.name for validation in validations)
    return Page("Validation", names, tuple(parts), tuple(cards))


def counts(validation: Validation) -> tuple[int, int, int]:
    """Return the numbers of figures that agree, that differ, and that have no reference."""
    verdicts = [figure.agrees for figure in validation.figures]
    return verdicts.count(True), verdicts.count(False), sum(figure.reference is None for figure in validation.figures)


def kind_counts(validations: Iterable[Validation]) -> dict[ReferenceKind, int]:
    """Return the number of comparisons of each kind."""
    return kind_shares(figure.reference for validation in validations for figure in validation.figures)


def shares(validations: Iterable[Validation]) -> tuple[tuple[str, str], ...]:
    """Return the comparisons by the kind of their reference as label and text, and those from outside together."""
    found = kind_counts(validations)
    total = max(sum(found.values()), 1)
    outside = sum(count for kind, count in found.items() if kind.from_outside)
    rows = [(str(kind), count) for kind, count in found.items() if count] + [("from outside xitl", outside)]
    return tuple((label, f"{count} of {total} ({100 * count / total:.0f} %)") for label, count in rows)


def _section(section: Section, validation: Validation) -> Section:
    figures = [figure for figure in validation.figures if figure.manoeuvre == section.title]
    rows: list[tuple[str | float | None, ...]] = []
    findings = []
    for figure in figures:
        kind, source, value = "", NO_REFERENCE, None
        if (reference := figure.reference) is not None:
            kind, source, value = str(reference.source.kind), reference.source.text, rounded(reference.value)
            source += f"; disputed: {reference.disputed}" if reference.disputed else ""
        agrees = "" if figure.agrees is None else "yes" if figure.agrees else "no"
        error = figure.error_text
        rows.append((figure.label, figure.unit, rounded(figure.value), value, error, agrees, kind, source))
        if figure.agrees is False:
            findings.append(_finding(figure))
    grid = Grid(f"{section.key}.figures", "Figures and their references", COLUMNS, tuple(rows))
    return Section(
        section.key,
        section.title,
        findings=tuple(findings),
        grids=(grid,),
        plots=section.plots,
        lacks=section.lacks,
    )


def rounded(value: float | None) -> float | None:
    """Round to four digits, and rounding residues to zero."""
    return None if value is None else 0.0 if abs(value) < 1e-9 else float(f"{value:.4g}")


def _finding(figure: ValidatedFigure) -> Finding:
    assert figure.reference is not None
    return Finding.warning(
        f"validation.{figure.key}",
        f"{figure.label}: {'not reached' if figure.value is None else f'{figure.value:.4g} {figure.unit}'.rstrip()}, "
        f"but {figure.reference.value:.4g} by {figure.reference.source.text}; error: {figure.error_text or 'no value'}",
        (),
        advice(figure),
    )
