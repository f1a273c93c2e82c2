"""Mutation test of changed code: change one operator at a time, and list the changes that no test notices.

    make mutate                    the lines that the last commit changed
    make mutate BASE=HEAD~3        the lines that differ from that commit
    make mutate FILES="a.py b.py"  whole files

Cosmic Ray makes the mutants, in a clone under build/, so that the checkout stays as it is. Each file is tested with
the fast unit tests that import it, then with those of its package. Exit status 1 means that a mutant survived.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
CLONE = ROOT / "build" / "mutants"
PRODUCT = ("agent", "sim_core", "xitl_cli")
GENERATED = "agent/wire/dialect.py"
SLOWEST_TEST_S = 300.0  # a mutant may loop without end
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


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--base", default="HEAD~1", help="mutate only lines that differ from this commit")
    parser.add_argument("files", nargs="*", help="mutate all lines of these files")
    options = parser.parse_args()
    files = options.files or changed_files(options.base)
    if not files:
        print(f"no product file differs from {options.base}")
        return 0
    clone_head()
    survivors = sum(mutate(file, None if options.files else options.base) for file in files)
    print(f"{survivors} mutants survived" if survivors else "no mutant survived")
    return 1 if survivors else 0


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


def mutate(file: str, base: str | None) -> int:
    """Test every mutant of a file and print those that survived; returns their number."""
    tests = tests_of(file)
    if not tests:
        print(f"{file}: has no unit test")
        return 1
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
    cosmic_ray("cosmic-ray", "baseline", str(configuration))
    cosmic_ray("cosmic-ray", "exec", str(configuration), str(session))
    report = cosmic_ray("cr-report", "--surviving-only", "--show-diff", str(session))
    survived = len(re.findall(r"TestOutcome\.SURVIVED|test outcome: survived", report, re.IGNORECASE))
    print(f"{file}: tested with {', '.join(tests)}")
    print(report)
    return survived


def tests_of(file: str) -> list[str]:
    """Fast unit tests of a module: the files that name it first, then the folder of its package."""
    module = file.removesuffix(".py").replace("/", ".").removesuffix(".__init__")
    package, _, name = module.rpartition(".")
    named = re.compile(rf"\b{re.escape(module)}\b|from {re.escape(package)} import [^\n]*\b{re.escape(name)}\b")
    unit = ROOT / "tests" / "unit"
    found = [test for test in sorted(unit.rglob("test_*.py")) if named.search(test.read_text(encoding="utf-8"))]
    within = Path(file.removeprefix("xitl_cli/")).parents
    folder = next((unit / parent for parent in within if parent != Path() and (unit / parent).is_dir()), None)
    return [str(path.relative_to(ROOT)) for path in [*found, *([folder] if folder else [])]]


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
