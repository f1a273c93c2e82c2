"""`xitl campaign`: many runs of a plan, and `xitl campaign compare`."""

from __future__ import annotations

import json
import math
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any

import typer
import typer.core

from xitl_cli.commands.options import Json
from xitl_cli.commands.output import quiet_pipe, still_read
from xitl_cli.commands.terminal import say, show_rows, terminal
from xitl_cli.end_signals import end_signals_handled
from xitl_cli.errors import UserError
from xitl_cli.extras import CAMPAIGN

if TYPE_CHECKING:
    from rich.console import Console

    from xitl_cli.plugins.campaign.cluster import TlsFiles
    from xitl_cli.plugins.campaign.engine import CampaignProgress
    from xitl_cli.plugins.campaign.estimate import RunCost
    from xitl_cli.plugins.campaign.plan import CampaignPlan
    from xitl_cli.plugins.campaign.results import ResultTable

MANY = 10_000
"""Number of runs above which the command asks."""
PASSED, SOME_FAILED, INTERRUPTED = 0, 1, 130
DEFAULT_COMMAND = "run"
_SHOWN = 20
_LINE_EVERY_S = 10.0


class CampaignGroup(typer.core.TyperGroup):
    """`xitl campaign PLAN.yaml` is `xitl campaign run PLAN.yaml`."""

    default_command = DEFAULT_COMMAND

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse arguments like click."""
        if args and args[0] not in self.commands and args[0] not in ("-h", "--help"):
            args = [DEFAULT_COMMAND, *args]
        return super().parse_args(ctx, args)


def run(
    plan: Annotated[
        str,
        typer.Argument(metavar="PLAN", help="A plan: a YAML file, or the name of a shipped one (docs/campaigns.md)."),
    ],
    on: Annotated[
        str | None,
        typer.Option(
            "--on", metavar="ADDRESS", help="Dask scheduler, such as tls://host:8786 (default: this machine)."
        ),
    ] = None,
    tls_ca_file: Annotated[
        Path | None,
        typer.Option("--tls-ca-file", metavar="PEM", help="Authority of the certificates of a tls:// scheduler."),
    ] = None,
    tls_cert: Annotated[
        Path | None, typer.Option("--tls-cert", metavar="PEM", help="Certificate of this machine for --on.")
    ] = None,
    tls_key: Annotated[
        Path | None, typer.Option("--tls-key", metavar="PEM", help="Key of --tls-cert, if it is in another file.")
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            "--workers", metavar="N", min=1, max=1024, help="Parallel runs on this machine (default: one per core)."
        ),
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Continue an earlier campaign with its missing runs; see --out.")
    ] = False,
    report: Annotated[
        bool, typer.Option("--report", help="Write a page with plots into the campaign's folder.")
    ] = False,
    yes: Annotated[bool, typer.Option("--yes", "-y", help=f"Do not ask before more than {MANY} runs.")] = False,
    out: Annotated[
        Path | None,
        typer.Option(
            "--out",
            metavar="DIR",
            help="Folder (default: runs/<plan>-<time>; with --resume: the latest folder of the plan).",
        ),
    ] = None,
    dry_run: Annotated[
        bool,
        typer.Option(
            "--dry-run", help="List the runs and estimate time and disk space; simulate a few seconds at most."
        ),
    ] = False,
    as_json: Json = False,
) -> None:
    """Run a plan: many runs of a profile on all cores, or on a Dask cluster.

    Exit code: 0 all runs passed, or a search found every boundary; 1 otherwise; 2 an error; 130 interrupted (continue
    with --resume).
    """
    from xitl_cli.plugins.campaign.cluster import TlsFiles, check_installed
    from xitl_cli.plugins.campaign.plan import find_plan, read_plan

    checked = read_plan(find_plan(plan))
    if on is not None and workers is not None:
        raise UserError("--workers is for this machine and --on for another scheduler; use one of them")
    if dry_run:
        if checked.search is not None or checked.spec.sensitivity is not None:
            check_installed()
        with quiet_pipe():
            _show_points(checked, as_json, on, workers, out)
        return
    pem_files = [None if path is None else str(path) for path in (tls_ca_file, tls_cert, tls_key)]
    if on is None and any(pem_files):
        raise UserError("--tls-ca-file, --tls-cert and --tls-key apply to --on only; remove them")
    tls = None if on is None else TlsFiles(*pem_files)
    table, complete = _carry_out(checked, on, tls, workers, resume, yes, out)
    page = None
    if report:
        from xitl_cli.plugins.campaign.report import write_report

        page = write_report(table)
    with still_read():
        if as_json:
            typer.echo(json.dumps(result_document(table, complete, page), indent=2, allow_nan=False))
        else:
            show_table(terminal(), table, page)
    if not complete:
        raise typer.Exit(INTERRUPTED)
    if (document := table.about.get("search")) is None:
        success = all(row["passed"] for row in table.rows)
    else:
        from xitl_cli.plugins.campaign.bisection import Outcome
        from xitl_cli.plugins.campaign.search import evaluate
        from xitl_cli.plugins.campaign.search_spec import Search

        findings = [group.found for group in evaluate(Search.read(document), table.rows)]
        success = all(finding is not None and finding.outcome == Outcome.FOUND for finding in findings)
    raise typer.Exit(PASSED if success else SOME_FAILED)


def _carry_out(
    plan: CampaignPlan,
    on: str | None,
    tls: TlsFiles | None,
    workers: int | None,
    resume: bool,
    yes: bool,
    out: Path | None,
) -> tuple[ResultTable, bool]:
    """Return the table, and True if it has all runs. Raises UserError for a plan without runs, or without consent to
    many runs.
    """
    from xitl_cli.plugins.campaign.cluster import check_installed, is_open

    check_installed()
    from xitl_cli.plugins.campaign.engine import carry_out
    from xitl_cli.plugins.campaign.results import open_folder

    def interrupt(number: int, frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    if plan.most_runs() > MANY and not yes:
        _ask(plan, plan.most_runs())
    _refuse_no_runs(plan)
    total = sum(1 for _ in plan.points())
    folder = open_folder(plan, out, resume)
    console = terminal(stderr=True)
    count = f"up to {plan.most_runs()}" if plan.search is not None else total
    say(console, f"{count} runs of {plan.base.name}, in {folder.path}")
    if on is not None and is_open(on):
        say(
            console,
            f"{on} is not encrypted: anyone who can reach it can run programs there as its user (docs/campaigns.md)",
        )
    with _shown_progress(console) as watch, end_signals_handled(interrupt):
        try:
            table = carry_out(plan, folder, on, workers, None if plan.search is not None else total, watch, tls)
        except KeyboardInterrupt:
            left = "" if plan.search is not None else f" with {total - len(folder.done)} of {total} runs left"
            say(console, f"interrupted{left}; continue with --resume --out {folder.path}")
            return folder.table(), False
    return table, True


def _refuse_no_runs(plan: CampaignPlan) -> None:
    if next(plan.points(), None) is None:
        reason = "no combination satisfies the constraints" if plan.constraints else "an axis has no values"
        raise plan.problem("constraints" if plan.constraints else "axes", f"axes: the plan has no runs: {reason}")


def _ask(plan: CampaignPlan, most: int) -> None:
    at_most = "up to " if plan.constraints else ""
    factors = " × ".join([*(f"{len(axis.values) or axis.count} of {axis.key}" for axis in plan.axes)])
    runs = f"{at_most}{most} runs ({factors}{' × ' if factors else ''}{len(plan.seeds)} seeds)"
    if not sys.stdin.isatty():
        raise UserError(f"{plan.path}: has {runs}; add --yes to run them all")
    if not typer.confirm(f"{plan.path}: has {runs}. Run them all?", default=False, err=True):
        raise UserError(f"{plan.path}: nothing was run; use fewer values, or combine: latin_hypercube with samples")


class _Watch:
    """Shows the progress of a campaign: one changing line at a terminal, otherwise a line at intervals."""

    def __init__(self, tell: Callable[[str], None], show: Callable[[str], None], every_s: float) -> None:
        self._tell, self._show, self._every_s = tell, show, every_s
        self._next_s = 0.0

    def began(self, threads: int, on: str | None, dashboard: str | None) -> None:
        """Show the location of the runs and the number of parallel runs."""
        runs = f"{threads} parallel runs on {'this machine' if on is None else on}"
        self._tell(f"{runs}, dashboard {dashboard}" if dashboard else runs)

    def __call__(self, progress: CampaignProgress) -> None:
        if time.monotonic() < self._next_s and progress.done != progress.total:
            return
        self._next_s = time.monotonic() + self._every_s
        self._show(progress_text(progress))


def progress_text(progress: CampaignProgress) -> str:
    """Return one line: completed and total runs, rate, estimated end, failures so far by status."""
    words = [f"{progress.done} of {progress.total} runs" if progress.total is not None else f"{progress.done} runs"]
    if (rate_hz := progress.rate_hz) is not None:
        words.append(f"{rate_hz:.1f} per second" if rate_hz >= 1 else f"{rate_hz * 60:.1f} per minute")
    if (left_s := progress.left_s) is not None and progress.done != progress.total:
        words.append(f"{duration_text(left_s)} left")
    failed = progress.done - progress.passed
    words.append(f"{failed} did not pass" if failed else "all passed" if progress.done else "none completed yet")
    troubles = [f"{count} {status}" for status, count in sorted(progress.statuses.items()) if status != "completed"]
    return ", ".join(words) + (f" ({', '.join(troubles)})" if troubles else "")


def duration_text(seconds: float) -> str:
    """Return `2 h 05 min`, `4 min 10 s`, `12 s`."""
    whole = round(seconds)
    if whole >= 3600:
        return f"{whole // 3600} h {whole % 3600 // 60:02d} min"
    return f"{whole // 60} min {whole % 60:02d} s" if whole >= 60 else f"{whole} s"


@contextmanager
def _shown_progress(console: Console) -> Iterator[_Watch]:
    def tell(text: str) -> None:
        say(console, text)

    if not console.is_terminal:
        yield _Watch(tell, tell, _LINE_EVERY_S)
        return
    from rich.text import Text

    with console.status("starting workers") as status:
        yield _Watch(tell, lambda text: status.update(Text(text)), 0.2)


def _show_points(plan: CampaignPlan, as_json: bool, on: str | None, workers: int | None, out: Path | None) -> None:
    """Run `--dry-run`. Raises UserError for a plan without runs, or with a figure that its runs do not have."""
    from xitl_cli.plugins.campaign.axes import value_text
    from xitl_cli.plugins.campaign.estimate import run_cost
    from xitl_cli.plugins.campaign.results import campaign_folders

    _refuse_no_runs(plan)
    cost = run_cost(plan, campaign_folders(plan, out))
    keys = (*plan.axis_keys, "seed")
    points = plan.points()
    if as_json:
        for point in points:
            row = {**plan.base_values, **point.values, "seed": point.seed, "command": plan.base.command(point)}
            print(json.dumps({"number": point.number, **row}, default=list))
        return
    console, rows, total = terminal(), [], 0
    for point in points:
        total += 1
        if total <= _SHOWN:
            values = {**plan.base_values, **point.values, "seed": point.seed}
            rows.append([str(point.number), *(value_text(values.get(key)) for key in keys)])
        elif total > MANY:
            total = plan.most_runs()
            break
    show_rows(console, ("run", *keys), rows, text=())
    rest = f"{total - len(rows)} more; " if total > len(rows) else ""
    if plan.search is not None:
        say(
            console,
            f"the first round of a search of up to {plan.most_runs()} runs; its verdicts determine the next rounds",
        )
    verdicts = ", ".join(verdict.text for verdict in plan.verdicts)
    say(console, f"{rest}{total} runs in total. A run passes if: {verdicts}")
    console.print(f"the first run: {plan.base.command(next(plan.points()))}", soft_wrap=True)
    say(console, cost_text(cost, total if plan.search is None else plan.most_runs(), plan.spec.recordings, on, workers))


def cost_text(cost: RunCost, runs: int, recordings: str, on: str | None, workers: int | None) -> str:
    """Return wall time and disk of a campaign in a sentence each, and the basis of both."""
    from xitl_cli.logs.model.text import plural
    from xitl_cli.plugins.campaign.estimate import ROW_BYTES

    about = "at most about" if cost.at_most else "about"
    if cost.wall_s is None:
        time_text = "wall time: unknown"
    elif on is not None:
        time_text = f"wall time: {about} {duration_text(runs * cost.wall_s)} over the workers of {on}"
    else:
        parallel = min(workers or os.cpu_count() or 1, runs)
        whole_s = math.ceil(runs / parallel) * cost.wall_s
        time_text = f"wall time: {about} {duration_text(whole_s)} with {plural(parallel, 'parallel run')}"
    rows_bytes = runs * ROW_BYTES
    if recordings == "none":
        disk_text = f"disk: about {size_text(rows_bytes)}, because no run is kept"
    elif cost.folder_bytes is None:
        disk_text = "disk: unknown"
    else:
        if_all = " if every run fails" if recordings == "failures" else ""
        disk_text = f"disk: {about} {size_text(rows_bytes + runs * cost.folder_bytes)}{if_all}"
    return f"{time_text}; {disk_text}. Basis: {cost.basis}"


def size_text(size_bytes: float) -> str:
    """Return `1.2 GB`, `350 MB`, `20 kB`: powers of ten, two digits or whole units."""
    for unit, factor in (("GB", 1e9), ("MB", 1e6)):
        if size_bytes >= factor:
            return f"{size_bytes / factor:.{1 if size_bytes < 10 * factor else 0}f} {unit}"
    return f"{max(1, round(size_bytes / 1e3))} kB"


def result_document(table: ResultTable, complete: bool, page: Path | None) -> dict[str, Any]:
    """Return the document of `--json`."""
    from collections import Counter

    from xitl_cli.commands.output import sections_document
    from xitl_cli.plugins.campaign.report import pass_rate, summary_sections

    verdicts = []
    for text in (*table.verdicts, "passed"):
        count, share = pass_rate(table.rows, text)
        verdicts.append({"verdict": text, "held": count, "runs": len(table), "low": share.low, "high": share.high})
    return {
        "campaign": table.about["name"],
        "directory": str(table.folder),
        "complete": complete,
        "runs": len(table),
        "statuses": dict(Counter(table.column("status"))),
        "passed": sum(bool(row["passed"]) for row in table.rows),
        "verdicts": verdicts,
        "worst": [{key: row[key] for key in ("number", "status", "error", "command")} for row in table.worst()],
        "report": None if page is None else str(page),
        "sections": sections_document(summary_sections(table)),
    }


def show_table(console: Console, table: ResultTable, page: Path | None) -> None:
    """Show the results of a campaign: statuses, verdicts with their intervals, the worst runs and commands to repeat
    them.
    """
    from collections import Counter

    from xitl_cli.plugins.campaign.execution import RAN
    from xitl_cli.plugins.campaign.report import pass_rate, summary_sections

    count = len(table)
    statuses = Counter(table.column("status"))
    passed = sum(bool(row["passed"]) for row in table.rows)
    by_status = ", ".join(f"{number} {status}" for status, number in statuses.most_common())
    console.print()
    say(console, f"{passed} of {count} runs passed ({by_status})", "green" if passed == count else "red")
    rows = []
    for text in (*table.verdicts, *(["all of them"] if len(table.verdicts) > 1 else [])):
        column = "passed" if text == "all of them" else text
        satisfied, interval = pass_rate(table.rows, column)
        share, percent = 100 * satisfied / max(count, 1), f"{100 * interval.low:.1f} – {100 * interval.high:.1f} %"
        rows.append([text, f"{satisfied} of {count}", f"{share:.1f} %", percent])
    console.print()
    show_rows(console, ("verdict", "satisfied", "share", "95 % interval"), rows)
    from xitl_cli.commands.output import show_sections

    show_sections(console, summary_sections(table))
    worst = table.worst()
    if worst:
        console.print()
        say(console, "worst runs", "bold")
        for row in worst:
            missed = [text for text in table.verdicts if row.get(text) is not True] if row["status"] in RAN else []
            reason = "; ".join(filter(None, (", ".join(missed), row["error"])))
            say(console, f"{row['number']:>6}  {row['status']}: {reason}")
            console.print(f"        {row['command']}", soft_wrap=True)
    console.print()
    say(console, f"{table.folder}: results.jsonl, results.parquet" + (f", {page.name}" if page else ""))


def compare(
    a: Annotated[Path, typer.Argument(metavar="A", help="Folder of the reference campaign.")],
    b: Annotated[
        Path | None, typer.Argument(metavar="[B]", help="Folder of a second campaign with the same seeds and axes.")
    ] = None,
    by: Annotated[
        str | None,
        typer.Option("--by", metavar="AXIS", help="Split A by an axis instead of B; its first value is the reference."),
    ] = None,
    confidence: Annotated[
        float, typer.Option(min=0.5, max=0.9999, help="Confidence of the intervals and tests.")
    ] = 0.95,
    report: Annotated[Path | None, typer.Option("--report", metavar="FILE", help="Write a page with plots.")] = None,
    as_json: Json = False,
) -> None:
    """Compare two controllers, firmwares or vessels: run by run on the same seeds.

    Differences have intervals and a paired t test, pass rates an exact test. Both count the pairs of one seed as a
    cluster. P-values are adjusted for all figures and verdicts together.
    """
    CAMPAIGN.require("a comparison needs")
    if (b is None) == (by is None):
        raise UserError("compare: give either a second folder, or --by with an axis of the first")
    from xitl_cli.commands.output import sections_document, show_sections
    from xitl_cli.logs.report.html import refuse_other, write_sections
    from xitl_cli.plugins.campaign.compare import compare_by, compare_tables
    from xitl_cli.plugins.campaign.report import comparison_section
    from xitl_cli.plugins.campaign.results import ResultTable

    if report is not None:
        refuse_other(report)
    table = ResultTable.read(a)
    if b is not None:
        comparisons = [compare_tables(table, ResultTable.read(b), confidence)]
    else:
        assert by is not None
        comparisons = compare_by(table, by, confidence)
    sections = [comparison_section(comparison, number) for number, comparison in enumerate(comparisons, 1)]
    if report is not None:
        write_sections(report, "Comparison", "; ".join(section.title for section in sections), sections)
    with quiet_pipe():
        if as_json:
            print(json.dumps(sections_document(sections), indent=2, allow_nan=False))
            return
        console = terminal()
        show_sections(console, sections)
        if report is not None:
            say(console, f"Plots: {report}")
