"""Mutation test: change one operator, number or branch at a time, and list the changes that no test notices.

    make mutate                    the lines that the last commit changed
    make mutate BASE=HEAD~3        the lines that differ from that commit
    make mutate FILES="a.py b.py"  whole files
    make mutate COUNT=60 SEED=1    so many changes at random places of all packages, or of FILES; the seed repeats them

Cosmic Ray makes the mutants, in a clone under build/, so that the checkout stays as it is. Coverage.py measures first
which tests execute which line: all fast and medium tests for random places, else the unit tests that import the files
or are of their packages. build/ keeps the measurement of all tests. For later commits, only the tests of what they
changed are measured. Each mutant is tested with the tests that execute its statement, then with the others of the same
files, then by the type checker, as `make types` does. Tests that a mutant keeps beyond a limit are ended, which counts
as killed; those mutants are printed too, because they need a look: did the mutation loop? Exit status 1 means that a
mutant survived.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import re
import resource
import signal
import subprocess
import sys
from collections import Counter, defaultdict
from collections.abc import Collection, Iterator
from difflib import SequenceMatcher, unified_diff
from functools import cache
from importlib.util import cache_from_source
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np  # noqa: F401 - a fork has it; packages of plug-ins of pytest must not be imported before it
import pytest

if TYPE_CHECKING:
    from cosmic_ray.work_item import MutationSpec, WorkItem

ROOT = Path(__file__).parents[1]
BUILD = ROOT / "build" / "mutants"
CLONE = BUILD / "clone"
PRODUCT = ("agent", "sim_core", "xitl_cli")
GENERATED = "agent/wire/dialect.py"
PYTEST = ("-p", "no:cacheprovider", "-m", "not slow and not realtime")
LONGEST_TESTS_S = 60.0
"""Time without the mutant of each part of its tests. The longest tests beyond are left out."""
MOST_PROCESSOR_S, MOST_S = (20.0, 2.0), (60.0, 4.0)
"""A mutant may loop or wait without end: seconds, and further ones for each second that its tests take without it."""
MOST_BYTES = 8 * 1024**3
"""A mutant that loops may fill the memory."""
PASSED = (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED)
PLACES_A_FILE = 3
"""Random places in a file. To list the mutants of a file takes as long as some tests."""
COVERAGE = """\
[run]
source = {source}
omit = {omit}
relative_files = true
"""
GIT_FILTER = """\
[cosmic-ray]
[cosmic-ray.filters.git-filter]
branch = "{base}"
"""
DATACLASS_FLAG = re.compile(r"@dataclass\([^)]*\b(?:frozen|slots)=$")
"""Up to a flag that changes nothing for correct code."""
LARGEST_NUMBER = 100
"""Cosmic Ray adds or subtracts 1. For larger numbers that is less than 1 %, which no sensible tolerance tells."""
DOTTED_EXCEPTION = re.compile(r"\s*except\b[^:#]*\w\.\w")
"""Cosmic Ray fails to replace such a name."""
BITS = re.compile(r"BinaryOperator_(?:Add|Sub|Mul|Div|FloorDiv|Mod|Pow)_(?:[LR]Shift|Bit\w+)$")
TIME = re.compile(r"(?m)^([\d.]+)s (?:call|setup|teardown) +(\S+?::\w+(?:::\w+)*)")
FAILED = re.compile(r"(?m)^(?:FAILED|ERROR) (\S+?::\w+(?:::\w+)*)")
Position = tuple[int, int]
"""Line and column."""


class Survival(NamedTuple):
    """Numbers of mutants."""

    tested: int
    survived: int
    unexecuted: int
    """Of those that survived: at statements that no test executes."""
    ended: int
    """Of the others: those whose tests were ended at a limit."""
    mistyped: int
    """Of the others: those that only the type checker refuses."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--base", default="HEAD~1", help="mutate only lines that differ from this commit")
    parser.add_argument(
        "--count", type=int, default=0, help="mutate so many random places of all packages or of the files"
    )
    parser.add_argument("--seed", type=int, default=1, help="seed of the random places")
    parser.add_argument("files", nargs="*", help="mutate these files")
    options = parser.parse_args()
    anywhere = options.count and not options.files
    files = options.files or (product_files() if anywhere else changed_files(options.base))
    if not files:
        print(f"no product file differs from {options.base}")
        return 0
    head = clone_head()
    os.chdir(CLONE)
    os.environ["PYTHONPATH"] = sys.path[0] = str(CLONE)  # the clone's modules, not the installed ones
    del sys.modules["tools"]
    if anywhere:
        suite = SuiteMap.of_whole_suite(head)
    else:
        part = BUILD / "part"
        part.with_suffix(".txt").unlink(missing_ok=True)
        suite = SuiteMap(Measurement(part, sorted({test for file in files for test in tests_of(file)})))
    if not types_are_right():
        sys.exit("the type checker finds errors without a mutant: make types")
    if options.count:
        results = mutate_anywhere(files, options.count, random.Random(options.seed), suite)
    else:
        base = None if options.files else options.base
        results = [mutate(file, mutants_of(file, base), suite) for file in files]
    tested, survived, unexecuted, ended, mistyped = (sum(numbers) for numbers in zip(*results, strict=True))
    print(
        f"{survived} of {tested} mutants survived, {unexecuted} of them where no test goes; "
        f"{1.0 - survived / max(tested, 1):.1%} were killed, {ended} of them at a limit, {mistyped} by their types"
    )
    return 1 if survived else 0


def mutate_anywhere(files: list[str], count: int, draw: random.Random, suite: SuiteMap) -> list[Survival]:
    """Test `count` mutants at random places. Files are drawn without repetition, with probabilities by their lines."""
    lines = {file: Path(file).read_bytes().count(b"\n") for file in files}
    # Efraimidis and Spirakis 2006: the order of these keys is that of such draws.
    keys = {file: draw.random() ** (1.0 / size) for file, size in lines.items() if size}
    results: list[Survival] = []
    for file in sorted(keys, key=keys.__getitem__, reverse=True):
        left = count - sum(result.tested for result in results)
        if left <= 0:
            break
        results.append(mutate(file, random_mutants(mutants_of(file, None), draw)[:left], suite))
    return results


def product_files() -> list[str]:
    named = git(ROOT, "ls-files", "--", *(f"{package}/*.py" for package in PRODUCT)).split()
    return [name for name in named if name != GENERATED]


def changed_files(base: str) -> list[str]:
    """Product files that differ between `base` and the last commit."""
    named = git(ROOT, "diff", "--name-only", "--diff-filter=AM", base, "HEAD", "--", *PRODUCT).split()
    return [name for name in named if name.endswith(".py") and name != GENERATED]


def clone_head() -> str:
    """Clone the last commit, because Cosmic Ray edits files in place, and return its hash.

    A clone of an earlier call stays with its compiled modules.
    """
    head = git(ROOT, "rev-parse", "HEAD").strip()
    if not CLONE.is_dir():
        BUILD.mkdir(parents=True, exist_ok=True)
        git(ROOT, "clone", "--quiet", "--shared", "--no-checkout", "--no-tags", str(ROOT), str(CLONE))
    git(CLONE, "checkout", "--quiet", "--force", "--detach", head)
    return head


class Measurement:
    """Which tests executed which lines of a commit, and how long each test took."""

    def __init__(self, kept: Path, tests: Collection[str] = (), commit: str = "HEAD") -> None:
        """Measure these tests once, or read what an earlier call kept. Tests that fail are printed and left out.

        kept: path of the files without suffix. tests: arguments of pytest; none means the whole suite.
        """
        from coverage import CoverageData

        self._commit = commit
        data, report = kept.with_suffix(".coverage"), kept.with_suffix(".txt")
        if not report.exists():
            configuration = BUILD / "coverage.ini"
            configuration.write_text(COVERAGE.format(source=",".join(PRODUCT), omit=GENERATED))
            measured = ["--cov", f"--cov-config={configuration}", "--cov-context=test", "--cov-report="]
            timed = ["--durations=0", "--durations-min=0", "-rfE"]
            data.unlink(missing_ok=True)
            reports = []
            for group in alike(tests) or [[]]:
                run = subprocess.run(
                    [sys.executable, "-m", "pytest", *PYTEST, *measured, "--cov-append", *timed, "-n", "auto", *group],
                    env={**os.environ, "COVERAGE_FILE": str(data)},
                    stdout=subprocess.PIPE,
                    text=True,
                    check=False,
                )
                if run.returncode not in (*PASSED, pytest.ExitCode.TESTS_FAILED):
                    sys.exit(f"the tests without a mutant ended with status {run.returncode}:\n{run.stdout}")
                reports.append(run.stdout)
            report.write_text("\n".join(reports))
        self._data = CoverageData(str(data))
        self._data.read()
        failed = set(FAILED.findall(report.read_text()))
        for test in sorted(failed):
            print(f"{test}: left out, because it fails without a mutant")
        self.times_s: dict[str, float] = defaultdict(float)
        for seconds, test in TIME.findall(report.read_text()):
            if test not in failed:
                self.times_s[test] += float(seconds)

    def tests_by_line(self, file: str) -> dict[int, set[str]]:
        """Return the tests that executed each line of a file that is still the same, by its number now."""
        contexts = self._data.contexts_by_lineno(file)
        return {
            now: {context.partition("|")[0].partition("[")[0] for context in contexts[before]}
            for before, now in unchanged_lines(self._commit, file)
            if before in contexts
        }


class SuiteMap:
    """Which tests execute which lines, and how long each test takes."""

    def __init__(self, *measured: Measurement) -> None:
        """measured: each replaces what those before it have of the same files of tests."""
        self._measured = measured
        self._times_s: dict[str, float] = defaultdict(float)
        for one in measured:
            again = {*map(file_of, one.times_s)}
            kept = {test: time_s for test, time_s in self._times_s.items() if file_of(test) not in again}
            there = {test: time_s for test, time_s in one.times_s.items() if file_of(test) in _test_files()}
            self._times_s = defaultdict(float, kept | there)
        shortest = min(self._times_s, key=self._times_s.__getitem__, default="")
        if not shortest or run_tests([shortest], self) != "passed":
            sys.exit("no test passes without a mutant")

    @classmethod
    def of_whole_suite(cls, head: str) -> SuiteMap:
        """Measure all tests, or only those that changed since an earlier commit of which all were measured."""
        kept = [path for path in BUILD.glob("*.txt") if is_ancestor(path.stem, head)]
        if not kept:
            return cls(Measurement(BUILD / head))
        newest = max(kept, key=lambda path: path.stat().st_mtime)
        before = Measurement(newest, commit=newest.stem)
        named = git(CLONE, "diff", "--name-only", "--diff-filter=d", newest.stem, head, "--", *PRODUCT, "tests").split()
        changed = {test for name in named for test in ([name] if name in _test_files() else importing_tests(name))}
        return cls(before, Measurement(BUILD / f"{head}-changed", sorted(changed))) if changed else cls(before)

    def tests_at(self, mutation: MutationSpec) -> list[str]:
        """Return the tests that execute a mutated statement, the shortest first.

        Statements outside of functions run at an import. Their tests are those that execute any line of the file, and
        those of the test files that import it.
        """
        file = str(mutation.module_path)
        executing: dict[int, set[str]] = defaultdict(set)
        for one in self._measured:
            for line, those in one.tests_by_line(file).items():
                executing[line] |= those
        first, in_function = statement_at(Path(file), mutation.start_pos[0])
        lines = range(first, mutation.end_pos[0] + 1) if in_function else executing
        tests = {test for line in lines for test in executing.get(line, ())}
        if not in_function:
            tests |= self._tests_in(importing_tests(file))
        return self._shortest_first(tests)

    def tests_near(self, file: str, tests: list[str]) -> list[str]:
        """Return the other tests of the files of these tests and of those that import `file`, the shortest first.

        They may notice a mutant too: coverage ascribes a fixture of a module or a cached value to its first user alone,
        and sees no other process.
        """
        files = {file_of(test) for test in tests}.union(importing_tests(file))
        return self._shortest_first(self._tests_in(files).difference(tests))

    def _tests_in(self, files: Collection[str]) -> set[str]:
        return {test for test in self._times_s if file_of(test) in files}

    def _shortest_first(self, tests: set[str]) -> list[str]:
        return sorted(tests & self._times_s.keys(), key=self._times_s.__getitem__)

    def time_s(self, tests: list[str]) -> float:
        return sum(self._times_s[test] for test in tests)

    def affordable(self, tests: list[str]) -> list[str]:
        """Return the first of these tests that together take up to LONGEST_TESTS_S."""
        total_s, chosen = 0.0, []
        for test in tests:
            total_s += self._times_s[test]
            if chosen and total_s > LONGEST_TESTS_S:
                break
            chosen.append(test)
        return chosen


def mutate(file: str, items: list[WorkItem], suite: SuiteMap) -> Survival:
    """Test mutants of a file and print those that survived."""
    from cosmic_ray.mutating import use_mutation
    from cosmic_ray.plugins import get_operator

    outcomes: Counter[str] = Counter()
    near = set(importing_tests(file))
    for item in items:
        mutation = item.mutations[0]
        executing = suite.tests_at(mutation)
        others = suite.tests_near(file, executing)
        parts = [
            suite.affordable([test for test in executing if file_of(test) in near]),
            suite.affordable([test for test in executing if file_of(test) not in near]),
            suite.affordable(others),
        ]
        operator = get_operator(mutation.operator_name)()
        with use_mutation(mutation.module_path, operator, mutation.occurrence) as (code, mutant):
            forget_bytecode(file)
            outcomes_of_parts = (run_tests(tests, suite) for tests in parts)
            outcome = next((one for one in outcomes_of_parts if one != "passed"), "passed")
            if outcome == "passed" and not types_are_right():
                outcome = "mistyped"
        forget_bytecode(file)
        outcomes[outcome] += 1
        outcomes["unexecuted"] += outcome == "passed" and not executing
        if outcome in ("passed", "ended"):
            tests = f"{sum(map(len, parts))} of {len(executing) + len(others)} tests"
            print(f"{file}:{mutation.start_pos[0]}: {tests} {outcome}, {len(executing)} of them execute it")
            print(*unified_diff(code.split("\n"), mutant.split("\n"), file, file, lineterm=""), sep="\n", flush=True)
    print(f"{file}: {outcomes['passed']} of {len(items)} survived", flush=True)
    return Survival(len(items), outcomes["passed"], outcomes["unexecuted"], outcomes["ended"], outcomes["mistyped"])


def types_are_right() -> bool:
    """Check the types of the clone, as `make types` does. What has not changed is in the checker's cache."""
    run = subprocess.run([sys.executable, "-m", "mypy"], stdout=subprocess.PIPE, text=True, check=False)
    if run.returncode not in (0, 1):
        sys.exit(f"the type checker ended with status {run.returncode}:\n{run.stdout}")
    return run.returncode == 0


def forget_bytecode(file: str) -> None:
    """Python takes a mutant for the one before, if it has the same size and was written in the same second."""
    Path(cache_from_source(file)).unlink(missing_ok=True)


def run_tests(tests: list[str], suite: SuiteMap) -> Literal["passed", "failed", "ended"]:
    """Run tests up to the first that fails, in a fork of this process, which has large libraries imported.

    They are ended after a multiple of the time that they take without a mutant.
    """
    if not tests:
        return "passed"
    most_processor_s, most_s = (
        int(least + factor * suite.time_s(tests)) for least, factor in (MOST_PROCESSOR_S, MOST_S)
    )
    child = os.fork()
    if not child:
        signal.alarm(most_s)
        resource.setrlimit(resource.RLIMIT_CPU, (most_processor_s, most_processor_s))
        resource.setrlimit(resource.RLIMIT_DATA, (MOST_BYTES, MOST_BYTES))
        quiet = os.open(os.devnull, os.O_RDWR)
        for stream in range(3):
            os.dup2(quiet, stream)
        codes = (int(pytest.main([*PYTEST, "-x", *group])) for group in alike(tests))
        os._exit(next((code for code in codes if code not in PASSED), 0))
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    if code in PASSED:
        return "passed"
    return "ended" if code in (-signal.SIGALRM, -signal.SIGKILL, -signal.SIGXCPU) else "failed"


def alike(tests: Collection[str]) -> list[list[str]]:
    """Return tests in groups that one call of pytest can run.

    Those of tests/e2e import names from their conftest, which that of tests/unit hides if both are given.
    """
    ends = [test for test in tests if test.startswith("tests/e2e/")]
    return [group for group in (ends, [test for test in tests if test not in ends]) if group]


def statement_at(file: Path, line: int) -> tuple[int, bool]:
    """Return the first line of the innermost statement at a line, and whether it is in the body of a function."""
    around = [
        node
        for node in ast.walk(parsed(file))
        if isinstance(node, ast.stmt) and node.lineno <= line <= (node.end_lineno or node.lineno)
    ]
    functions = (node for node in around if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef))
    in_function = any(function.body[0].lineno <= line for function in functions)
    return max((node.lineno for node in around), default=line), in_function


@cache
def parsed(file: Path) -> ast.Module:
    return ast.parse(file.read_bytes())


def mutants_of(file: str, base: str | None) -> list[WorkItem]:
    """Return the mutants of a file, or of its lines that differ from `base`.

    Left out are those of `X | Y` in annotations, because nothing evaluates them; bit operators in place of
    arithmetic, because floats refuse them, so that any test that executes the line would kill them; `frozen` and
    `slots` of dataclasses, because they change nothing for code that keeps to its types; and numbers beyond
    LARGEST_NUMBER.
    """
    from cosmic_ray.commands import init
    from cosmic_ray.work_db import use_db

    session = BUILD / "mutate.sqlite"
    session.unlink(missing_ok=True)
    with use_db(session) as database:
        init([Path(file)], database, {})
        if base:
            configuration = BUILD / "mutate.toml"
            configuration.write_text(GIT_FILTER.format(base=git(ROOT, "rev-parse", base).strip()))
            program = Path(sys.executable).parent / "cr-filter-git"
            subprocess.run([program, "--config", configuration, session], check=True)
        unions, lines = list(_annotations(Path(file))), Path(file).read_text(encoding="utf-8").split("\n")
        return [item for item in database.pending_work_items if _can_matter(item.mutations[0], unions, lines)]


def random_mutants(items: list[WorkItem], draw: random.Random) -> list[WorkItem]:
    """Draw one mutant at each of PLACES_A_FILE places."""
    places: dict[tuple[Position, Position], list[WorkItem]] = {}
    for item in sorted(items, key=lambda item: (item.mutations[0].operator_name, item.mutations[0].occurrence)):
        places.setdefault((item.mutations[0].start_pos, item.mutations[0].end_pos), []).append(item)
    chosen = draw.sample(sorted(places), min(PLACES_A_FILE, len(places)))
    return [draw.choice(places[place]) for place in chosen]


def _can_matter(mutation: MutationSpec, unions: list[tuple[Position, Position]], lines: list[str]) -> bool:
    """Whether a test could tell the mutation; see `mutants_of`."""
    (first, begin), (_, end) = mutation.start_pos, mutation.end_pos
    line = lines[first - 1]
    return not (
        _is_in(unions, mutation)
        or BITS.search(mutation.operator_name)
        or DOTTED_EXCEPTION.match(line)
        or DATACLASS_FLAG.search(line[:begin])
        or (
            mutation.operator_name.endswith("NumberReplacer")
            and abs(ast.literal_eval(line[begin:end])) > LARGEST_NUMBER
        )
    )


def _is_in(unions: list[tuple[Position, Position]], mutation: MutationSpec) -> bool:
    return "BinaryOperator_BitOr" in mutation.operator_name and any(
        begin <= tuple(mutation.start_pos) < end for begin, end in unions
    )


def _annotations(file: Path) -> Iterator[tuple[Position, Position]]:
    """Yield begin and end of each annotation: line, column."""
    for node in ast.walk(parsed(file)):
        for name in ("annotation", "returns"):
            part = getattr(node, name, None)
            if isinstance(part, ast.expr):
                assert part.end_lineno is not None
                assert part.end_col_offset is not None
                yield (part.lineno, part.col_offset), (part.end_lineno, part.end_col_offset)


def tests_of(file: str) -> list[str]:
    """Unit tests of a module: the files that import it, and the folder of its package."""
    unit = ROOT / "tests" / "unit"
    within = Path(file.removeprefix("xitl_cli/")).parents
    folder = next((unit / parent for parent in within if parent != Path() and (unit / parent).is_dir()), None)
    return [*importing_tests(file), *([str(folder.relative_to(ROOT))] if folder else [])]


@cache
def importing_tests(file: str) -> list[str]:
    """Return the files of tests that name a module."""
    module = file.removesuffix(".py").replace("/", ".").removesuffix(".__init__")
    package, _, name = module.rpartition(".")
    named = re.compile(rf"\b{re.escape(module)}\b|from {re.escape(package)} import [^\n]*\b{re.escape(name)}\b")
    return [test for test, text in _test_files().items() if named.search(text)]


@cache
def _test_files() -> dict[str, str]:
    """Return the texts of all tests by their paths."""
    tests = sorted((ROOT / "tests").rglob("test_*.py"))
    return {str(test.relative_to(ROOT)): test.read_text(encoding="utf-8") for test in tests}


def file_of(test: str) -> str:
    return test.partition("::")[0]


@cache
def unchanged_lines(commit: str, file: str) -> list[tuple[int, int]]:
    """Return the numbers of each line of a file that is as at a commit: at that time, and now."""
    now = git(CLONE, "show", f"HEAD:{file}")
    try:
        before = git(CLONE, "show", f"{commit}:{file}")
    except subprocess.CalledProcessError:  # a new file
        return []
    blocks = SequenceMatcher(None, before.split("\n"), now.split("\n"), autojunk=False).get_matching_blocks()
    return [(old + line, new + line) for old, new, size in blocks for line in range(1, size + 1)]


def is_ancestor(commit: str, head: str) -> bool:
    """Whether this is the name of a commit, and `head` is the same or a later one."""
    run = subprocess.run(
        ["git", "merge-base", "--is-ancestor", commit, head], cwd=CLONE, check=False, stderr=subprocess.DEVNULL
    )
    return run.returncode == 0


def git(where: Path, *arguments: str) -> str:
    return subprocess.run(["git", *arguments], cwd=where, check=True, capture_output=True, text=True).stdout


if __name__ == "__main__":
    sys.exit(main())
