"""`xitl paper` with experiments that are made up: options, tables, files and exit codes."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from typer.testing import CliRunner

from tests.command_line import xitl_app
from xitl_cli.errors import UserError
from xitl_cli.experiment.report import ExperimentReport, PaperFigure, PaperRow
from xitl_cli.experiment.setup import ExperimentSetup, InterruptedRunError
from xitl_cli.plugins.studies import api
from xitl_cli.plugins.studies.experiments import figures

if TYPE_CHECKING:
    from matplotlib.figure import Figure

pytest.importorskip("matplotlib")
pytestmark = pytest.mark.medium
ROWS = (
    PaperRow("IAE x", 3.87, 4.0, "m s", "Alike."),
    PaperRow("mission completed", "both", "none", "", "See the runs."),
)
REPORT = ExperimentReport("9.9", "Made up", ("Of nothing.",), ROWS)
Outcome = Callable[[str, ExperimentSetup], ExperimentReport]


@pytest.fixture
def experiments_are(monkeypatch: pytest.MonkeyPatch) -> Callable[[Outcome], list[tuple[str, ExperimentSetup]]]:
    """Return a function that replaces the experiments, and returns what they are asked for."""

    def replaced(outcome: Outcome) -> list[tuple[str, ExperimentSetup]]:
        asked: list[tuple[str, ExperimentSetup]] = []

        def carry_out(section: str, setup: ExperimentSetup) -> ExperimentReport:
            asked.append((section, setup))
            return outcome(section, setup)

        monkeypatch.setattr(api, "carry_out", carry_out)
        return asked

    return replaced


def made(section: str, setup: ExperimentSetup) -> ExperimentReport:
    return replace(REPORT, section=section)


def paper(*words: str | Path) -> tuple[int, str, str]:
    done = CliRunner(env={"COLUMNS": "200"}).invoke(xitl_app(["paper"]), ["paper", *map(str, words)])
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    return done.exit_code, done.stdout, done.stderr


Asked = Callable[[Outcome], list[tuple[str, ExperimentSetup]]]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (
            ("4.1", "--real", "a.bin", "--from", "3", "--until", "9", "--vehicle", "otter"),
            {"real": Path("a.bin"), "from_s": 3.0, "until_s": 9.0, "vehicle": "otter"},
        ),
        (("4.1",), {"vehicle": "asv-third"}),
        (("4.2", "--firmware", "rover", "--overwrite"), {"firmware": "rover", "overwrite": True}),
        (("4.3", "--board", "udp://b:1", "--firmware", "rover"), {"board": "udp://b:1", "firmware": "rover"}),
        (("4.4", "--seed", "7", "--duration", "12"), {"seed": 7, "duration_s": 12.0}),
        (("wdri",), {}),
    ],
)
def test_options_are_those_of_the_experiment(
    words: tuple[str, ...], expected: dict[str, Any], tmp_path: Path, experiments_are: Asked
) -> None:
    asked = experiments_are(made)
    code, _, _ = paper(*words, "--out", tmp_path)
    ((section, setup),) = asked
    assert (code, section) == (0, words[0])
    assert replace(setup, tell=print) == replace(ExperimentSetup(tmp_path, **expected), tell=print)


def test_the_table_is_shown_and_written(tmp_path: Path, experiments_are: Asked) -> None:
    asked = experiments_are(lambda section, setup: setup.tell("a run") or replace(REPORT, runs=("runs/a",)))
    code, out, _ = paper("4.4", "--out", tmp_path)
    assert (code, len(asked)) == (0, 1)
    lines = [" ".join(line.split()) for line in out.splitlines() if line.strip()]
    assert lines == [
        "a run",
        "9.9: Made up",
        "Of nothing.",
        "quantity paper ours difference",
        "IAE x 3.87 m s 4 m s Alike.",
        "mission completed both none See the runs.",
        f"{tmp_path}: table.json, and the runs",
    ]
    written = json.loads((tmp_path / "table.json").read_text(encoding="utf-8"))
    assert written["table"][0]["ours"] == 4.0
    assert [path.name for path in tmp_path.iterdir()] == ["table.json"]


def line(figure: Figure) -> None:
    figure.add_subplot().plot([0, 1], [1, 0])


def test_figures_and_a_page_are_written(tmp_path: Path, experiments_are: Asked) -> None:
    experiments_are(lambda section, setup: replace(REPORT, figures=(PaperFigure("line", "A line", line, (2.0, 1.5)),)))
    code, out, _ = paper("4.2", "--out", tmp_path, "--report")
    assert code == 0
    assert f"{tmp_path}: line.png, line.svg, table.json\n" in out
    assert f"page: {tmp_path / 'paper.html'}" in out
    assert sorted(path.name for path in tmp_path.iterdir()) == ["line.png", "line.svg", "paper.html", "table.json"]
    page = (tmp_path / "paper.html").read_text(encoding="utf-8")
    assert "<nav></nav>" not in page
    assert 'href="#section' not in page  # a single section needs no links


def test_a_figure_that_cannot_be_drawn_for_lack_of_a_package_is_said(
    tmp_path: Path, experiments_are: Asked, monkeypatch: pytest.MonkeyPatch
) -> None:
    experiments_are(made)
    monkeypatch.setattr(figures, "check_figures_installed", lambda: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        paper("4.2", "--out", tmp_path, "--report")
    assert paper("4.2", "--out", tmp_path)[0] == 0  # without a page nothing is drawn


def test_the_document_for_programs(tmp_path: Path, experiments_are: Asked) -> None:
    experiments_are(lambda section, setup: setup.tell("a run") or replace(REPORT, completed=False))
    code, out, errors = paper("4.3", "--out", tmp_path, "--json")
    assert code == 1
    told = json.loads(out)
    assert (told["section"], told["page"], told["completed"]) == ("9.9", None, False)
    assert "a run" in errors


def test_an_experiment_that_is_impossible_is_an_error(tmp_path: Path, experiments_are: Asked) -> None:
    def impossible(section: str, setup: ExperimentSetup) -> ExperimentReport:
        raise UserError("no board")

    experiments_are(impossible)
    with pytest.raises(UserError, match="no board"):
        paper("4.3", "--out", tmp_path)


def test_of_all_experiments_the_impossible_are_left_out(tmp_path: Path, experiments_are: Asked) -> None:
    def some(section: str, setup: ExperimentSetup) -> ExperimentReport:
        if section == "4.3":
            raise UserError("no board")
        return made(section, setup)

    asked = experiments_are(some)
    code, out, _ = paper("all", "--out", tmp_path, "--report", "--seed", "3", "--board", "udp://b:1")
    assert code == 2
    assert [section for section, _ in asked] == list(api.EXPERIMENTS)
    assert {setup.out for _, setup in asked} == {tmp_path / section for section in api.EXPERIMENTS}
    assert {(setup.seed, setup.board) for _, setup in asked} == {(3, "udp://b:1")}
    assert "4.3 is left out: no board" in out
    number = list(api.EXPERIMENTS).index("4.4") + 1
    assert f"4.4: {number} of {len(api.EXPERIMENTS)}" in out  # those that are left out count
    assert not (tmp_path / "4.3").exists()
    assert (tmp_path / "4.4" / "table.json").is_file()
    page = (tmp_path / "paper.html").read_text(encoding="utf-8")
    assert page.count('href="#section') == len(api.EXPERIMENTS) - 1
    code, out, _ = paper("all", "--out", tmp_path / "json", "--json")
    told = json.loads(out)
    assert code == 2
    assert [one["section"] for one in told["experiments"]] == [one for one in api.EXPERIMENTS if one != "4.3"]
    assert told["left_out"] == {"4.3": "no board"}


def test_all_experiments_that_are_completed_return_0(tmp_path: Path, experiments_are: Asked) -> None:
    experiments_are(made)
    assert paper("all", "--out", tmp_path)[0] == 0
    experiments_are(lambda section, setup: replace(REPORT, section=section, completed=section != "4.1"))
    assert paper("all", "--out", tmp_path, "--overwrite")[0] == 1


@pytest.mark.parametrize("done", [None, replace(REPORT, section="4.2")])
def test_an_interruption_keeps_what_is_completed(
    done: ExperimentReport | None, tmp_path: Path, experiments_are: Asked
) -> None:
    def interrupted(section: str, setup: ExperimentSetup) -> ExperimentReport:
        if section == "4.2":
            raise InterruptedRunError(done)
        return made(section, setup)

    asked = experiments_are(interrupted)
    code, out, errors = paper("all", "--out", tmp_path)
    assert code == 130
    assert [section for section, _ in asked] == list(api.EXPERIMENTS)[: list(api.EXPERIMENTS).index("4.2") + 1]
    assert f"interrupted; completed experiments are kept in {tmp_path}" in out + errors
    assert (tmp_path / "4.2" / "table.json").is_file() is (done is not None)
    assert (tmp_path / "4.1" / "table.json").is_file()


def test_the_program_s_interface_makes_the_same_setup(
    tmp_path: Path, experiments_are: Asked, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = experiments_are(made)
    report = api.paper(
        "4.3",
        out=tmp_path,
        seed=5,
        duration_s=9.0,
        real="a.bin",
        board="udp://b:1",
        firmware=Path("rover"),
        overwrite=True,
    )
    ((section, setup),) = asked
    assert (section, report.section) == ("4.3", "4.3")
    expected = ExperimentSetup(tmp_path, 5, 9.0, True, "rover", Path("a.bin"), board="udp://b:1")
    assert replace(setup, tell=print) == replace(expected, tell=print)
    monkeypatch.chdir(tmp_path)
    api.paper("4.4")
    default = asked[1][1].out
    assert default.parent == Path("runs")
    assert default.name.startswith("paper-4.4-")
    with pytest.raises(UserError, match=r"'5\.1' is not a section of the paper; use 4\.1, 4\.2"):
        api.paper("5.1")
