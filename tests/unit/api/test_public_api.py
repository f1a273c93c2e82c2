"""`import xitl`: what a script or a notebook uses."""

from __future__ import annotations

import inspect
import json
import os
import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

import xitl
from tests.recorded import CALM, GUST, MISSION_TLOG
from xitl_cli.logs import open_log
from xitl_cli.logs.formats.dataflash.file import DataFlashLog
from xitl_cli.logs.formats.mcap.file import McapLog
from xitl_cli.logs.formats.tlog.file import TelemetryLog
from xitl_cli.logs.model.log import Log

HEAVY = ("numpy", "scipy", "pydantic", "yaml", "foxglove", "mcap", "pymavlink", "pandas", "gymnasium")


def test_importing_it_loads_nothing_heavy() -> None:
    program = f"import xitl, sys\nprint(*[name for name in {HEAVY!r} if name in sys.modules])"
    assert (
        subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout.split() == []
    )


def test_every_public_name_is_there_and_documented() -> None:
    for name in xitl.__all__:
        if name != "__version__":
            assert getattr(xitl, name).__doc__, name
    assert set(xitl.__all__) <= set(dir(xitl))
    with pytest.raises(AttributeError, match="simulate"):
        _ = xitl.simulat


@pytest.mark.medium
def test_a_run_is_simulated_kept_and_read(tmp_path: Path) -> None:
    overrides = {"environment.wind.mean_mps": 2, "mission.waypoints_ned_m": [[8.0, 6.0], [24.0, 18.0]]}
    result = xitl.simulate("mitl", seed=3, overrides=overrides, out=tmp_path / "run")

    assert result.completed
    assert result.summary["seed"] == 3
    assert result.summary["stale_exchanges"] == 0
    assert json.loads((tmp_path / "run/summary.json").read_text()) == result.summary
    with result.open_log() as log:
        position_ned_m = log["/truth/state"]["position_ned_m"]
    assert position_ned_m.shape[1] == 3
    assert np.hypot(*(position_ned_m[-1, :2] - [24.0, 18.0])) < 5.0


@pytest.mark.medium
def test_a_run_that_is_cut_short_is_a_result(tmp_path: Path) -> None:
    result = xitl.simulate("mitl", duration_s=1.0, out=str(tmp_path / "run"))
    assert not result.completed
    assert result.summary["ended"] == "duration reached"


@pytest.mark.medium
def test_a_run_in_a_thread_of_its_own(tmp_path: Path) -> None:
    with ThreadPoolExecutor(2) as pool:
        runs = [pool.submit(xitl.simulate, "mitl", seed=n, duration_s=0.5, out=tmp_path / str(n)) for n in (1, 2)]
    assert [run.result().summary["seed"] for run in runs] == [1, 2]


@pytest.mark.nightly
@pytest.mark.slow
def test_the_example_runs_as_it_is(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    example = Path(__file__).parents[3] / "examples" / "plot_a_run.py"
    told = subprocess.run(
        [sys.executable, str(example)],
        cwd=tmp_path,
        env={**os.environ, "MPLBACKEND": "Agg", "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert told.returncode == 0, told.stderr
    assert "6 of 6 waypoints" in told.stdout
    assert (tmp_path / "plot_a_run.png").stat().st_size > 10_000


@pytest.mark.medium
def test_a_loaded_profile_runs_and_takes_no_more_overrides(tmp_path: Path) -> None:
    profile = xitl.load_profile("mitl", {"clock.duration_s": 0.5})
    assert xitl.simulate(profile, out=tmp_path / "run").summary["duration_s"] == pytest.approx(0.5)
    with pytest.raises(xitl.UserError, match="give seed, duration_s and overrides to load_profile"):
        xitl.simulate(profile, seed=2, out=tmp_path / "other")


def test_errors_are_those_of_the_commands(tmp_path: Path) -> None:
    with pytest.raises(xitl.UserError, match="stil"):
        xitl.load_profile("stil")
    with pytest.raises(xitl.UserError, match=r"environment\.wind\.mean_mp"):
        xitl.simulate("mitl", overrides=["environment.wind.mean_mp=3"], out=tmp_path / "run")
    with pytest.raises(xitl.LogError, match="does not exist"):
        xitl.open_log(tmp_path / "none.bin")


def test_the_index_of_a_profile() -> None:
    assert xitl.wdri("paper/eq35-full-hitl").wdri == pytest.approx(0.9306, abs=5e-5)


def test_a_log_is_read_by_name() -> None:
    with xitl.open_log(str(CALM)) as log:
        roll_deg = log["ATT"]["Roll"]
        assert len(roll_deg) == len(log["ATT"])
        with pytest.raises(KeyError, match="ATT"):
            _ = log["ATTT"]
        with pytest.raises(KeyError, match="Roll"):
            _ = log["ATT"]["Rol"]


class Named:
    """A path as `os.fspath` knows it, and no more."""

    def __init__(self, path: Path) -> None:
        self._path = str(path)

    def __fspath__(self) -> str:
        return self._path


@pytest.mark.medium
def test_a_path_is_named_as_one_likes(tmp_path: Path) -> None:
    own = tmp_path / "own.yaml"
    own.write_text("extends: [mitl]\nclock: {duration_s: 0.2}\n")
    profile, run = Named(own), Named(tmp_path / "run")
    assert xitl.load_profile(profile, {"clock.seed": np.int64(4)}).name == "own"
    assert xitl.simulate(profile, out=run).recording == tmp_path / "run" / "run.mcap"
    assert xitl.wdri(profile, reference=profile).wdri == pytest.approx(1.0)
    assert not xitl.analyze(Named(MISSION_TLOG), sections="vehicle").refusals
    assert xitl.compare(Named(MISSION_TLOG), str(MISSION_TLOG)).sections
    reader: type[Log]
    for log, reader in ((CALM, DataFlashLog), (MISSION_TLOG, TelemetryLog), (tmp_path / "run/run.mcap", McapLog)):
        for name in (str(log), log, Named(log)):
            for opened in (xitl.open_log(name), open_log(name), reader(name)):
                with opened:
                    assert opened.path == log
        with pytest.raises(xitl.LogError, match="none"):
            reader(str(tmp_path / "none"))


@pytest.mark.medium
def test_a_table_becomes_a_data_frame() -> None:
    pytest.importorskip("pandas")
    with xitl.open_log(CALM) as log:
        frame = log["ATT"].to_pandas()
        assert list(frame["Roll"]) == list(log["ATT"]["Roll"])


def test_logs_are_analysed() -> None:
    report = xitl.analyze(CALM, sections=["scheduler"])
    assert {section.section.key for section in report.sections} >= {"scheduler"}
    assert report.as_json()["files"][0]["name"]
    with pytest.raises(xitl.LogError, match="schedular"):
        xitl.analyze(CALM, sections=["schedular"])


@pytest.mark.medium
def test_two_logs_are_compared() -> None:
    comparison = xitl.compare(CALM, GUST)
    assert "trajectory" in {section.key for section in comparison.sections}


@pytest.mark.medium
def test_the_page_is_what_the_docstrings_say() -> None:
    tool = Path(__file__).parents[3] / "tools" / "generate_api.py"
    done = subprocess.run([sys.executable, str(tool), "--check"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_the_page_lists_each_parameter_of_a_run() -> None:
    page = (Path(__file__).parents[3] / "docs" / "api.md").read_text(encoding="utf-8")
    section = page.partition("## xitl.simulate\n")[2].partition("\n## ")[0]
    assert re.findall(r"^- `(\w+)`: ", section, re.MULTILINE) == list(inspect.signature(xitl.simulate).parameters)
