"""Coverage-guided fuzzing of the parsers with atheris: `python -m tests.fuzz [TARGET…] [-runs=N]`, or `make fuzz`.

Each target runs in its own process, forked after the imports. An input that raises is kept in fuzz-findings/, and the
command exits with 1.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import NoReturn

FINDINGS = Path("fuzz-findings")
RUNS = 100_000
LONGEST_BYTES = 20_000


def main() -> int:
    options = [word for word in sys.argv[1:] if word.startswith("-")]
    names = [word for word in sys.argv[1:] if not word.startswith("-")]
    import atheris

    with atheris.instrument_imports(include=["agent", "sim_core", "xitl_cli"]):
        from tests.fuzz.targets import TARGETS

    unknown = [name for name in names if name not in TARGETS]
    if unknown:
        print(f"{', '.join(unknown)}: no such target; use {', '.join(TARGETS)}")
        return 2
    FINDINGS.mkdir(exist_ok=True)
    failed = []
    for name in names or TARGETS:
        print(f"== {name}", flush=True)
        process = os.fork()
        if process == 0:
            _fuzz(name, options)
        if os.waitpid(process, 0)[1]:
            failed.append(name)
    if failed:
        print(f"{', '.join(failed)}: failed; the inputs are in {FINDINGS}/")
    return 1 if failed else 0


def _fuzz(name: str, options: list[str]) -> NoReturn:
    import atheris

    from tests.fuzz.targets import CORPUS, TARGETS

    given = {option.partition("=")[0] for option in options}
    usual = [f"-runs={RUNS}", f"-max_len={LONGEST_BYTES}", "-timeout=20", "-rss_limit_mb=3000", "-print_final_stats=1"]
    usual += [f"-artifact_prefix={FINDINGS}/{name}-"]
    folder = FINDINGS / f"corpus-{name}"
    folder.mkdir(parents=True, exist_ok=True)
    words = [option for option in usual if option.partition("=")[0] not in given]
    atheris.Setup([name, *words, *options, str(folder), str(CORPUS / name)], TARGETS[name].parse)
    atheris.Fuzz()  # ends the process
    raise AssertionError


if __name__ == "__main__":
    sys.exit(main())
