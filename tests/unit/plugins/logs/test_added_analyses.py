"""Analyses of other packages, after the built-in ones."""

from __future__ import annotations

import json

import pytest
from typer.testing import CliRunner, Result

import xitl
from tests.command_line import xitl_app
from tests.golden import Golden
from tests.installed_packages import Install
from tests.recorded import CALM
from xitl_cli.errors import UserError

LOG = CALM
DEPTH = """
from xitl_cli.logs.model.sections import Fact, Finding, Section

def analyse(log):
    rows = len(log.tables["ATT"])
    return Section("depth", "Depth", facts=(Fact("rows", "Rows", rows),), findings=(Finding.ok("depth.ok", "Deep."),))
"""


def analyze(*words: str) -> Result:
    return CliRunner().invoke(xitl_app(["logs"]), ["logs", "analyze", str(LOG), "--json", *words])


@pytest.mark.medium
def test_an_analysis_of_another_package_is_a_section_after_the_built_in_ones(install: Install) -> None:
    install("xitl-depth", DEPTH, log_analyses="depth = xitl_depth:analyse")
    done = analyze()
    assert done.exit_code == 0
    sections = list(json.loads(done.stdout)["files"][0]["sections"])
    assert sections[-1] == "depth"
    assert len(sections) > 3
    (only,) = json.loads(analyze("--section", "depth").stdout)["files"][0]["sections"].values()
    assert only["findings"][0]["sentence"] == "Deep."
    (file,) = xitl.analyze(LOG, sections="depth").files
    with xitl.open_log(LOG) as log:
        assert [fact.value for fact in file.sections[0].facts] == [len(log["ATT"])]


@pytest.mark.medium
def test_an_analysis_that_raises_is_a_failure_with_its_package_and_line(install: Install, golden: Golden) -> None:
    install("xitl-depth", "def analyse(log):\n    return 1 / 0\n", log_analyses="depth = xitl_depth:analyse")
    done = analyze()
    assert done.exit_code == 1
    assert "the analysis of depth by xitl-depth 1.2 failed at " in done.stderr
    golden("stderr", done.stderr)
    assert len(json.loads(done.stdout)["files"][0]["sections"]) > 3


@pytest.mark.medium
def test_a_result_that_is_no_section_is_a_failure(install: Install) -> None:
    install("xitl-depth", "def analyse(log):\n    return 'deep'\n", log_analyses="depth = xitl_depth:analyse")
    assert analyze("--section", "depth").exit_code == 1


def test_an_analysis_that_cannot_be_loaded_is_named_where_it_is_asked_for(install: Install) -> None:
    install("xitl-depth", "import no_such_module", log_analyses="depth = xitl_depth:analyse")
    assert analyze("--section", "vehicle").exit_code == 0
    with pytest.raises(UserError, match=r"depth: the plug-in of xitl-depth 1\.2 cannot be loaded"):
        xitl.analyze(LOG, sections="depth")


def test_a_built_in_section_keeps_its_name(install: Install) -> None:
    install("xitl-depth", DEPTH, log_analyses="vehicle = xitl_depth:analyse")
    (file,) = xitl.analyze(LOG, sections="vehicle").files
    assert [section.key for section in file.sections] == ["vehicle"]
