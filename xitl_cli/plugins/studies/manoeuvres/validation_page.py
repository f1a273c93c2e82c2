"""The validation of vessels as a page in the logs' format: figures, references and plots of each manoeuvre."""

from __future__ import annotations

from collections.abc import Sequence

from xitl_cli.logs.clocks.time_line import TimeLine
from xitl_cli.logs.model.sections import Finding, Grid, Section
from xitl_cli.logs.report.page import FileCard, Page, PagePart
from xitl_cli.plugins.studies.manoeuvres.advice import advice
from xitl_cli.plugins.studies.manoeuvres.validation import FigureReference, ValidatedFigure, VesselValidation

NO_REFERENCE = "no published reference"
COLUMNS = ("figure", "unit", "ours", "reference", "error", "agrees", "source")


def validation_page(validations: Sequence[VesselValidation]) -> Page:
    """Return a page with a part for each manoeuvre of each vessel, and differences at the top."""
    several = len(validations) > 1
    parts = [
        PagePart(_section(section, validation), TimeLine(), validation.vehicle if several else "")
        for validation in validations
        for section in validation.sections
    ]
    cards = tuple(FileCard(one.vehicle, _facts(one)) for one in validations)
    return Page("Validation", ", ".join(one.vehicle for one in validations), tuple(parts), cards)


def counts(validation: VesselValidation) -> tuple[int, int, int]:
    """Return the numbers of figures that agree, that differ, and that have no reference."""
    verdicts = [figure.agrees for figure in validation.figures]
    return verdicts.count(True), verdicts.count(False), sum(figure.reference is None for figure in validation.figures)


def _facts(validation: VesselValidation) -> tuple[tuple[str, str], ...]:
    agree, differ, unknown = counts(validation)
    return (
        ("steered by", validation.steered_by),
        ("agree with their reference", str(agree)),
        ("differ", str(differ)),
        (NO_REFERENCE, str(unknown)),
    )


def _section(section: Section, validation: VesselValidation) -> Section:
    figures = [figure for figure in validation.figures if figure.manoeuvre == section.title]
    rows = tuple(_row(figure) for figure in figures)
    findings = tuple(_finding(figure) for figure in figures if figure.agrees is False)
    grid = Grid(f"{section.key}.figures", "Figures beside their references", COLUMNS, rows)
    return Section(
        section.key, section.title, findings=findings, grids=(grid,), plots=section.plots, lacks=section.lacks
    )


def _row(figure: ValidatedFigure) -> tuple[str | float | None, ...]:
    reference = figure.reference
    return (
        figure.label,
        figure.unit,
        rounded(figure.value),
        None if reference is None else rounded(reference.value),
        figure.error_text,
        "" if figure.agrees is None else "yes" if figure.agrees else "no",
        NO_REFERENCE if reference is None else _source(reference),
    )


def _source(reference: FigureReference) -> str:
    return reference.source + (f"; disputed: {reference.disputed}" if reference.disputed else "")


def rounded(value: float | None) -> float | None:
    """Round to four digits, and rounding residues to zero."""
    return None if value is None else 0.0 if abs(value) < 1e-9 else float(f"{value:.4g}")


def _finding(figure: ValidatedFigure) -> Finding:
    assert figure.reference is not None
    return Finding.warning(
        f"validation.{figure.key}",
        f"{figure.label}: {'not reached' if figure.value is None else f'{figure.value:.4g} {figure.unit}'.rstrip()}, "
        f"where {figure.reference.source} says {figure.reference.value:.4g}; {figure.error_text or 'no value'}",
        (),
        advice(figure),
    )
