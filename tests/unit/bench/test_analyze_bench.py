"""The benchmark of `analyze` without its runs: cases, scores, tables. One case of it as a slow test."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.bench import analyze
from tests.bench.analyze_cases import Case, ardupilot_cases, cases
from tests.bench.analyze_scores import NONE, Named, Outcome, Scores, confusion_table, score_table, scores
from tests.bench.results import FULL, TINY, this_run
from xitl_cli.logs.clocks.time_line import TimeLine
from xitl_cli.logs.model.log import LogHealth
from xitl_cli.logs.model.sections import Finding, Section
from xitl_cli.logs.report.file_report import FileReport
from xitl_cli.logs.report.model import Report
from xitl_cli.profile import load_profile

RIGHT = Named("gnss.silent", 30.4, right=True)
WRONG = Named("control.too_slow", 31.0, right=False)
FAULTY = Outcome("gnss-loss", "GNSS", 1, 30.0, (RIGHT,), True, ())
CLEAN = Outcome("otter/current-waves", NONE, 1, None, (), False, ())


def size(case: Case) -> dict[str, Any]:
    """The fault of a case without its times."""
    fault = case.document.get("faults", {}).get("injected", {})
    return {key: value for key, value in fault.items() if key not in ("from_s", "until_s")}


def report_of(finding: Finding) -> Report:
    section = Section("control", "Control", findings=(finding,))
    health, line = LogHealth(1, 1), TimeLine(0)
    return Report((FileReport("a.bin", Path("a.bin"), "dataflash", "boot", (0, 10**11), health, {}, (section,), line),))


@pytest.mark.medium
def test_the_cases_of_a_seed_repeat_and_those_of_another_differ() -> None:
    one, again, other = list(cases(1)), list(cases(1)), list(cases(2))
    assert one == again
    assert [case.group for case in one] == [case.group for case in other]
    faulty = [number for number, case in enumerate(one) if case.onset_s is not None]
    assert all(one[number].document != other[number].document for number in faulty)
    assert len({case.run_name for case in one}) == len(one)


def test_a_fault_begins_at_its_onset_and_has_a_drawn_size() -> None:
    drift = next(case for case in cases(3) if case.name == "gnss-drift")
    fault = drift.document["faults"]["injected"]
    assert fault["from_s"] == drift.onset_s
    assert fault["until_s"] > fault["from_s"]
    assert 0.3 <= fault["gnss"]["drift_mps"] <= 0.8


@pytest.mark.medium
def test_a_case_with_ardupilot_has_the_group_and_the_size_of_its_embedded_twin() -> None:
    embedded = {case.name: case for case in cases(4)}
    for case in ardupilot_cases(4):
        assert case.document["extends"][0] == "sitl-ardupilot-ahrs"
        if case.group == NONE:
            continue
        twin = embedded[case.name.removeprefix("ardupilot/")]
        assert case.group == twin.group
        assert size(case) == size(twin)


def test_clean_runs_with_ardupilot_have_the_parameters_of_their_vessel() -> None:
    clean = [case for case in ardupilot_cases(4) if case.group == NONE]
    assert clean
    for case in clean:
        vehicle = case.name.split("/")[1]
        assert f"vehicles/{vehicle}" in case.document["extends"]
        assert f"rover-{vehicle}" in case.document["autopilot"]["parameter_files"]
        assert case.causes == ()


def test_a_permitted_fine_finding_is_no_contradiction() -> None:
    case = next(case for case in cases(4) if case.name == "waves-too-high")
    report = report_of(Finding.ok("control.followed", "It followed its setpoints"))
    assert analyze.judge(case, report, case.causes).contradictions == ()
    strict = replace(case, fine=())
    assert analyze.judge(strict, report, case.causes).contradictions == ("control.followed",)


@pytest.mark.slow
def test_every_case_is_a_profile_of_xitl(tmp_path: Path) -> None:
    for case in (*cases(1), *ardupilot_cases(1)):
        path = tmp_path / f"{case.run_name}.yaml"
        path.write_text(yaml.safe_dump(dict(case.document)), encoding="utf-8")
        assert load_profile(str(path)).clock is not None, case.name


def test_a_right_answer_on_faults_and_none_on_clean_runs_score_full() -> None:
    assert scores([FAULTY, CLEAN]) == Scores(2, 1.0, 1.0, 1.0, pytest.approx(0.4), pytest.approx(0.4), 0)


def test_a_wrong_cause_costs_precision_and_at_the_top_accuracy() -> None:
    below, above = replace(FAULTY, named=(RIGHT, WRONG)), replace(FAULTY, named=(WRONG, RIGHT))
    assert (scores([below]).recall, scores([below]).precision, scores([below]).accuracy) == (1.0, 0.5, 1.0)
    assert (scores([above]).recall, scores([above]).precision, scores([above]).accuracy) == (1.0, 0.5, 0.0)


def test_a_missed_fault_costs_recall_and_a_false_alarm_precision() -> None:
    missed, alarmed = replace(FAULTY, named=()), replace(CLEAN, named=(WRONG,))
    assert scores([FAULTY, missed]).recall == 0.5
    assert scores([FAULTY, alarmed]).precision == 0.5
    assert scores([missed]).onset_median_s is None


def test_a_permitted_effect_is_neither_right_nor_wrong() -> None:
    effect = replace(WRONG, effect=True)
    assert scores([replace(FAULTY, named=(RIGHT, effect))]).precision == 1.0
    assert scores([replace(FAULTY, named=(effect,))]).recall == 0.0


def test_tables_have_a_row_for_each_group() -> None:
    outcomes = [FAULTY, replace(FAULTY, seed=2, named=(WRONG,), contradictions=("control.followed",)), CLEAN]
    assert score_table(outcomes).splitlines()[2:] == [
        "| GNSS | 2 | 0.50 | 0.50 | 0.50 | 0.40 s | 0.40 s | 1 |",
        "| none | 1 | – | – | – | – | – | 0 |",
        "| all | 3 | 0.50 | 0.50 | 0.50 | 0.40 s | 0.40 s | 1 |",
    ]
    groups = {"gnss.silent": "GNSS", "control": "weather"}
    assert confusion_table(outcomes, groups).splitlines() == [
        "| cause \\ named | GNSS | weather | other | none |",
        "| --- | --- | --- | --- | --- |",
        "| GNSS | 1 | 1 |  |  |",
        "| none |  |  |  | 1 |",
    ]


@pytest.mark.medium
def test_a_stopped_measurement_continues_in_its_file(tmp_path: Path) -> None:
    run = replace(this_run(FULL), changed=False)
    file = analyze.ResultsFile(tmp_path / "deep" / "x.jsonl")
    file.begin(run)
    file.add({analyze.BOTH: CLEAN, analyze.OWN_LOG: CLEAN})
    file.begin(replace(run, date_utc="later"))
    file.add({analyze.BOTH: FAULTY, analyze.OWN_LOG: replace(FAULTY, named=())})
    assert file.read() == analyze.AnalyzeResults(
        run, {analyze.BOTH: [FAULTY, CLEAN], analyze.OWN_LOG: [replace(FAULTY, named=()), CLEAN]}
    )


@pytest.mark.medium
def test_results_of_another_commit_are_not_mixed(tmp_path: Path) -> None:
    run = replace(this_run(FULL), changed=False)
    file = analyze.ResultsFile(tmp_path / "x.jsonl")
    file.begin(run)
    with pytest.raises(ValueError, match="give another --out"):
        file.begin(replace(run, commit="0" * 40))
    changed = analyze.ResultsFile(tmp_path / "changed.jsonl")
    changed.begin(replace(run, changed=True))
    changed.add({analyze.BOTH: CLEAN, analyze.OWN_LOG: CLEAN})
    changed.begin(replace(run, changed=True))
    assert changed.read().outcomes[analyze.BOTH] == []


def test_results_of_some_cases_are_not_kept(tmp_path: Path) -> None:
    file = analyze.ResultsFile(tmp_path / "x.jsonl")
    file.begin(this_run(TINY))
    with pytest.raises(ValueError, match="tiny"):
        analyze.keep(file)


@pytest.mark.medium
@pytest.mark.parametrize("name", ["gnss-loss", "ardupilot/gnss-loss"])
def test_kept_results_of_one_autopilot_leave_those_of_the_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    page = tmp_path / "logs.md"
    page.write_text(f"{analyze.BEGIN}\n\nold\n\n{analyze.END}")
    monkeypatch.setattr(analyze, "PAGE", page)
    paths = {"gnss-loss": tmp_path / "kept.jsonl", "ardupilot/gnss-loss": tmp_path / "kept_ardupilot.jsonl"}
    monkeypatch.setattr(analyze, "KEPT", paths["gnss-loss"])
    monkeypatch.setattr(analyze, "KEPT_ARDUPILOT", paths["ardupilot/gnss-loss"])
    run = replace(this_run(FULL), changed=False)
    for case in paths:
        results = analyze.ResultsFile(tmp_path / "measured.jsonl")
        results.path.unlink(missing_ok=True)
        results.begin(run)
        results.add(dict.fromkeys((analyze.BOTH, analyze.OWN_LOG), replace(FAULTY, case=case)))
        analyze.keep(results)
    assert analyze.ResultsFile(paths[name]).read().outcomes[analyze.BOTH] == [replace(FAULTY, case=name)]
    text = page.read_text()
    assert text.count("| all | 1 | 1.00 |") == 4  # of each autopilot, from both files and from its log
    assert "with a stock ArduPilot" in text


@pytest.mark.medium
def test_the_tables_of_the_page_are_those_of_the_kept_results() -> None:
    """Write them with `python -m tests.bench.analyze --keep FILE`."""
    stored = analyze.PAGE.read_text(encoding="utf-8")
    assert analyze.with_tables(stored, analyze.kept_tables()) == stored


def test_a_page_without_a_place_is_refused() -> None:
    with pytest.raises(ValueError, match="has no place for the tables"):
        analyze.with_tables("# Page\n", "x")


@pytest.mark.nightly
@pytest.mark.slow
def test_the_benchmark_names_the_cause_of_a_simulated_fault(tmp_path: Path) -> None:
    only = [word for name in ("barometer-step", "gnss-loss", "blueboat") for word in ("--only", name)]
    out = tmp_path / "x.jsonl"
    assert analyze.main(["--seeds", "1", *only, "--runs", str(tmp_path), "--out", str(out)]) == 0
    results = analyze.ResultsFile(out).read()
    assert results.run.sizes == TINY
    for outcomes in results.outcomes.values():
        assert [outcome.case for outcome in outcomes] == ["gnss-loss", "barometer-step", "blueboat/current-waves"]
        assert [outcome.detected for outcome in outcomes] == [True, True, False]
        assert all(outcome.onset_error_s is not None and outcome.onset_error_s < 1.0 for outcome in outcomes[:2])
