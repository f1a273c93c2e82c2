"""Mutation test of changed code: change one operator at a time, and list the changes that no test notices.

    make mutate                    the lines that the last commit changed
    make mutate BASE=HEAD~3        the lines that differ from that commit
    make mutate FILES="a.py b.py"  whole files
    make mutate COUNT=60 SEED=1    so many changes at random places of all packages; the seed repeats them

Cosmic Ray makes the mutants, in a clone under build/, so that the checkout stays as it is. Each file is tested with
the fast unit tests that import it, then with those of its package. Random places are only in files
that a unit test imports, and only these tests run. Exit status 1 means that a mutant survived.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from cosmic_ray.work_item import MutationSpec, WorkItem

ROOT = Path(__file__).parents[1]
CLONE = ROOT / "build" / "mutants"
PRODUCT = ("agent", "sim_core", "xitl_cli")
GENERATED = "agent/wire/dialect.py"
SLOWEST_TEST_S = 300.0  # a mutant may loop without end
_SLOW = re.compile(r"^pytestmark = .*\b(slow|realtime)\b", re.MULTILINE)
PLACES_A_FILE = 3
"""Random places in a file. Its tests also run once without a change."""
CONFIGURATION = """\
[cosmic-ray]
module-path = "{file}"
timeout = {timeout_s}
excluded-modules = []
test-command = "{python} -m pytest -q -x -p no:cacheprovider -m 'not slow and not realtime' {tests}"

[cosmic-ray.distributor]
name = "local"

[cosmic-ray.filters.git-filter]
branch = "{base}"
"""


class Survival(NamedTuple):
    """Numbers of mutants."""

    tested: int
    survived: int


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--base", default="HEAD~1", help="mutate only lines that differ from this commit")
    parser.add_argument("--count", type=int, default=0, help="mutate so many random places of all packages")
    parser.add_argument("--seed", type=int, default=1, help="seed of the random places")
    parser.add_argument("files", nargs="*", help="mutate all lines of these files")
    options = parser.parse_args()
    draw = random.Random(options.seed)
    if options.count:
        files = random_files(-(-options.count // PLACES_A_FILE), draw)
    else:
        files = options.files or changed_files(options.base)
    if not files:
        print(f"no product file differs from {options.base}")
        return 0
    clone_head()
    base = None if options.files or options.count else options.base
    results = [mutate(file, base, draw if options.count else None) for file in files]
    tested, survived = (sum(numbers) for numbers in zip(*results, strict=True))
    print(f"{survived} of {tested} mutants survived, {1.0 - survived / max(tested, 1):.1%} were killed")
    return 1 if survived else 0


def random_files(count: int, draw: random.Random) -> list[str]:
    """Draw product files that a unit test imports, without repetition, each with a probability by its lines."""
    named = git(ROOT, "ls-files", "--", *(f"{package}/*.py" for package in PRODUCT)).split()
    lines = {name: (ROOT / name).read_bytes().count(b"\n") for name in named if name != GENERATED}
    # Efraimidis and Spirakis 2006: the largest of these keys are such a sample.
    keys = {name: draw.random() ** (1.0 / size) for name, size in lines.items() if size}
    drawn = (name for name in sorted(keys, key=keys.__getitem__, reverse=True) if importing_tests(name))
    return list(islice(drawn, count))


def changed_files(base: str) -> list[str]:
    """Product files that differ between `base` and the last commit."""
    named = git(ROOT, "diff", "--name-only", "--diff-filter=AM", base, "HEAD", "--", *PRODUCT).split()
    return [name for name in named if name.endswith(".py") and name != GENERATED]


def clone_head() -> None:
    """The last commit in a clone: Cosmic Ray edits files in place."""
    shutil.rmtree(CLONE, ignore_errors=True)
    CLONE.parent.mkdir(exist_ok=True)
    git(ROOT, "clone", "--quiet", "--shared", "--no-tags", str(ROOT), str(CLONE))
    git(CLONE, "checkout", "--quiet", "--detach", git(ROOT, "rev-parse", "HEAD").strip())


def mutate(file: str, base: str | None, draw: random.Random | None) -> Survival:
    """Test mutants of a file and print those that survived. base: only of lines that differ from this commit. draw:
    only of PLACES_A_FILE random places.
    """
    tests = importing_tests(file) if draw is not None else tests_of(file)
    if not tests:
        print(f"{file}: has no unit test")
        return Survival(1, 1)
    configuration, session = CLONE / "mutate.toml", CLONE / "mutate.sqlite"
    session.unlink(missing_ok=True)
    revision = git(ROOT, "rev-parse", base).strip() if base else ""
    configuration.write_text(
        CONFIGURATION.format(
            file=file, timeout_s=SLOWEST_TEST_S, python=sys.executable, tests=" ".join(tests), base=revision
        )
    )
    cosmic_ray("cosmic-ray", "init", str(configuration), str(session))
    if base:
        cosmic_ray("cr-filter-git", "--config", str(configuration), str(session))
    tested = skip_mutants(session, draw)
    if not tested:
        return Survival(0, 0)
    cosmic_ray("cosmic-ray", "baseline", str(configuration))
    cosmic_ray("cosmic-ray", "exec", str(configuration), str(session))
    report = cosmic_ray("cr-report", "--surviving-only", "--show-diff", str(session))
    survived = len(re.findall(r"TestOutcome\.SURVIVED|test outcome: survived", report, re.IGNORECASE))
    print(f"{file}: tested with {', '.join(tests)}: {survived} of {tested} survived", flush=True)
    if survived:
        print(report, flush=True)
    return Survival(tested, survived)


def skip_mutants(session: Path, draw: random.Random | None) -> int:
    """Skip the mutants of `X | Y` in annotations, which nothing evaluates. Return the number of the others.

    draw: keep one mutant at each of PLACES_A_FILE random places.
    """
    from cosmic_ray.work_db import WorkDB, use_db
    from cosmic_ray.work_item import WorkerOutcome, WorkResult

    with use_db(session, WorkDB.Mode.open) as database:
        pending = list(database.pending_work_items)
        kept = [item for item in pending if not _is_in_union(item.mutations[0])]
        if draw is not None:
            kept = random_mutants(kept, draw)
        names = {item.job_id for item in kept}
        skipped = [item.job_id for item in pending if item.job_id not in names]
        database.set_multiple_results(skipped, WorkResult(worker_outcome=WorkerOutcome.SKIPPED))
    return len(kept)


def random_mutants(items: list[WorkItem], draw: random.Random) -> list[WorkItem]:
    """Draw one mutant at each of PLACES_A_FILE places."""
    places: dict[tuple[tuple[int, int], tuple[int, int]], list[WorkItem]] = {}
    for item in sorted(items, key=lambda item: (item.mutations[0].operator_name, item.mutations[0].occurrence)):
        places.setdefault((item.mutations[0].start_pos, item.mutations[0].end_pos), []).append(item)
    chosen = draw.sample(sorted(places), min(PLACES_A_FILE, len(places)))
    return [draw.choice(places[place]) for place in chosen]


def _is_in_union(mutation: MutationSpec) -> bool:
    return "BinaryOperator_BitOr" in mutation.operator_name and any(
        begin <= tuple(mutation.start_pos) < end for begin, end in _annotations(CLONE / mutation.module_path)
    )


def _annotations(file: Path) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """Yield begin and end of each annotation: line, column."""
    for node in ast.walk(ast.parse(file.read_bytes())):
        for name in ("annotation", "returns"):
            part = getattr(node, name, None)
            if isinstance(part, ast.expr):
                assert part.end_lineno is not None
                assert part.end_col_offset is not None
                yield (part.lineno, part.col_offset), (part.end_lineno, part.end_col_offset)


def tests_of(file: str) -> list[str]:
    """Fast unit tests of a module: the files that name it first, then the folder of its package."""
    unit = ROOT / "tests" / "unit"
    within = Path(file.removeprefix("xitl_cli/")).parents
    folder = next((unit / parent for parent in within if parent != Path() and (unit / parent).is_dir()), None)
    return [*importing_tests(file), *([str(folder.relative_to(ROOT))] if folder else [])]


def importing_tests(file: str) -> list[str]:
    """Files of fast unit tests that name a module."""
    module = file.removesuffix(".py").replace("/", ".").removesuffix(".__init__")
    package, _, name = module.rpartition(".")
    named = re.compile(rf"\b{re.escape(module)}\b|from {re.escape(package)} import [^\n]*\b{re.escape(name)}\b")
    texts = {test: test.read_text(encoding="utf-8") for test in sorted((ROOT / "tests" / "unit").rglob("test_*.py"))}
    return [
        str(test.relative_to(ROOT)) for test, text in texts.items() if named.search(text) and not _SLOW.search(text)
    ]


def cosmic_ray(program: str, *arguments: str) -> str:
    """What a program of Cosmic Ray prints. The clone's modules come before the installed ones."""
    environment = {**os.environ, "PYTHONPATH": str(CLONE), "PYTHONDONTWRITEBYTECODE": "1"}
    path = Path(sys.executable).parent / program
    done = subprocess.run([path, *arguments], cwd=CLONE, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        sys.exit(f"{program} {' '.join(arguments)} failed:\n{done.stdout}{done.stderr}")
    return done.stdout


def git(where: Path, *arguments: str) -> str:
    return subprocess.run(["git", *arguments], cwd=where, check=True, capture_output=True, text=True).stdout


if __name__ == "__main__":
    sys.exit(main())
