"""Figures of the latency measurement from times that are known, and a short one of this machine without its times."""

from __future__ import annotations

import json
import os
from math import ceil
from pathlib import Path
from typing import Any

import pytest

from agent.board import doctor, latency
from agent.board.latency import (
    BARE,
    FIFO,
    OTHER,
    XITL,
    LatencyError,
    LatencyPlan,
    held_rate,
    holds_all,
    lateness_row,
    measure,
    measure_link,
    quantiles_us,
    report_text,
)
from tests.patience import wait_until

QUICK_S = 0.1


def row(scheduling: str, load: bool, rate_hz: float, late_us: list[float], loop: str = XITL) -> dict[str, Any]:
    figures = lateness_row([round(value * 1e3) for value in late_us], rate_hz)
    return {"scheduling": scheduling, "load": load, "loop": loop, "rate_hz": rate_hz, **figures}


def test_quantiles_are_measured_values() -> None:
    figures = quantiles_us([1000 * value for value in range(2000, 0, -1)])
    assert (figures["samples"], figures["worst_us"]) == (2000, 2000.0)
    assert (figures["p50_us"], figures["p99_us"], figures["p999_us"]) == (1000.0, 1980.0, 1998.0)
    assert sum(figures["histogram"]) == 2000


def test_few_values_give_the_worst_for_a_high_quantile() -> None:
    figures = quantiles_us([3000, 1000, 2000])
    assert (figures["p50_us"], figures["p999_us"], figures["worst_us"]) == (2.0, 3.0, 3.0)


def test_no_values_give_no_quantiles() -> None:
    figures = quantiles_us([])
    assert (figures["samples"], figures["p50_us"], figures["worst_us"]) == (0, None, None)


@pytest.mark.parametrize(("late_us", "holds"), [(624.0, True), (625.0, False), (900.0, False)])
def test_a_rate_is_held_below_a_quarter_of_its_period(late_us: float, holds: bool) -> None:
    assert row(FIFO, False, 400.0, [late_us])["holds"] is holds


def test_one_late_start_of_two_thousand_does_not_count() -> None:
    assert row(FIFO, False, 400.0, [10.0] * 1999 + [9000.0])["holds"]


def test_the_best_scheduling_in_every_load_decides() -> None:
    rows = [
        row(OTHER, False, 400.0, [5000.0]),
        row(OTHER, True, 400.0, [9000.0]),
        row(FIFO, False, 400.0, [20.0]),
        row(FIFO, True, 400.0, [100.0]),
        row(FIFO, True, 400.0, [9000.0], BARE),
        row(FIFO, True, 50.0, [9000.0]),
    ]
    rate = held_rate(rows, 400.0)
    assert (rate["holds"], rate["scheduling"], rate["limit_us"]) == (True, FIFO, 625.0)
    assert (rate["p999_us"], rate["worst_us"], rate["highest_rate_hz"]) == (100.0, 100.0, 2500.0)
    rows[3] = row(FIFO, True, 400.0, [700.0])
    assert not held_rate(rows, 400.0)["holds"]
    assert not held_rate(rows[:2], 400.0)["holds"]
    assert held_rate(rows[:2], 400.0)["scheduling"] == OTHER


@pytest.mark.parametrize(
    ("rates_hz", "duration_s", "expected"),
    [((), 1.0, "rates"), ((0.5,), 1.0, "rates"), ((400.0, 1e5), 1.0, "rates"), ((400.0,), 0.0, "duration")],
)
def test_what_cannot_be_measured_is_refused(rates_hz: tuple[float, ...], duration_s: float, expected: str) -> None:
    with pytest.raises(LatencyError, match=expected):
        LatencyPlan(rates_hz, duration_s)


def check_report(report: dict[str, Any], plan: LatencyPlan) -> None:
    schedulings = {OTHER, FIFO} if report["fifo"]["permitted"] else {OTHER}
    loads = {False, True} if plan.loaded else {False}
    conditions = {(scheduling, load) for scheduling in schedulings for load in loads}
    assert {(link["scheduling"], link["load"]) for link in report["links"]} == conditions
    for scheduling, load in conditions:
        for rate_hz in plan.rates_hz:
            rows = [
                loop
                for loop in report["loops"]
                if (loop["scheduling"], loop["load"], loop["rate_hz"]) == (scheduling, load, rate_hz)
            ]
            assert [loop["loop"] for loop in rows] in ([XITL, BARE], [XITL])
            for loop in rows:
                assert loop["samples"] == sum(loop["histogram"]) == ceil(plan.duration_s * rate_hz)
                assert 0.0 <= loop["p50_us"] <= loop["p99_us"] <= loop["p999_us"] <= loop["worst_us"]
    for link in report["links"]:
        assert link["samples"] + link["lost"] == ceil(plan.duration_s * latency.EXCHANGE_HZ)
        assert link["clock"]["offset_bound_us"] >= 0.0
    assert [rate["rate_hz"] for rate in report["rates"]] == list(plan.rates_hz)
    assert bool(report["fifo"]["problem"]) != report["fifo"]["permitted"]


@pytest.mark.slow
def test_a_measurement_of_this_machine() -> None:
    plan = LatencyPlan((200.0, 50.0), QUICK_S, loaded=True)
    told: list[str] = []
    report = measure(plan, told.append)
    check_report(report, plan)
    assert f"{OTHER}, under load" in told
    assert json.loads(json.dumps(report)) == report
    text = report_text(report)
    assert max(map(len, text.splitlines())) <= latency.WIDTH
    assert "rule: p99.9 of start lateness below 1/4 of the period" in text


@pytest.mark.medium
def test_without_permission_it_says_so_and_measures_the_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    sentence = "no SCHED_FIFO at priority 50 (Operation not permitted); start as root"
    monkeypatch.setattr(latency, "schedule", lambda priority: sentence)
    plan = LatencyPlan((100.0,), QUICK_S)
    report = measure(plan)
    check_report(report, plan)
    assert report["fifo"] == {"permitted": False, "priority": 0, "problem": sentence}
    assert {loop["scheduling"] for loop in report["loops"]} == {OTHER}
    assert sentence in " ".join(report_text(report).split())


@pytest.mark.medium
def test_a_system_without_clock_nanosleep_measures_its_own_loop(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(latency, "absolute_sleep", lambda: None)
    rows = list(latency.measure_loops((100.0,), QUICK_S))
    assert [loop["loop"] for loop in rows] == [XITL]


def test_an_address_without_an_agent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(latency, "START_S", 0.0)
    monkeypatch.setattr(latency, "ANSWER_S", 0.05)
    with pytest.raises(LatencyError, match="no agent answers; start one there"):
        measure_link("udp://127.0.0.1:9", QUICK_S)
    with pytest.raises(LatencyError, match="nowhere"):
        measure_link("nowhere://x", QUICK_S)


@pytest.mark.medium
def test_an_agent_at_an_address() -> None:
    with latency.agent_process(0) as url:
        link = measure_link(url, QUICK_S)
    assert (link["agent"], link["scheduling"], link["load"]) == (url, OTHER, False)


def test_after_fifo_the_scheduling_is_as_before() -> None:
    before = os.sched_getscheduler(0)
    if latency.fifo_problem():
        with pytest.raises(LatencyError, match="no SCHED_FIFO"), latency.scheduled(50):
            pass
    else:
        with latency.scheduled(50):
            assert os.sched_getscheduler(0) == os.SCHED_FIFO
    assert os.sched_getscheduler(0) == before


@pytest.mark.medium
def test_the_load_ends_with_its_context() -> None:
    with latency.load() as count:
        assert 1 <= count <= latency.MOST_LOADS
        # A process shows its command only some time after its start.
        wait_until(lambda: len(load_processes()) == count, "no processes of the load")
    assert not load_processes()


def load_processes() -> list[Path]:
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = path.read_bytes()
            of = (path.parent / "stat").read_text().split(") ")[-1].split()[1]
        except OSError:  # it has ended
            continue
        if b"block = bytearray(" in words and of == parent():
            found.append(path)
    return found


def parent() -> str:
    return Path("/proc/self/stat").read_text().split()[0]


@pytest.mark.slow
def test_the_doctor_of_a_board_prints_it(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--latency", "--rate", "100", "--duration", str(QUICK_S)]
    code = doctor.main([*words, "--json"], "xitl-agent.pyz doctor")
    report = json.loads(capsys.readouterr().out)
    check_report(report, LatencyPlan((100.0,), QUICK_S))
    assert code == (0 if holds_all(report) else 1)
    doctor.main([*words, "--for-host"], "xitl-agent.pyz doctor")
    answer = json.loads(capsys.readouterr().out.partition(doctor.MARK)[2])
    assert set(answer["latency"]) == set(report)


def test_the_doctor_of_a_board_refuses_what_cannot_be_measured(capsys: pytest.CaptureFixture[str]) -> None:
    assert doctor.main(["--latency", "--rate", "0", "--for-host"], "x") == 2
    told = capsys.readouterr()
    assert "use rates from 1 to 10000 Hz" in json.loads(told.out.partition(doctor.MARK)[2])["error"]
    assert told.err.startswith("error: rates")
