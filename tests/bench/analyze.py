"""How often `xitl logs analyze` names the right cause: `make bench-analyze`.

    python -m tests.bench.analyze --seeds 101-103            # adds lines to build/bench/analyze.jsonl
    python -m tests.bench.analyze --seeds 1 --only compass --runs build/analyze
    python -m tests.bench.analyze --keep build/bench/analyze.jsonl   # keeps them, and writes the tables of docs/logs.md

Each run of analyze_cases.yaml is simulated and analysed. The analysis of injected faults is omitted, because a log of a
real vessel does not name its cause. A run in the folder of `--runs` is not simulated again. A measurement that was
stopped continues with the cases that the file lacks.
"""

from __future__ import annotations

import argparse
import json
import math
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import yaml
from numpy.random import default_rng

from tests.bench.analyze_cases import ARDUPILOT, Case, ardupilot_cases, cases, group_of_findings
from tests.bench.analyze_scores import Named, Outcome, confusion_table, score_table
from tests.bench.results import FULL, ROOT, TINY, BenchRun, this_run
from xitl_cli.log_analyses import log_analyses
from xitl_cli.logs.clocks.time_line import TimeLine
from xitl_cli.logs.model.sections import Finding, Severity
from xitl_cli.logs.report.build import build_report
from xitl_cli.logs.report.causes import FindingGroup, group_findings, is_contradicted, is_kind
from xitl_cli.logs.report.model import Report

FORMAT = 3
KEPT = Path(__file__).with_name("analyze_measured.jsonl")
KEPT_ARDUPILOT = KEPT.with_name("analyze_measured_ardupilot.jsonl")
"""Results with the stock ArduPilot, so that each autopilot is measured at its own commit."""
PAGE = ROOT / "docs" / "logs.md"
BEGIN, END = "<!-- analyze -->", "<!-- end of analyze -->"
NOT_MEASURED = "No complete measurement is kept yet."
EARLY_S = 3.0
"""Time by which a finding may begin before the cause that it names: most signals are averaged."""
EXCLUSIVE = (("attitude.overturned", "attitude.doubtful"), ("attitude.contact", "attitude.upright"))
"""Findings of which at most one is right in these runs."""
RUNS_OF_A_WORKER = 16
_STOPPED = ("interrupted", "failed")
BOTH, OWN_LOG = "recording and log", "log"
"""Files of a run: the recording with the autopilot's log, and the log alone, which is all that a real vessel has."""


@dataclass(frozen=True)
class AnalyzeResults:
    """Outcomes by the files that were analysed, and the run of the bench."""

    run: BenchRun
    outcomes: Mapping[str, Sequence[Outcome]]

    @property
    def seeds(self) -> list[int]:
        return sorted({outcome.seed for outcome in self.outcomes[BOTH]})

    @property
    def of_ardupilot(self) -> bool:
        return any(outcome.case.startswith(ARDUPILOT) for outcome in self.outcomes[BOTH])


class ResultsFile:
    """JSON lines: the run of the bench, then a line for each case, all of one autopilot."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def begin(self, run: BenchRun) -> None:
        """Write the first line, unless the file continues. Raises ValueError if the file is of another commit.

        A file of a changed tree does not continue, because its analysis is unknown.
        """
        stored = self.read().run if self.path.exists() else None
        if stored is None or stored.changed:
            self.path.parent.mkdir(parents=True, exist_ok=True)
            self.path.write_text(json.dumps({"format": FORMAT, "run": asdict(run)}) + "\n", encoding="utf-8")
        elif (stored.commit, stored.changed, stored.sizes) != (run.commit, run.changed, run.sizes):
            raise ValueError(
                f"was measured at commit {stored.commit[:8]} with {stored.sizes} sizes, and the tree is another; "
                "give another --out, or delete the file"
            )

    def add(self, outcomes: Mapping[str, Outcome]) -> None:
        row = {files: asdict(outcome) for files, outcome in outcomes.items()}
        with self.path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")

    def read(self) -> AnalyzeResults:
        """Return the results in order of the cases. Raises ValueError for another format."""
        first, *lines = self.path.read_text(encoding="utf-8").splitlines()
        head = json.loads(first)
        if head.get("format") != FORMAT:
            raise ValueError(f"has format {head.get('format')} instead of {FORMAT}; measure again")
        rows = [json.loads(line) for line in lines]
        outcomes = {files: [_outcome(row[files]) for row in rows] for files in (BOTH, OWN_LOG)}
        for of in outcomes.values():
            every = [
                (seed, case.name)
                for seed in sorted({each.seed for each in of})
                for case in (*cases(seed), *ardupilot_cases(seed))
            ]
            of.sort(key=lambda each: every.index((each.seed, each.case)))
        return AnalyzeResults(BenchRun(**head["run"]), outcomes)


def _outcome(row: dict[str, Any]) -> Outcome:
    named = tuple(Named(**each) for each in row["named"])
    return Outcome(**{**row, "named": named, "contradictions": tuple(row["contradictions"])})


def carry_out(case: Case, folder: Path) -> dict[str, Outcome]:
    """Simulate a case, unless its run is in the folder, and judge the analysis by the files that it reads."""
    import xitl

    run = folder / case.run_name
    profile = folder / f"{case.run_name}.yaml"
    known = _finished(run) and profile.exists()
    if not known or yaml.safe_load(profile.read_text(encoding="utf-8")) != case.document:
        profile.write_text(yaml.safe_dump(dict(case.document), sort_keys=False), encoding="utf-8")
        xitl.simulate(profile, out=run, overwrite=True)
    blind = [analysis for analysis in log_analyses() if analysis.name != "faults"]
    both, own = (build_report([path], blind, overview=False) for path in (run, run / "autopilot.bin"))
    return {BOTH: judge(case, both, case.causes), OWN_LOG: judge(case, own, case.causes_in_log)}


def _finished(run: Path) -> bool:
    """Whether the run reached its end: a stopped measurement leaves an interrupted one."""
    summary = run / "summary.json"
    return summary.exists() and json.loads(summary.read_text(encoding="utf-8"))["ended"] not in _STOPPED


def judge(case: Case, report: Report, causes: Sequence[str]) -> Outcome:
    """Outcome of an analysed run. Raises RuntimeError if a log could not be read, or an analysis failed."""
    for problem in (*report.refusals, *report.failures):
        raise RuntimeError(f"{case.run_name}: {problem.sentence}")
    groups = [(group.worst, _named(case, group, causes)) for group in group_findings(report)]
    named = [
        each
        for worst, each in groups
        if worst >= Severity.WARNING or (case.notice and each.right and worst >= Severity.NOTICE)
    ]
    keys = {placed.finding.key for placed in report.findings}
    contradictions = {placed.finding.key for placed in report.findings if is_contradicted(placed.finding, causes)}
    contradictions -= set(case.fine)
    contradictions |= {" and ".join(pair) for pair in EXCLUSIVE if keys.issuperset(pair)}
    return Outcome(
        case.name, case.group, case.seed, case.onset_s, tuple(named), bool(causes), tuple(sorted(contradictions))
    )


def _named(case: Case, group: FindingGroup, causes: Sequence[str]) -> Named:
    finding = group.cause.finding
    at_s = _first_s(finding, group.cause.file.time_line)
    early = at_s is not None and case.onset_s is not None and at_s < case.onset_s - EARLY_S
    right = is_kind(finding.key, causes) and not early
    return Named(finding.key, at_s, right, not right and not early and is_kind(finding.key, case.effects))


def _first_s(finding: Finding, line: TimeLine) -> float | None:
    return min((round(line.second(each.at_ns), 3) for each in finding.evidence if each.at_ns is not None), default=None)


def measure(chosen: Sequence[Case], file: ResultsFile, folder: Path, workers: int, minutes: float | None) -> None:
    """Add the outcomes of the cases to the file.

    minutes: time after which no further case begins; None: all are measured. The order of the measurements is random,
    so that the cases of a limited time are a fair sample. A case that fails ends the bench.
    """
    until_s = math.inf if minutes is None else time.monotonic() + 60.0 * minutes
    order = default_rng(len(chosen)).permutation(len(chosen)).tolist()
    tasks = [(chosen[number], folder, until_s) for number in order]
    done = 0
    with get_context("forkserver").Pool(workers, maxtasksperchild=RUNS_OF_A_WORKER) as pool:
        for case, outcomes in pool.imap_unordered(_carried_out, tasks):
            if outcomes is not None:
                file.add(outcomes)
                done += 1
                line = f"{done} of {len(chosen)}: {case.run_name}: {_line(outcomes[BOTH])}"
                print(line, file=sys.stderr, flush=True)


def _carried_out(task: tuple[Case, Path, float]) -> tuple[Case, dict[str, Outcome] | None]:
    """A case with its outcomes; None after its time, on the clock that all processes share."""
    case, folder, until_s = task
    return case, carry_out(case, folder) if time.monotonic() < until_s else None


def _line(of: Outcome) -> str:
    named = ", ".join(f"{'' if cause.right else 'not '}{cause.key} at {cause.at_s}" for cause in of.named)
    onset = "" if of.onset_s is None else f" (onset {of.onset_s})"
    return (named or "nothing") + onset + "".join(f"; says {key}" for key in of.contradictions)


def tables(results: AnalyzeResults) -> str:
    """The tables of one autopilot."""
    both, own = results.outcomes[BOTH], results.outcomes[OWN_LOG]
    seeds = ", ".join(str(seed) for seed in results.seeds)
    option, autopilot, cases_of = (
        (" ARDUPILOT=1", " with a stock ArduPilot", ardupilot_cases) if results.of_ardupilot else ("", "", cases)
    )
    every = sum(len(list(cases_of(seed))) for seed in results.seeds)
    return "\n\n".join(
        (
            f"`make bench-analyze{option}` measured {len(both)} of the {every} cases{autopilot} of the seeds "
            f"{seeds} at commit {results.run.commit[:8]}, from the recording and the autopilot's log:",
            score_table(both),
            "From the autopilot's log alone:",
            score_table(own),
            "Runs by their cause (rows) and by the first cause that `analyze` named from both files (columns):",
            confusion_table(both, group_of_findings()),
        )
    )


def kept_tables() -> str:
    """The text between the marks of docs/logs.md: tables of the kept results, or that there are none."""
    kept = [tables(ResultsFile(path).read()) for path in (KEPT, KEPT_ARDUPILOT) if path.exists()]
    return "\n\n".join(kept) or NOT_MEASURED


def with_tables(page: str, text: str) -> str:
    """The page with this text between its marks. Raises ValueError for a page without marks."""
    pattern = re.compile(rf"({re.escape(BEGIN)}\n\n).*?(\n\n{re.escape(END)})", re.DOTALL)
    if not pattern.search(page):
        raise ValueError(f"has no place for the tables; put the lines {BEGIN} and {END} where they belong")
    return pattern.sub(lambda match: f"{match[1]}{text}{match[2]}", page)


def keep(file: ResultsFile) -> None:
    """Keep results, and write the tables. Raises ValueError for results of no commit or of some cases."""
    results = file.read()
    run = results.run
    if run.sizes != FULL or not run.commit or run.changed:
        raise ValueError(f"were measured with {run.sizes} sizes{' with changes' if run.changed else ''}; commit first")
    shutil.copyfile(file.path, KEPT_ARDUPILOT if results.of_ardupilot else KEPT)
    PAGE.write_text(with_tables(PAGE.read_text(encoding="utf-8"), kept_tables()), encoding="utf-8")


def seed_numbers(text: str) -> list[int]:
    first, _, last = text.partition("-")
    return list(range(int(first), int(last or first) + 1))


def main(arguments: Iterable[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.bench.analyze", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=seed_numbers, default=[1], metavar="FIRST-LAST")
    parser.add_argument("--only", action="append", default=[], metavar="WORD", help="cases with WORD in name or group")
    parser.add_argument("--runs", type=Path, metavar="FOLDER", help="keep the runs here (default: a temporary folder)")
    parser.add_argument("--ardupilot", action="store_true", help="the cases with the ArduPilot of XITL_ARDUROVER")
    parser.add_argument("--lockstep", action="store_true", help="omit cases in real time, which need an idle machine")
    parser.add_argument("--workers", type=int, default=2, metavar="N")
    parser.add_argument("--minutes", type=float, metavar="N", help="begin no case later: a random part of the cases")
    parser.add_argument(
        "--out", type=Path, metavar="FILE", help="default: build/bench/analyze.jsonl, or analyze_ardupilot.jsonl"
    )
    parser.add_argument("--keep", type=Path, metavar="FILE", help="keep these results, and write the tables of docs/")
    given = parser.parse_args(None if arguments is None else list(arguments))
    name = "analyze_ardupilot.jsonl" if given.ardupilot else "analyze.jsonl"
    file = ResultsFile(given.keep or given.out or ROOT / "build" / "bench" / name)
    try:
        if given.keep is not None:
            keep(file)
            return 0
        file.begin(this_run(TINY if given.only else FULL))
    except ValueError as error:
        sys.exit(f"{file.path}: {error}")
    known = {(outcome.case, outcome.seed) for outcome in file.read().outcomes[BOTH]}
    chosen = [
        case
        for seed in given.seeds
        for case in (ardupilot_cases(seed) if given.ardupilot else cases(seed))
        if not given.only or any(word in f"{case.group} {case.name}" for word in given.only)
        if not (given.lockstep and case.real_time)
    ]
    if not chosen:
        sys.exit(f"no case is named like {', '.join(given.only)}; see analyze_cases.yaml")
    with tempfile.TemporaryDirectory() as temporary:
        folder = given.runs or Path(temporary)
        folder.mkdir(parents=True, exist_ok=True)
        missing = [case for case in chosen if (case.name, case.seed) not in known]
        measure(missing, file, folder, given.workers, given.minutes)
    print(tables(file.read()))
    print(f"results: {file.path}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
