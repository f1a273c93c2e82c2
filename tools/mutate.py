"""Mutation test of changed code: change one operator at a time, and list the changes that no test notices.

    make mutate                    the lines that the last commit changed
    make mutate BASE=HEAD~3        the lines that differ from that commit
    make mutate FILES="a.py b.py"  whole files
    make mutate COUNT=60 SEED=1    so many changes at random places of all packages; the seed repeats them

Cosmic Ray makes the mutants, in a clone under build/, so that the checkout stays as it is. Each file is tested with
the fast unit tests that import it, then with those of its package. Random places are only in files that a unit test
imports, and only these tests run. Exit status 1 means that a mutant survived.
"""

from __future__ import annotations

import argparse
import ast
import os
import random
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from cosmic_ray.work_item import MutationSpec, WorkItem

ROOT = Path(__file__).parents[1]
CLONE = ROOT / "build" / "mutants"
PRODUCT = ("agent", "sim_core", "xitl_cli")
GENERATED = "agent/wire/dialect.py"
SLOWEST_TEST_S = 300.0  # a mutant may loop without end
PLACES_A_FILE = 3
"""Random places in a file. Its tests also run once without a change."""
LONGEST_TESTS_S = 8.0
"""Processor time of the tests of a file with random mutants."""
_SLOW = re.compile(r"^pytestmark = .*\b(slow|realtime)\b", re.MULTILINE)
GIT_FILTER = """\
[cosmic-ray]
[cosmic-ray.filters.git-filter]
branch = "{base}"
"""
NO_TESTS = 5
"""Exit status of pytest without a test."""
Position = tuple[int, int]
"""Line and column."""


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
    files = options.files or changed_files(options.base)
    if not files and not options.count:
        print(f"no product file differs from {options.base}")
        return 0
    clone_head()
    os.chdir(CLONE)
    os.environ.update(PYTHONPATH=str(CLONE), PYTHONDONTWRITEBYTECODE="1")  # the clone's modules, not the installed ones
    if options.count:
        results = mutate_anywhere(options.count, random.Random(options.seed))
    else:
        results = [mutate(file, None if options.files else options.base) for file in files]
    tested, survived = (sum(numbers) for numbers in zip(*results, strict=True))
    print(f"{survived} of {tested} mutants survived, {1.0 - survived / max(tested, 1):.1%} were killed")
    return 1 if survived else 0


def mutate_anywhere(count: int, draw: random.Random) -> list[Survival]:
    """Test `count` mutants at random places of files with fast tests."""
    results: list[Survival] = []
    for file in random_files(draw):
        results.append(mutate(file, None, draw))
        if sum(result.tested for result in results) >= count:
            break
    return results


def random_files(draw: random.Random) -> Iterator[str]:
    """Draw product files that a unit test imports, without repetition, each with a probability by its lines."""
    named = git(ROOT, "ls-files", "--", *(f"{package}/*.py" for package in PRODUCT)).split()
    lines = {name: (ROOT / name).read_bytes().count(b"\n") for name in named if name != GENERATED}
    # Efraimidis and Spirakis 2006: the order of these keys is that of such draws.
    keys = {name: draw.random() ** (1.0 / size) for name, size in lines.items() if size}
    return (name for name in sorted(keys, key=keys.__getitem__, reverse=True) if importing_tests(name))


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


def mutate(file: str, base: str | None, draw: random.Random | None = None) -> Survival:
    """Test mutants of a file and print those that survived. base: only of lines that differ from this commit. draw:
    only of PLACES_A_FILE random places, and none if the tests take longer than LONGEST_TESTS_S.
    """
    from cosmic_ray.mutating import mutate_and_test

    tests = importing_tests(file) if draw is not None else tests_of(file)
    if not tests:
        print(f"{file}: has no unit test")
        return Survival(1, 1)
    items = mutants_of(file, base)
    if draw is not None:
        items = random_mutants(items, draw)
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "-m", "not slow and not realtime"]
    command += tests
    before_s = os.times().children_user
    unchanged = subprocess.run(command, capture_output=True, text=True, check=False)
    took_s = os.times().children_user - before_s
    if not items or unchanged.returncode == NO_TESTS:
        print(f"{file}: has no mutant or no fast test")
        return Survival(0, 0)
    if draw is not None and took_s > LONGEST_TESTS_S:
        print(f"{file}: left out, because its tests take {took_s:.0f} s of processor time", flush=True)
        return Survival(0, 0)
    if unchanged.returncode:
        sys.exit(f"{file}: its tests fail without a mutant:\n{unchanged.stdout}{unchanged.stderr}")
    survived = 0
    for item in items:
        result = mutate_and_test(item.mutations, shlex.join(command), SLOWEST_TEST_S)
        if not result.is_killed:
            survived += 1
            print(result.diff, flush=True)
    print(f"{file}: {survived} of {len(items)} survived {', '.join(tests)}", flush=True)
    return Survival(len(items), survived)


def mutants_of(file: str, base: str | None) -> list[WorkItem]:
    """Return the mutants of a file, or of its lines that differ from `base`.

    Those of `X | Y` in annotations are left out, because nothing evaluates them.
    """
    from cosmic_ray.commands import init
    from cosmic_ray.work_db import use_db

    session = CLONE / "mutate.sqlite"
    session.unlink(missing_ok=True)
    with use_db(session) as database:
        init([Path(file)], database, {})
        if base:
            configuration = CLONE / "mutate.toml"
            configuration.write_text(GIT_FILTER.format(base=git(ROOT, "rev-parse", base).strip()))
            program = Path(sys.executable).parent / "cr-filter-git"
            subprocess.run([program, "--config", configuration, session], check=True)
        unions = list(_annotations(Path(file)))
        return [item for item in database.pending_work_items if not _is_in(unions, item.mutations[0])]


def random_mutants(items: list[WorkItem], draw: random.Random) -> list[WorkItem]:
    """Draw one mutant at each of PLACES_A_FILE places."""
    places: dict[tuple[Position, Position], list[WorkItem]] = {}
    for item in sorted(items, key=lambda item: (item.mutations[0].operator_name, item.mutations[0].occurrence)):
        places.setdefault((item.mutations[0].start_pos, item.mutations[0].end_pos), []).append(item)
    chosen = draw.sample(sorted(places), min(PLACES_A_FILE, len(places)))
    return [draw.choice(places[place]) for place in chosen]


def _is_in(unions: list[tuple[Position, Position]], mutation: MutationSpec) -> bool:
    return "BinaryOperator_BitOr" in mutation.operator_name and any(
        begin <= tuple(mutation.start_pos) < end for begin, end in unions
    )


def _annotations(file: Path) -> Iterator[tuple[Position, Position]]:
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
    """Return the files of fast unit tests that name a module."""
    module = file.removesuffix(".py").replace("/", ".").removesuffix(".__init__")
    package, _, name = module.rpartition(".")
    named = re.compile(rf"\b{re.escape(module)}\b|from {re.escape(package)} import [^\n]*\b{re.escape(name)}\b")
    return [test for test, text in _test_files().items() if named.search(text) and not _SLOW.search(text)]


@cache
def _test_files() -> dict[str, str]:
    """Return the texts of all unit tests by their paths."""
    tests = sorted((ROOT / "tests" / "unit").rglob("test_*.py"))
    return {str(test.relative_to(ROOT)): test.read_text(encoding="utf-8") for test in tests}


def git(where: Path, *arguments: str) -> str:
    return subprocess.run(["git", *arguments], cwd=where, check=True, capture_output=True, text=True).stdout


if __name__ == "__main__":
    sys.exit(main())
