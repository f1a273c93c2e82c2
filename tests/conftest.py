"""What holds for all tests: they may not depend on how fast the machine is, and what else it does.

Of those that take long the longest begin first, so that no processor is idle in the end; and only what has to be in one
process is: the tests of a file that share a fixture (`make test` runs them with `--dist loadscope`).
"""

from __future__ import annotations

import gc
import os
import re
import shutil
import signal
import tempfile
from collections.abc import Generator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

from tests import golden, permitted_skips, processor_time
from tests.recorded_run import FOLDER

settings.register_profile("any machine", deadline=None)
settings.load_profile("any machine")

LONGEST_FIRST = (
    "test_campaigns.py",
    "test_documentation.py",
    "test_view_recording.py",
    "test_fleet_stations.py",
    "test_fleet_traffic.py",
    "test_fleet_run.py",
    "test_estimate_runs.py",
    "test_network.py",
    "test_view_controls.py",
    "test_live_view_runs.py",
    "test_mavsdk.py",
    "test_ground_station.py",
    "test_validation.py",
    "test_public_api.py",
    "test_own_boat.py",
    "test_live_foxglove.py",
    "test_perception.py",
    "test_sim.py",
    "test_vehicles.py",
    "test_shipped_encounters.py",
    "test_fleet_avoidance.py",
    "test_steered_vessels.py",
    "test_arm.py",
    "test_replay.py",
    "test_mean_drift.py",
    "test_compare_real_logs.py",
    "test_fleet_mix.py",
)
RANKS = {name: rank for rank, name in enumerate(LONGEST_FIRST)}
KINDS = (*processor_time.LATER, "nightly")
ALL_ARE = r"(?m)^pytestmark = (?:\[[^]]*)?pytest\.mark\.%s\b"
TESTS = re.compile(r"(?m)((?:^@.*\n(?:^[ \])}].*\n)*)*)^(?:(?:async )?def test_|class Test|Test\w+ = )")
"""Each test of a file. The group has its decorators."""
FOR_ALL_TESTS_OF_A_FILE = 'scope="module"'


def pytest_addoption(parser: pytest.Parser) -> None:
    golden.add_option(parser)
    processor_time.add_option(parser)


def pytest_configure(config: pytest.Config) -> None:
    permitted_skips.register(config)
    processor_time.register(config)
    golden.register(config, Path(__file__).parent)
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        # A shell's background job has it ignored, and so has whatever it starts.
        signal.signal(signal.SIGINT, signal.default_int_handler)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # as `xitl` does, for those that are forked with numpy loaded
    if FOLDER not in os.environ:  # of processes side by side the first
        os.environ[FOLDER] = tempfile.mkdtemp(prefix="xitl-runs-")
        config.add_cleanup(lambda: shutil.rmtree(os.environ.pop(FOLDER)))


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Files without a test that `-m` leaves: each process imports all others, which takes as long as many tests."""
    words = config.option.markexpr.split()
    if "or" in words or not re.fullmatch(r"test_\w+\.py", collection_path.name):
        return None
    for kind in KINDS:
        if words[:1] == [kind] and not has_mark(collection_path, kind):
            return True
    left_out = [kind for kind in KINDS if re.search(rf"\bnot {kind}\b", config.option.markexpr)]
    return True if left_out and all_are(collection_path, left_out) else None


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """All that is collected stays: to go through it for garbage, again and again, takes a sixth of the time."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    for item in items:
        for kind in KINDS:
            if item.get_closest_marker(kind) and not has_mark(item.path, kind):
                raise pytest.UsageError(f"{item.nodeid}: is {kind}; mark it in its file, `-m {kind}` reads no others")
    if hasattr(config, "workerinput"):
        items.sort(key=lambda item: RANKS.get(item.path.name, len(RANKS)))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    if config.getoption("dist") != "loadscope":
        return None
    from xdist.scheduler import LoadScopeScheduling

    class FixtureScheduling(LoadScopeScheduling):  # type: ignore[misc]
        def _split_scope(self, nodeid: str) -> str:
            file = nodeid.partition("::")[0]
            return file if FOR_ALL_TESTS_OF_A_FILE in text(config.rootpath / file) else nodeid

    return FixtureScheduling(config, log)


def has_mark(file: Path, kind: str) -> bool:
    return f"mark.{kind}" in text(file)


def all_are(file: Path, kinds: list[str]) -> bool:
    """Whether each test of a file has the mark of one of these kinds."""
    if any(re.search(ALL_ARE % kind, text(file)) for kind in kinds):
        return True
    tests = TESTS.findall(text(file))
    marked = [
        decorators for decorators in tests if re.search(rf"(?m)^@pytest\.mark\.(?:{'|'.join(kinds)})$", decorators)
    ]
    return 0 < len(tests) == len(marked)


@cache
def text(file: Path) -> str:
    return file.read_text(encoding="utf-8")
