"""Export formats and replays of other packages, under their own names."""

from __future__ import annotations

import json
import lzma
import re
from pathlib import Path

import pytest
from click.testing import Result
from typer.testing import CliRunner

from tests.command_line import xitl_app
from tests.installed_packages import Install
from xitl_cli.errors import UserError
from xitl_cli.logs import LogError, open_log

ROOT = Path(__file__).parents[4]
GUIDE = re.findall(r"```python\n(.*?)```", (ROOT / "docs/plugins.md").read_text(encoding="utf-8"), re.DOTALL)
(EXPORT,) = (block for block in GUIDE if "ExportResult" in block)
(REPLAY,) = (block for block in GUIDE if "def replay" in block)


@pytest.fixture
def log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "boat.bin"
    path.write_bytes(lzma.decompress((ROOT / "tests/data/logs/boat-auto-calm.bin.xz").read_bytes()))
    return path


def xitl(*words: str) -> Result:
    return CliRunner().invoke(xitl_app(["logs"]), ["logs", *words])


@pytest.mark.medium
def test_the_format_of_the_guide_is_one_of_export(install: Install, log: Path) -> None:
    install("xitl-counts", EXPORT, log_exports="counts = xitl_counts:export")
    done = xitl("export", str(log), "ATT", "IMU", "--format", "counts", "--json")
    assert done.exit_code == 0, done.output
    with open_log(log) as opened:
        rows = {name: len(opened.tables[name]) for name in ("ATT", "IMU")}
    assert json.loads(Path("boat.counts.json").read_text(encoding="utf-8")) == rows
    assert json.loads(done.stdout)["rows"] == sum(rows.values())
    assert xitl("export", str(log), "ATT", "--format", "counts").exception is not None, "the file is there already"


@pytest.mark.medium
@pytest.mark.parametrize(
    ("code", "sentence"),
    [
        (EXPORT.replace("rows = {", "1 / 0; rows = {"), r"counts: the plug-in of xitl-counts 1\.2 failed \(ZeroDivisi"),
        ("import no_such_module", r"counts: the plug-in of xitl-counts 1\.2 cannot be loaded"),
    ],
)
def test_a_format_that_fails_is_one_sentence(install: Install, log: Path, code: str, sentence: str) -> None:
    install("xitl-counts", code, log_exports="counts = xitl_counts:export")
    with pytest.raises(UserError, match=sentence):
        CliRunner().invoke(
            xitl_app(["logs"]), ["logs", "export", str(log), "--format", "counts"], catch_exceptions=False
        )
    assert xitl("export", str(log), "ATT", "--format", "csv").exit_code == 0


@pytest.mark.medium
def test_a_format_without_a_package_names_the_known_ones(log: Path) -> None:
    with pytest.raises(
        LogError, match=r"'counts' is not known; choose from csv, parquet, mcap, .*, or install the pac"
    ):
        CliRunner().invoke(
            xitl_app(["logs"]), ["logs", "export", str(log), "--format", "counts"], catch_exceptions=False
        )


@pytest.mark.medium
def test_the_replay_of_the_guide_is_in_the_report(install: Install, log: Path) -> None:
    install("xitl-list", REPLAY, log_replays="list = xitl_list:replay")
    done = xitl("analyze", str(log), "--report", "page.html", "--replay-by", "list")
    assert done.exit_code == 0, done.output
    page = Path("page.html").read_text(encoding="utf-8")
    assert "1 logs" in page[page.index('id="replay-page"') :]


@pytest.mark.medium
def test_a_replay_that_fails_is_a_note_of_the_report(install: Install, log: Path) -> None:
    install("xitl-list", REPLAY.replace("return", "1 / 0; return"), log_replays="list = xitl_list:replay")
    done = xitl("analyze", str(log), "--report", "page.html", "--replay-by", "list")
    assert done.exit_code == 0, done.output
    page = Path("page.html").read_text(encoding="utf-8")
    start = page.index("There is no 3D replay")
    assert "list: the plug-in of xitl-list 1.2 failed (ZeroDivisionError" in page[start : start + 200]


@pytest.mark.medium
def test_a_replay_without_a_package_is_refused_first(log: Path) -> None:
    with pytest.raises(UserError, match=r"list: no installed package registers it in xitl\.log_replays"):
        CliRunner().invoke(
            xitl_app(["logs"]),
            ["logs", "analyze", str(log), "--report", "page.html", "--replay-by", "list"],
            catch_exceptions=False,
        )
    assert not Path("page.html").exists()
