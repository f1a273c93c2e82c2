"""`xitl validate`: standard manoeuvres of vessels, and their surroundings, compared with references."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from xitl_cli.commands.options import Json, OpenPage, complete_vehicle
from xitl_cli.commands.output import open_in_browser, quiet_pipe
from xitl_cli.errors import UserError

if TYPE_CHECKING:
    from collections.abc import Callable

    from rich.console import Console

    from xitl_cli.plugins.studies.manoeuvres.references import Source
    from xitl_cli.plugins.studies.manoeuvres.validation import ValidatedFigure, Validation
    from xitl_cli.profile import Profile

PAGE = "validation.html"


def validate(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="VEHICLE...",
            help="Names or files of vehicles, or profiles with one, or `surroundings` (default: all of them).",
            autocompletion=complete_vehicle,
        ),
    ] = None,
    report: Annotated[
        bool, typer.Option("--report", help=f"Write a page with all plots and tables: {PAGE}, or see --out.")
    ] = False,
    out: Annotated[
        Path | None, typer.Option("--out", metavar="HTML", help="File of the page; an existing one is replaced.")
    ] = None,
    as_json: Json = False,
    open_it: OpenPage = False,
) -> None:
    """Sail the standard manoeuvres with vessels and compare each figure with its reference.

    Turning circles, zig-zags, spiral, acceleration, crash stop, decays, responses to waves; and Earth, magnetic field,
    atmosphere and waves against published tables. A figure without a reference does not count. The summary states the
    kinds of the references. For each difference, the command states its importance and the key to change.

    Exit code: 0 all figures with a reference agree; 1 some differ; 2 an error.
    """
    from xitl_cli.logs.report import html
    from xitl_cli.plugins.studies.manoeuvres.surroundings import SURROUNDINGS
    from xitl_cli.plugins.studies.manoeuvres.validation_page import kind_counts, validation_page
    from xitl_cli.profile import load_profile
    from xitl_cli.profile.files.catalogue import shipped_profiles

    wanted = list(names or ())
    if (report or out) and wanted and wanted[-1].endswith((".html", ".htm")) and out is None:
        out = Path(wanted.pop())  # `--report page.html`
    page = out or (Path(PAGE) if report or open_it else None)
    if page is not None:
        html.refuse_other(page)
    wanted = wanted or [*(name for name in shipped_profiles() if name.startswith("vehicles/")), SURROUNDINGS]
    surroundings = SURROUNDINGS in wanted
    wanted = [name for name in wanted if name != SURROUNDINGS]
    loaded = [(name, vessel) for name in wanted for vessel in load_profile(name).one_a_vehicle]
    for name, profile in loaded:
        if profile.vehicle is None:
            raise UserError(f"{name}: has no vehicle; use a file with a group `vehicle`")
    validations = _validate_all([profile for _, profile in loaded], surroundings)
    if page is not None:
        html.write_page(validation_page(validations), page)
    with quiet_pipe():
        if as_json:
            import json

            vehicles = [
                {
                    "vehicle": validation.name,
                    "steered_by": validation.steered_by,
                    "figures": [_figure(figure) for figure in validation.figures],
                }
                for validation in validations
                if validation.name != SURROUNDINGS
            ]
            others = [_figure(figure) for one in validations if one.name == SURROUNDINGS for figure in one.figures]
            kinds = {str(kind): count for kind, count in kind_counts(validations).items()}
            answer = {"references": kinds, "vehicles": vehicles, SURROUNDINGS: others}
            print(json.dumps(answer, ensure_ascii=False, allow_nan=False))
        else:
            _show(validations, page)
    if page is not None and open_it:
        open_in_browser(page)
    raise typer.Exit(1 if any(validation.differing for validation in validations) else 0)


def _validate_all(profiles: Sequence[Profile], surroundings: bool) -> list[Validation]:
    """Validate several vessels in parallel, one per processor, and the surroundings.

    Raises UserError for a vessel that does not float.
    """
    from xitl_cli.commands.terminal import progress
    from xitl_cli.plugins.studies.manoeuvres.validation import validate_surroundings

    further = [validate_surroundings] if surroundings else []
    if len(profiles) < 2 or (processors := os.cpu_count() or 1) == 1:
        with progress("loading") as tell:
            return [*(_validate(profile, tell) for profile in profiles), *(validate() for validate in further)]
    from concurrent.futures import ProcessPoolExecutor, as_completed
    from multiprocessing import get_context

    # Forked processes need not load anything. The progress has a thread, so it begins later.
    method = "fork" if sys.platform == "linux" else "spawn"
    with ProcessPoolExecutor(min(processors, len(profiles)), get_context(method)) as pool:
        futures = [pool.submit(_validate, profile) for profile in profiles]
        with progress("loading") as tell:
            validations = [validate() for validate in further]
            for number, _ in enumerate(as_completed(futures), 1):
                tell(f"{number} of {len(profiles)} vessels done")
            return [*(future.result() for future in futures), *validations]


def _validate(profile: Profile, tell: Callable[[str], None] = lambda _: None) -> Validation:
    from xitl_cli.plugins.studies.manoeuvres.validation import validate_vessel

    vehicle = profile.vehicle
    assert vehicle is not None
    water = profile.environment.water if profile.environment else None
    try:
        return validate_vessel(
            vehicle, vehicle.name, water, profile.autopilot, lambda text: tell(f"{vehicle.name}: {text}")
        )
    except ValueError as error:
        raise UserError(f"{vehicle.name}: {error}") from None


def _figure(figure: ValidatedFigure) -> dict[str, Any]:
    from xitl_cli.plugins.studies.manoeuvres.validation_page import advice

    reference = figure.reference
    return {
        "manoeuvre": figure.manoeuvre,
        "key": figure.key,
        "label": figure.label,
        "unit": figure.unit,
        "value": figure.value,
        "reference": None if reference is None else reference.value,
        "allowed": None if reference is None else reference.allowed,
        "error": figure.error,
        "agrees": figure.agrees,
        "advice": advice(figure) or None,
        "kind": None if reference is None else str(reference.source.kind),
        "source": None if reference is None else reference.source.text,
        "disputed": (reference.disputed or None) if reference is not None else None,
    }


def _show(validations: Sequence[Validation], page: Path | None) -> None:
    from xitl_cli.commands.terminal import say, show_facts, terminal
    from xitl_cli.plugins.studies.manoeuvres.validation_page import NO_REFERENCE, advice, counts, shares

    console = terminal()
    references = (figure.reference for validation in validations for figure in validation.figures)
    sources = list(dict.fromkeys(reference.source for reference in references if reference is not None))
    for validation in validations:
        steered = f", steered by {validation.steered_by}" if validation.steered_by else ""
        say(console, f"{validation.name}{steered}", "bold")
        _show_figures(console, validation, sources)
        agree, differ, unknown = counts(validation)
        disputed = sum(bool(own.reference and own.reference.disputed) for own in validation.figures)
        verdict = f"{agree} agree with their reference, {differ} differ, {unknown} have {NO_REFERENCE}"
        verdict += f", {disputed} have a disputed one" if disputed else ""
        say(console, verdict, "red" if differ else "green")
        if validation.differing:
            show_facts(console, [(f"  {figure.label}", advice(figure), "yellow") for figure in validation.differing])
        console.print()
    say(console, "References", "bold")
    numbered = enumerate(sources, 1)
    show_facts(console, [(f"  {number}", f"{source.kind}: {source.text}") for number, source in numbered])
    console.print()
    say(console, "Comparisons by the kind of their reference", "bold")
    show_facts(console, [(f"  {label}", share) for label, share in shares(validations)])
    if page is not None:
        console.print()
        say(console, f"page with all plots: {page}")


def _show_figures(console: Console, validation: Validation, sources: Sequence[Source]) -> None:
    from rich.text import Text

    from xitl_cli.commands.terminal import say
    from xitl_cli.logs.report.wording import UNKNOWN, value_text
    from xitl_cli.plugins.studies.manoeuvres.validation_page import NO_REFERENCE, rounded

    labels = {figure: figure.label + (f" ({figure.unit})" if figure.unit else "") for figure in validation.figures}
    width = max(map(len, labels.values()))
    say(console, f"{'':{width}}  {'ours':>9} {'reference':>10} {'error':>11}", "bold")
    for section in validation.sections:
        say(console, section.title, "bold")
        for figure, label in labels.items():
            if figure.manoeuvre != section.title:
                continue
            line = f"  {label:<{width}}{UNKNOWN if figure.value is None else value_text(rounded(figure.value)):>9}"
            if (reference := figure.reference) is None:
                line += f"  {NO_REFERENCE}"
            else:
                number = sources.index(reference.source) + 1
                line += f" {value_text(rounded(reference.value)):>10} {figure.error_text:>11} [{number}]"
                line += " disputed" if reference.disputed else "" if figure.agrees else " differs"
            style = "red" if figure.agrees is False else "dim" if reference is None else ""
            console.print(Text(line, style=style), soft_wrap=True)
        for lack in section.lacks:
            say(console, f"  {lack}", "yellow")
    for figure in validation.figures:
        if figure.reference is not None and figure.reference.disputed:
            say(
                console,
                f"{figure.label}: {figure.reference.source.text} is disputed: {figure.reference.disputed}",
                "yellow",
            )
