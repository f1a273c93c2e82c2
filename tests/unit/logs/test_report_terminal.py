"""A report at a terminal and as JSON."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest
from report_samples import sample_report
from rich.console import Console

from xitl_cli.logs.clocks.time_line import Stretch, TimeLine
from xitl_cli.logs.model.sections import Evidence, Grid
from xitl_cli.logs.model.text import clock_text, duration_text, parse_seconds
from xitl_cli.logs.report import terminal
from xitl_cli.logs.report.json import document, plain
from xitl_cli.logs.report.terminal import grid_lines
from xitl_cli.logs.report.wording import evidence_text


@pytest.fixture(scope="module")
def lines() -> list[str]:
    console = Console(file=io.StringIO(), width=80, highlight=False)
    terminal.show(console, sample_report())
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue().split("\n")


def test_no_line_is_longer_than_80_columns_or_ends_in_blanks(lines: list[str]) -> None:
    assert max(map(len, lines)) <= 80
    assert all(line == line.rstrip() for line in lines)


def test_a_pipe_gets_no_colour_and_no_command_of_a_log(lines: list[str]) -> None:
    assert not [line for line in lines if not line.isprintable()]


def test_the_worst_comes_first_with_evidence_and_next_step(lines: list[str]) -> None:
    text = "\n".join(lines)
    order = [
        text.index(each) for each in ("1 critical, 1 warning", "CRITICAL", "WARNING", "fine", "Scheduler\n", "Sensors")
    ]
    assert order[:4] == sorted(order[:4])
    assert "IMU at 0:20.0" in text
    assert "PM.MaxT from 0:43.2 to 0:53.2: 23 ms" in text
    assert "→ Look at what else happened then" in text
    assert "degraded" in text[: text.index("critical")]


def test_unknown_values_are_a_dash(lines: list[str]) -> None:
    assert "  Load   –" in lines
    assert "  Rate   50 Hz" in lines


def test_wide_text_goes_below_its_row() -> None:
    grid = Grid("k", "T", ("at (s)", "what", "long"), ((1.5, "w " * 40, 3), (20.25, "short", None)))
    assert grid_lines(grid, 40, 8) == [
        "at (s)  long",
        "   1.5     3",
        "  what: w w w w w w w w w w w w w w w w",
        "    w w w w w w w w w w w w w w w w w w",
        "    w w w w w w",
        " 20.25     –",
        "  what: short",
    ]


def test_what_does_not_fit_beside_goes_below_and_rows_left_out_are_counted() -> None:
    grid = Grid("k", "T", tuple(f"column{index}" for index in range(9)), ((1,) * 9,) * 11)
    told = grid_lines(grid, 40, 8)
    assert max(map(len, told)) <= 40 or told[-1].startswith("(")
    assert told[-1] == "(3 more rows in --report and --json)"
    assert told[2:4] == ["  column4 1, column5 1, column6 1,", "    column7 1, column8 1"]


def test_json_is_json() -> None:
    told = json.loads(json.dumps(document(sample_report()), allow_nan=False))
    assert told["worst"] == "critical"
    assert told["counts"] == {"critical": 1, "warning": 1, "notice": 0, "fine": 1}
    assert [finding["key"] for finding in told["findings"]] == ["sensors.gap", "scheduler.long_loops", "scheduler.fine"]
    section = told["files"][0]["sections"]["scheduler"]
    assert section["facts"] == {"loops": 14400, "load_pct": None, "rate_hz": 50.0}
    assert section["grids"]["windows"]["rows"][2] == [1e-9, 0, None]
    assert told["findings"][1]["evidence"][0]["at_s"] == 43.2
    assert told["refused"] == [{"path": "x.ulg", "reason": "x.ulg: looks like a PX4 log; convert it first"}]


@pytest.mark.parametrize(
    ("value", "kept"), [(np.float64("nan"), None), (np.int64(3), 3), (np.bool_(True), True), (float("inf"), None)]
)
def test_numbers_of_numpy_become_json(value: object, kept: object) -> None:
    assert plain(value) == kept
    assert type(plain(value)) is type(kept)


@pytest.mark.parametrize(
    ("at_s", "text"),
    [
        (0.0, "0:00.0"),
        (43.249, "0:43.2"),
        (59.96, "1:00.0"),
        (3599.99, "1:00:00.0"),
        (-1.04, "-0:01.0"),
        (-0.01, "0:00.0"),
    ],
)
def test_instants_as_people_write_them(at_s: float, text: str) -> None:
    assert clock_text(at_s) == text
    assert parse_seconds(text) == pytest.approx(at_s, abs=0.05)


def test_durations_have_a_unit() -> None:
    assert [duration_text(length) for length in (0.44, 372.0, 3723.0)] == ["0.4 s", "6:12 min", "1:02:03 h"]


def test_evidence_of_a_file_on_another_clock_is_on_the_line_of_the_report() -> None:
    # The log's second 10 is the reference's second 15, and its clock is 1000 ppm slow.
    line = TimeLine(zero_ns=1_000_000_000, stretches=(Stretch(10_000_000_000, 5_000_000_000, 1000.0),))
    stamps = np.array([10, 110], dtype=np.int64) * 1_000_000_000
    np.testing.assert_allclose(line.seconds(stamps), [14.0, 114.1], atol=1e-9)
    assert evidence_text(Evidence("ATT", "Roll", 110_000_000_000), line) == "ATT.Roll at 1:54.1"
