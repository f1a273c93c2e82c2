"""`xitl campaign` with workers that are made up: what is shown, written and returned."""

from __future__ import annotations

import contextlib
import json
import re
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from imagined_runs import Figures, ImaginaryWorkers
from test_campaign_search import BISECTION
from test_campaign_search import track as track_of_a_search
from typer.testing import CliRunner

from tests.command_line import xitl_app
from xitl_cli.plugins.campaign import command, engine
from xitl_cli.plugins.campaign.cluster import TlsFiles
from xitl_cli.plugins.campaign.statistics import wilson_interval

pytest.importorskip("scipy")
pytestmark = pytest.mark.medium

WIND, TRACK = "environment.wind.mean_mps", "mission.cross_track_rms_m"
PLAN = f"""
base: mitl
axes: {{{WIND}: [0, 4, 8]}}
seeds: 1-4
keep: [duration_s]
verdicts: [{TRACK} < 3]
recordings: none
"""


def track(values: Mapping[str, Any], seed: int) -> Mapping[str, Any]:
    """Not below the limit of 3 m at 4 m/s with seed 4, and at 8 m/s with seeds 2 to 4."""
    return {TRACK: 0.25 * values[WIND] + 0.5 * seed, "duration_s": 60.0}


class AskedWorkers(ImaginaryWorkers):
    threads = 3
    dashboard: str | None = None


class Asked:
    """The arguments of the workers that a campaign asked for."""

    def __init__(self) -> None:
        self.here: list[int | None] = []
        self.there: list[tuple[str, Path | None, TlsFiles | None]] = []
        self.tried = 0


@pytest.fixture
def workers_are(monkeypatch: pytest.MonkeyPatch) -> Callable[[Figures], Asked]:
    """Return a function that replaces the workers by those of these figures."""

    def replaced(figures: Figures) -> Asked:
        asked = Asked()

        @contextlib.contextmanager
        def local_workers(count: int | None, name: str) -> Iterator[AskedWorkers]:
            asked.here.append(count)
            yield AskedWorkers(figures)

        @contextlib.contextmanager
        def workers_at(on: str, name: str, folder: Path | None, tls: TlsFiles | None) -> Iterator[AskedWorkers]:
            asked.there.append((on, folder, tls))
            workers = AskedWorkers(figures)
            workers.dashboard = "http://head:8787"
            yield workers

        def first_run(plan: object) -> None:
            asked.tried += 1

        monkeypatch.setattr(engine, "local_workers", local_workers)
        monkeypatch.setattr(engine, "workers_at", workers_at)
        monkeypatch.setattr(engine, "try_first_run", first_run)
        return asked

    return replaced


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    path = tmp_path / "plan.yaml"
    path.write_text(PLAN, encoding="utf-8")
    return path


def campaign(*words: str | Path) -> tuple[int, str, str]:
    """Exit code, output and errors in lines of any width as one."""
    done = CliRunner(env={"COLUMNS": "200"}).invoke(xitl_app(["campaign"]), ["campaign", *map(str, words)])
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    return done.exit_code, done.stdout, done.stderr


def test_the_table_tells_rates_and_the_worst_runs(
    plan: Path, tmp_path: Path, workers_are: Callable[[Figures], Asked]
) -> None:
    asked = workers_are(track)
    code, out, errors = campaign(plan, "--out", tmp_path / "out", "--workers", "2")
    assert code == 1
    assert (asked.here, asked.there, asked.tried) == ([2], [], 1)
    assert f"12 runs of mitl, in {tmp_path / 'out'}" in errors
    assert "3 parallel runs on this machine" in errors
    assert "12 of 12 runs" in errors
    assert "4 did not pass" in errors
    assert "8 of 12 runs passed (12 completed)" in out
    (verdict,) = [line for line in out.splitlines() if line.startswith(f"{TRACK} < 3")]
    assert "8 of 12" in verdict
    assert "66.7 %" in verdict
    worst = re.findall(r"^ +(\d+)  completed: (.*)\n +(xitl sim .*)$", out, re.MULTILINE)
    assert sorted(number for number, _, _ in worst) == ["10", "11", "12", "8"]
    assert {reason for _, reason, _ in worst} == {f"{TRACK} < 3"}
    assert ("12", f"{TRACK} < 3", f"xitl sim mitl --set {WIND}=8 --seed 4") in worst
    assert out.rstrip().endswith(f"{tmp_path / 'out'}: results.jsonl, results.parquet")
    assert "figures" in out.lower()


def test_several_verdicts_have_a_row_for_all_of_them(
    plan: Path, tmp_path: Path, workers_are: Callable[[Figures], Asked]
) -> None:
    plan.write_text(PLAN.replace("verdicts: [", "verdicts: [duration_s < 100, "), encoding="utf-8")
    workers_are(track)
    _, out, _ = campaign(plan, "--out", tmp_path / "out")
    rows = {line.split("  ")[0]: line for line in out.splitlines()}
    assert "12 of 12" in rows["duration_s < 100"]
    assert "8 of 12" in rows["all of them"]


def test_a_campaign_that_passes_returns_0_and_writes_its_page(
    plan: Path, tmp_path: Path, workers_are: Callable[[Figures], Asked]
) -> None:
    workers_are(lambda values, seed: {TRACK: 0.1 * seed, "duration_s": 60.0})
    code, out, errors = campaign(plan, "--out", tmp_path / "out", "--report")
    assert code == 0
    assert "all passed" in errors
    assert "worst runs" not in out
    assert out.rstrip().endswith("results.parquet, report.html")
    assert "12 runs of mitl" in (tmp_path / "out/report.html").read_text(encoding="utf-8")


def test_the_document_for_programs(plan: Path, tmp_path: Path, workers_are: Callable[[Figures], Asked]) -> None:
    workers_are(lambda values, seed: {"status": "timeout"} if seed == 1 else track(values, seed))
    code, out, _ = campaign(plan, "--out", tmp_path / "out", "--json")
    assert code == 1
    told = json.loads(out)
    assert (told["campaign"], told["directory"]) == ("plan", str(tmp_path / "out"))
    assert (told["complete"], told["runs"], told["passed"], told["report"]) == (True, 12, 5, None)
    assert told["statuses"] == {"timeout": 3, "completed": 9}
    of_track, passed = told["verdicts"]
    assert (of_track["verdict"], of_track["held"], of_track["runs"]) == (f"{TRACK} < 3", 5, 12)
    assert (passed["verdict"], passed["held"]) == ("passed", 5)
    assert 0.0 < of_track["low"] < 0.5 < of_track["high"] < 1.0
    assert {row["status"] for row in told["worst"]} == {"timeout", "completed"}
    assert set(told["worst"][0]) == {"number", "status", "error", "command"}
    assert set(told["sections"]) == {"figures"}


def test_runs_of_one_seed_have_the_interval_of_wilson(
    plan: Path, tmp_path: Path, workers_are: Callable[[Figures], Asked]
) -> None:
    plan.write_text(PLAN.replace("seeds: 1-4", "seeds: [4]"), encoding="utf-8")
    workers_are(track)
    _, out, _ = campaign(plan, "--out", tmp_path / "out", "--json")
    (of_track, _) = json.loads(out)["verdicts"]
    expected = wilson_interval(1, 3)
    assert (of_track["held"], of_track["low"], of_track["high"]) == (1, expected.low, expected.high)


def test_an_interrupted_campaign_continues(plan: Path, tmp_path: Path, workers_are: Callable[[Figures], Asked]) -> None:
    ended = 0

    def interrupted(values: Mapping[str, Any], seed: int) -> Mapping[str, Any]:
        nonlocal ended
        ended += 1
        if ended == 6:
            raise KeyboardInterrupt
        return track(values, seed)

    workers_are(interrupted)
    code, out, errors = campaign(plan, "--out", tmp_path / "out", "--json")
    assert code == 130
    assert f"interrupted with 7 of 12 runs left; continue with --resume --out {tmp_path / 'out'}" in errors
    assert (json.loads(out)["complete"], json.loads(out)["runs"]) == (False, 5)
    asked = workers_are(track)
    code, out, _ = campaign(plan, "--out", tmp_path / "out", "--resume", "--json")
    assert (code, json.loads(out)["runs"], json.loads(out)["complete"]) == (1, 12, True)
    assert asked.tried == 0  # the first run has been tried before


@pytest.mark.parametrize(
    ("figures", "code"),
    [(track_of_a_search, 0), (lambda values, seed: {"mission.cross_track_max_m": 0.1}, 1)],
)
def test_a_search_succeeds_if_it_finds_every_boundary(
    figures: Figures, code: int, plan: Path, tmp_path: Path, workers_are: Callable[[Figures], Asked]
) -> None:
    plan.write_text(BISECTION, encoding="utf-8")
    workers_are(figures)
    returned, out, errors = campaign(plan, "--out", tmp_path / "out")
    assert returned == code
    assert re.search(r"up to \d+ runs of mitl", errors)
    assert ("Half of the runs fail at" in out) is (code == 0)
    assert ("Runs pass along all of" in out) is (code == 1)


def test_a_scheduler_is_asked_with_its_certificates(
    plan: Path, tmp_path: Path, workers_are: Callable[[Figures], Asked]
) -> None:
    asked = workers_are(track)
    words = ("--tls-ca-file", "ca.pem", "--tls-cert", "own.pem", "--tls-key", "key.pem")
    _, _, errors = campaign(plan, "--out", tmp_path / "a", "--on", "tls://10.0.0.2:8786", *words)
    assert asked.there == [("tls://10.0.0.2:8786", None, TlsFiles("ca.pem", "own.pem", "key.pem"))]
    assert "not encrypted" not in errors
    assert "3 parallel runs on tls://10.0.0.2:8786, dashboard http://head:8787" in errors
    plan.write_text(PLAN.replace("recordings: none", "recordings: all"), encoding="utf-8")
    _, _, errors = campaign(plan, "--out", tmp_path / "b", "--on", "tcp://10.0.0.2:8786")
    assert asked.there[1] == ("tcp://10.0.0.2:8786", tmp_path / "b", TlsFiles())
    assert "tcp://10.0.0.2:8786 is not encrypted" in errors


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--on", "tls://a:1", "--workers", "2"), "--workers is for this machine and --on for another scheduler"),
        (("--tls-cert", "own.pem"), "--tls-ca-file, --tls-cert and --tls-key apply to --on only"),
    ],
)
def test_options_that_do_not_belong_together(words: tuple[str, ...], said: str, plan: Path) -> None:
    from xitl_cli.errors import UserError

    with pytest.raises(UserError, match=re.escape(said)):
        campaign(plan, *words)


def test_more_runs_than_many_need_consent(
    plan: Path, tmp_path: Path, workers_are: Callable[[Figures], Asked], monkeypatch: pytest.MonkeyPatch
) -> None:
    from xitl_cli.errors import UserError

    asked = workers_are(track)
    monkeypatch.setattr(command, "MANY", 12)
    campaign(plan, "--out", tmp_path / "twelve")  # not more than that
    monkeypatch.setattr(command, "MANY", 11)
    with pytest.raises(UserError, match=re.escape(f"has 12 runs (3 of {WIND} × 4 seeds); add --yes to run them all")):
        campaign(plan, "--out", tmp_path / "asked")
    assert len(asked.here) == 1
    campaign(plan, "--out", tmp_path / "yes", "--yes")
    assert len(asked.here) == 2
    plan.write_text(PLAN + f"constraints: [{WIND} < 9]\n", encoding="utf-8")
    questions: list[str] = []
    for answer in (False, True):
        monkeypatch.setattr(command, "sys", SimpleNamespace(stdin=SimpleNamespace(isatty=lambda: True)))
        monkeypatch.setattr(command.typer, "confirm", lambda text, answer=answer, **_: questions.append(text) or answer)
        if answer:
            campaign(plan, "--out", tmp_path / "confirmed")
        else:
            with pytest.raises(UserError, match="nothing was run; use fewer values"):
                campaign(plan, "--out", tmp_path / "declined")
    assert len(asked.here) == 3
    assert questions[0].endswith(f"has up to 12 runs (3 of {WIND} × 4 seeds). Run them all?")


@pytest.fixture
def measured(monkeypatch: pytest.MonkeyPatch) -> None:
    from xitl_cli.plugins.campaign.estimate import RunCost

    monkeypatch.setattr(
        "xitl_cli.plugins.campaign.estimate.run_cost", lambda plan, folders: RunCost(10.0, 1e6, "a measurement")
    )


@pytest.mark.usefixtures("measured")
def test_a_dry_run_lists_the_first_runs_and_counts_the_others(plan: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan.write_text(PLAN.replace("1-4", "1-10"), encoding="utf-8")
    code, out, _ = campaign(plan, "--dry-run", "--workers", "4")
    assert code == 0
    rows = [line.split() for line in out.splitlines() if re.fullmatch(r" *\d+ +\d+ +\d+", line)]
    assert rows == [[str(n + 1), str(4 * (n // 10)), str(n % 10 + 1)] for n in range(20)]
    text = " ".join(out.split())
    assert f"10 more; 30 runs in total. A run passes if: {TRACK} < 3" in text
    assert f"the first run: xitl sim mitl --set {WIND}=0 --seed 1" in text
    assert "wall time: about 1 min 20 s with 4 parallel runs" in text  # eight rounds of 10 s
    assert "search" not in text
    monkeypatch.setattr(command, "MANY", 25)
    assert "10 more; 30 runs in total" in " ".join(campaign(plan, "--dry-run")[1].split())


@pytest.mark.usefixtures("measured")
def test_a_dry_run_of_few_runs_and_of_a_search(plan: Path) -> None:
    text = " ".join(campaign(plan, "--dry-run")[1].split())
    assert "more; " not in text
    assert "12 runs in total." in text
    rows = [json.loads(line) for line in campaign(plan, "--dry-run", "--json")[1].splitlines()]
    assert [(row["number"], row[WIND], row["seed"]) for row in rows[:5]] == [
        (1, 0, 1),
        (2, 0, 2),
        (3, 0, 3),
        (4, 0, 4),
        (5, 4, 1),
    ]
    assert rows[4]["command"] == f"xitl sim mitl --set {WIND}=4 --seed 1"
    assert len(rows) == 12
    plan.write_text(BISECTION, encoding="utf-8")
    text = " ".join(campaign(plan, "--dry-run")[1].split())
    assert re.search(r"the first round of a search of up to \d+ runs; its verdicts determine the next rounds", text)


def test_two_campaigns_are_compared(plan: Path, tmp_path: Path, workers_are: Callable[[Figures], Asked]) -> None:
    for name, more_m in (("a", 0.0), ("b", 1.0)):
        workers_are(
            lambda values, seed, more_m=more_m: {
                **track(values, seed),
                TRACK: track(values, seed)[TRACK] + more_m + 0.01 * seed * more_m,
            }
        )
        campaign(plan, "--out", tmp_path / name)
    page = tmp_path / "page.html"
    code, out, _ = campaign("compare", tmp_path / "a", tmp_path / "b", "--report", page)
    assert code == 0
    text = " ".join(out.split())
    assert f"{TRACK} is higher in B by 1.025 m on average" in text
    assert "over 12 pairs of 4 seeds" in text
    assert f"Plots: {page}" in text
    assert "Comparison" in page.read_text(encoding="utf-8")
    told = json.loads(campaign("compare", tmp_path / "a", tmp_path / "b", "--json", "--confidence", "0.9")[1])
    assert list(told) == ["compare1"]
    assert "(90 % interval" in json.dumps(told, ensure_ascii=False)
    told = json.loads(campaign("compare", tmp_path / "a", "--by", WIND, "--json")[1])
    assert [section["title"] for section in told.values()] == [
        "mean_mps = 4 against mean_mps = 0",
        "mean_mps = 8 against mean_mps = 0",
    ]


@pytest.mark.parametrize("words", [("b",), ()])
def test_a_comparison_needs_a_folder_or_an_axis(words: tuple[str, ...]) -> None:
    from xitl_cli.errors import UserError

    by = ("--by", WIND) if words else ()
    with pytest.raises(UserError, match="give either a second folder, or --by"):
        campaign("compare", "a", *words, *by)
