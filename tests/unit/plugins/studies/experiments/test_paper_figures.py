"""Figures and pages are written whole; what the drawing needs is named."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import pytest
from typer.testing import CliRunner

from xitl_cli.errors import UserError
from xitl_cli.experiment.report import ExperimentReport, PaperFigure, PaperRow, told_text
from xitl_cli.experiment.setup import ExperimentSetup
from xitl_cli.extras import Extra
from xitl_cli.plugins.studies.experiments import figures
from xitl_cli.plugins.studies.experiments.figures import check_figures_installed, drawn, write_page
from xitl_cli.plugins.studies.experiments.wdri_indices import PRINTED, compute_indices, wdri_report

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def _line(figure: Figure) -> None:
    figure.add_subplot().plot([0, 1], [1, 0])


LINE = PaperFigure("line", "A <line>", _line, (2.0, 1.5))
REPORT = ExperimentReport(
    "9.9", "Nothing", ("Of <nothing>.",), (PaperRow("a & b", 3.87, 4.0, "m s", "Larger."),), (LINE,)
)


@pytest.mark.medium
def test_the_eight_indices_are_as_printed() -> None:
    assert len(PRINTED) == 8
    report = wdri_report(ExperimentSetup(Path()))
    assert report.completed
    assert all(round(row.ours, 2) == row.paper for row in report.rows)
    assert all(row.difference.startswith("Equal to the 2 digits printed") for row in report.rows)
    assert "over all 9" in report.rows[1].difference
    assert "HS weighs 0" in report.rows[5].difference
    assert [one.computed.n for one in compute_indices()] == [9, 4, 9, 9, 9, 9, 9, 9]


@pytest.mark.medium
def test_a_figure_is_the_same_bytes_twice_and_a_whole_file() -> None:
    assert drawn(LINE, "png")[:8] == b"\x89PNG\r\n\x1a\n"
    picture = drawn(LINE, "svg")
    assert picture == drawn(LINE, "svg")
    assert ElementTree.fromstring(picture).tag.endswith("svg")


@pytest.mark.medium
def test_the_page_asks_for_nothing_outside(tmp_path: Path) -> None:
    write_page([REPORT], tmp_path / "paper.html")
    page = (tmp_path / "paper.html").read_text()
    assert "a &amp; b" in page
    assert "3.87 m s" in page
    assert "A &lt;line&gt;" in page
    assert "data:image/svg+xml;base64," in page
    assert "http" not in page


def test_values_for_people() -> None:
    assert [told_text(*each) for each in ((3.87, "m s"), (20000.0, "us"), (None, "s"), ("no loss", "s"))] == [
        "3.87 m s", "20000 us", "–", "no loss",
    ]  # fmt: skip


@pytest.mark.medium
def test_what_draws_is_named_where_it_is_missing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from tests.command_line import xitl_app

    missing = Extra("figures", ("matplotlib_that_is_not_there",), "figures")
    monkeypatch.setattr(figures, "FIGURES", missing)
    monkeypatch.setattr("xitl_cli.extras.FIGURES", missing)
    with pytest.raises(UserError, match=r"pip install 'xitl\[figures\]'"):
        check_figures_installed()
    done = CliRunner().invoke(xitl_app(), ["paper", "wdri", "--out", str(tmp_path)])
    assert done.exit_code == 0
    assert "pip install 'xitl[figures]'" in done.stdout
    assert [path.name for path in tmp_path.iterdir()] == ["table.json"]
    assert json.loads((tmp_path / "table.json").read_text())["completed"]
