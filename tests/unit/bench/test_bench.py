"""The bench without its measurements: names, results as JSON, comparisons, and the tables in docs/."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.bench import bench_commands
from tests.bench.__main__ import all_figures, chosen, main, measure
from tests.bench.compare import compare, joined, worktree
from tests.bench.compare import main as compare_main
from tests.bench.figure import Figure, scaled, use_tiny_sizes
from tests.bench.results import FULL, TINY, BenchRun, Measured, Results, ResultsError, read_results, this_run
from tools.write_bench import KEPT, LOGS, OTHER_LOGS, SPEED, keep, pages, with_tables

RUN = BenchRun("a" * 40, False, "2026-01-01T00:00:00+00:00", FULL, {"name": "board", "processors": 2}, {"python": "3"})


def results(values: dict[str, list[float]], wanted: str = ">= 1", run: BenchRun = RUN) -> Results:
    return Results({name: Measured(name, "x", wanted, tuple(row), run) for name, row in values.items()})


def test_names_are_unique() -> None:
    names = [figure.name for figure in all_figures()]
    assert len(set(names)) == len(names)


def test_rows_of_the_pages_and_kept_figures_are_figures_of_the_bench() -> None:
    names = {figure.name for figure in all_figures()}
    assert {name for row in (*SPEED, *LOGS, *OTHER_LOGS) for name in row.figures} <= names
    assert set(read_results(KEPT).figures) <= names


def test_the_tables_of_the_pages_are_those_of_the_kept_results() -> None:
    """Write them with `make bench-pages`."""
    kept = read_results(KEPT)
    for page, text in pages(kept).items():
        stored = page.read_text(encoding="utf-8")
        assert with_tables(stored, text) == stored, page.name
    for figure in kept.figures.values():
        assert len(figure.run.commit) == 40
        assert figure.run.commit[:8] in "".join(pages(kept).values()), figure.name


def test_a_table_shows_median_spread_and_commit() -> None:
    name = SPEED[0].figures[0]
    text = pages(results({name: [10.0, 21.5, 30.25]}))[next(iter(pages(Results())))]
    assert "| 21.5× real time (10 to 30.2) | aaaaaaaa |" in text
    assert "2 cores of board (Python 3)" in text


def test_a_page_without_a_place_is_refused() -> None:
    with pytest.raises(ValueError, match="has no place for the table"):
        with_tables("# Page\n", "x")


def test_results_survive_a_file(tmp_path: Path) -> None:
    other = this_run(TINY)
    made = Results({**results({"a": [1.0, 2.5]}).figures, **results({"b": [3.0]}, "< 2", other).figures})
    made.figures["c"] = Measured("c", "s", "", (), other, "OSError: no")
    made.write(tmp_path / "deep" / "x.json")
    assert read_results(tmp_path / "deep" / "x.json") == made
    stored = json.loads((tmp_path / "deep" / "x.json").read_text())
    assert len(stored["runs"]) == 2
    assert stored["runs"][1]["machine"]["processors"] >= 1
    assert "numpy" in stored["runs"][1]["versions"]


@pytest.mark.parametrize("text", ["", "{}", '{"format": 9, "runs": [], "figures": []}', "[1]"])
def test_a_file_of_something_else_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "x.json"
    path.write_text(text)
    with pytest.raises(ResultsError, match=r"x\.json"):
        read_results(path)
    with pytest.raises(ResultsError, match="cannot be read"):
        read_results(tmp_path / "none.json")


def test_results_are_kept_of_a_commit_and_with_full_sizes_alone() -> None:
    kept = results({"a": [1.0], "b": [2.0]})
    assert keep(kept, results({"b": [3.0]})).figures["b"].values == (3.0,)
    for wrong in ({"sizes": TINY}, {"changed": True}, {"commit": ""}):
        run = BenchRun(**{**vars(RUN), **wrong})
        with pytest.raises(ValueError, match="commit first"):
            keep(kept, results({"a": [2.0]}, run=run))


def test_a_figure_that_failed_does_not_replace_a_kept_one() -> None:
    failed = Results({"a": Measured("a", "x", "", (), RUN, "OSError: no")})
    assert keep(results({"a": [1.0]}), failed).figures["a"].values == (1.0,)


# Comparisons


def test_pairs_of_a_constant_ratio_have_an_interval_without_width() -> None:
    base = [1.0, 5.0, 2.0, 9.0]
    (row,) = compare(results({"a": base}), results({"a": [2.0 * value for value in base]}), paired=True)
    assert (row.ratio, row.low, row.high, row.least, row.most, row.verdict) == (2.0, 2.0, 2.0, 2.0, 2.0, "better")


@pytest.mark.parametrize(
    ("wanted", "factor", "verdict"),
    [(">= 1", 0.5, "worse"), ("< 1", 0.5, "better"), ("< 1", 2.0, "worse"), ("", 2.0, "more"), ("", 0.5, "less")],
)
def test_whether_a_change_is_an_improvement_is_known_by_the_limit(wanted: str, factor: float, verdict: str) -> None:
    a, b = results({"a": [1.0, 2.0]}, wanted), results({"a": [factor, 2.0 * factor]}, wanted)
    assert compare(a, b, paired=True)[0].verdict == verdict


@pytest.mark.medium
def test_the_interval_of_independent_values_covers_the_true_ratio() -> None:
    rng = np.random.default_rng(3)
    covered = 0
    for _ in range(60):
        a, b = rng.normal(100.0, 5.0, 15), rng.normal(150.0, 5.0, 15)
        (row,) = compare(results({"a": list(a)}), results({"a": list(b)}), paired=False)
        covered += row.low <= 1.5 <= row.high
        assert row.low <= row.ratio <= row.high
    assert covered >= 50  # 95 % of 60 are 57; the bootstrap of a median of 15 values is somewhat narrow


def test_noise_alone_is_no_difference() -> None:
    rng = np.random.default_rng(4)
    a, b = (list(rng.normal(100.0, 5.0, 9)) for _ in range(2))
    assert compare(results({"a": a}), results({"a": b}), paired=True)[0].verdict == "no difference"


def test_figures_that_one_side_lacks_or_that_are_0_are_left_out() -> None:
    a, b = results({"a": [1.0], "b": [1.0], "d": [0.0]}), results({"b": [1.0], "c": [1.0], "d": [0.0]})
    assert [row.name for row in compare(a, b, paired=True)] == ["b"]


def test_each_turn_adds_its_median() -> None:
    first = joined(Results(), results({"a": [1.0, 2.0, 9.0]}))
    assert joined(first, results({"a": [4.0]})).figures["a"].values == (2.0, 4.0)


def test_a_worktree_has_the_product_of_its_commit_and_the_tests_of_head(tmp_path: Path) -> None:
    def git(*words: str) -> None:
        own = ("-c", "user.name=x", "-c", "user.email=x@example.org")
        subprocess.run(["git", "-C", str(tmp_path), *own, *words], check=True, capture_output=True)

    git("init", "-q", "-b", "main")
    (tmp_path / "tests").mkdir()
    for number in (1, 2):
        (tmp_path / "product.py").write_text(f"{number}")
        (tmp_path / "tests/bench.py").write_text(f"{number}")
        git("add", "-A")
        git("commit", "-qm", f"{number}")
    with worktree(tmp_path, "HEAD~1") as old, worktree(tmp_path, "HEAD") as new, worktree(tmp_path, "HEAD") as again:
        assert len({old, new, again}) == 3
        assert [(tree / "product.py").read_text() for tree in (old, new)] == ["1", "2"]
        assert [(tree / "tests/bench.py").read_text() for tree in (old, new)] == ["2", "2"]
    assert not old.exists()
    assert not again.exists()
    with pytest.raises(ResultsError, match="nothing"), worktree(tmp_path, "nothing"):
        pass


def test_two_files_are_compared_by_the_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name, factor in (("a", 1.0), ("b", 3.0)):
        results({"first": [factor, 2 * factor], "second": [factor]}).write(tmp_path / f"{name}.json")
    files = [str(tmp_path / "a.json"), str(tmp_path / "b.json")]
    assert compare_main(files) == 0
    told = capsys.readouterr().out
    assert "aaaaaaaaa on board" in told
    assert "3.000" in told
    assert compare_main([*files, "--only", "second"]) == 0
    assert "first" not in capsys.readouterr().out
    assert compare_main([*files, "--only", "third"]) == 2
    assert compare_main([files[0], "HEAD"]) == 2
    assert "HEAD: is not a file" in capsys.readouterr().err


# The bench itself


def fails() -> list[float]:
    raise OSError("no")


def test_a_row_that_fails_does_not_end_the_bench() -> None:
    rows = measure([Figure("a", "", "s", fails), Figure("b", "< 1", "s", lambda: [1, 2])], lambda text: None)
    assert rows == [("a", "s", "", [], "OSError: no"), ("b", "s", "< 1", [1.0, 2.0], "")]


def test_figures_are_chosen_by_words_of_their_names() -> None:
    assert {figure.name for figure in chosen(["MITL"])} == {
        "mitl with waves, gusts and recording",
        "run of 64 vessels of mitl over a run of one",
    }
    assert main(["--only", "nothing like this"]) == 2


def test_the_list_has_every_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--list"]) == 0
    assert capsys.readouterr().out.splitlines() == [figure.name for figure in all_figures()]


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    monkeypatch.setenv(bench_commands.CAMPAIGN_VARIABLE, "2")
    return lambda: use_tiny_sizes(False)


def test_sizes_are_full_unless_tiny_ones_are_asked_for() -> None:
    assert scaled(5, 1) == 5
    use_tiny_sizes()
    try:
        assert scaled(5, 1) == 1
    finally:
        use_tiny_sizes(False)


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        "mitl with waves, gusts and recording",
        "run of 64 vessels of mitl over a run of one",
        "a step of a batch of 1024 vessels in waves",
        "xitl sim until its first step",
        "campaign of 60 runs of 60 s, two workers",
        "100 MB of a board: all fields of its IMU, of pymavlink",
    ],
)
def test_a_row_measures_and_is_written_with_machine_and_commit(
    name: str, tmp_path: Path, tiny: Callable[[], None]
) -> None:
    try:
        assert main(["--tiny", "--only", name, "--out", str(tmp_path / "x.json")]) == 0
    finally:
        tiny()
    figure = read_results(tmp_path / "x.json").figures[name]
    assert min(figure.values) > 0.0
    assert figure.run.sizes == TINY
    assert figure.run.commit == this_run(TINY).commit
    assert figure.run.machine["name"]
