from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from xitl_cli.errors import UserError
from xitl_cli.experiments import departure
from xitl_cli.experiments.departure import (
    ENVIRONMENTS,
    EVENTS,
    InterruptedRunError,
    compare_departures,
    measure_departures,
    table_json,
)
from xitl_cli.run.session import Result

TIMES = dict(zip(EVENTS, (12.0, 20.0, 20.5, 21.25), strict=True))


def runs(seen: list[Any], **changed: Any) -> Callable[..., Result]:
    """In place of a run: notes the profile, and with our sensors all is 5 s sooner."""

    def make_run(profile: Any, out: Path, overwrite: bool, make_display: Any) -> Result:
        seen.append((profile.runnable(), out, overwrite))
        ours = profile.autopilot.bridge.sensors is not None
        times = {event: at_s - 5.0 * ours for event, at_s in TIMES.items()}
        summary = {"error": None, "autopilot": {"firmware": "4.7.0", **times}, **changed}
        return Result(summary, out, 0)

    return make_run


def test_six_runs_that_differ_in_environment_and_sensors_alone(tmp_path: Path) -> None:
    seen: list[Any] = []
    departures = measure_departures(tmp_path, "/opt/ardurover", seed=7, duration_s=90.0, make_run=runs(seen))

    assert [(one.environment, one.sensors) for one in departures] == [
        (environment, sensors) for environment in ENVIRONMENTS for sensors in ("own", "ours")
    ]
    for (profile, out, overwrite), one in zip(seen, departures, strict=True):
        assert profile.environment.current.speed_mps == (0.0 if one.environment == "calm" else 0.5)
        assert profile.environment.wind.mean_mps == (5.0 if one.environment == "current-waves-gusts" else 0.0)
        assert profile.autopilot.bridge.sensors == (None if one.sensors == "own" else "vectornav")
        assert not profile.autopilot.moored_until_armed
        assert (profile.clock.seed, profile.clock.duration_s, profile.autopilot.firmware) == (7, 90.0, "/opt/ardurover")
        assert (out, overwrite) == (tmp_path / f"{one.environment}-{one.sensors}", False)
        assert Path(one.profile).is_file()


def test_the_difference_is_ours_less_own(tmp_path: Path) -> None:
    rows = compare_departures(measure_departures(tmp_path, make_run=runs([])))
    assert len(rows) == len(ENVIRONMENTS) * len(EVENTS)
    assert {row.difference_s for row in rows} == {-5.0}


def test_what_did_not_happen_has_no_difference(tmp_path: Path) -> None:
    never: dict[str, Any] = {"autopilot": {"firmware": "4.7.0"}, "error": "gave up"}
    departures = measure_departures(tmp_path, make_run=runs([], **never))
    assert departures[0].problem == "gave up"
    assert all(row.own_s is None and row.difference_s is None for row in compare_departures(departures))
    json.dumps(table_json(departures), allow_nan=False)


def test_an_interrupted_run_ends_all(tmp_path: Path) -> None:
    with pytest.raises(InterruptedRunError):
        measure_departures(tmp_path, make_run=lambda *given: Result({}, tmp_path, 130))


def test_a_place_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "taken").write_text("")
    with pytest.raises(UserError, match="choose another --out"):
        measure_departures(tmp_path / "taken" / "deeper", make_run=runs([]))


def test_a_profile_of_somebody_s_own_is_not_written_over(tmp_path: Path) -> None:
    own = tmp_path / "calm-own.yaml"
    own.write_text("extends: sitl\n")
    with pytest.raises(UserError, match=r"calm-own.yaml: exists, and is another profile; .* --overwrite"):
        measure_departures(tmp_path, make_run=runs([]))
    assert own.read_text() == "extends: sitl\n"
    measure_departures(tmp_path, overwrite=True, make_run=runs([]))
    measure_departures(tmp_path, make_run=runs([]))  # its own from an earlier time are fine


def invoke(monkeypatch: pytest.MonkeyPatch, make_run: Callable[..., Result], *words: str) -> tuple[int, str]:
    from xitl_cli.main import _app

    monkeypatch.setattr(
        departure.measure_departures, "__defaults__", (*departure.measure_departures.__defaults__[:-1], make_run)
    )
    result = CliRunner().invoke(_app(), ["paper", "4.2", *words])
    assert result.exception is None or isinstance(result.exception, SystemExit)
    return result.exit_code, result.stdout


def test_the_table(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code, out = invoke(monkeypatch, runs([]), "--out", str(tmp_path))
    assert code == 0
    assert "current, waves and gusts" in out
    motion = [line.split() for line in out.splitlines() if "motion starts" in line and "m/s" not in line]
    assert motion[-1][-6:] == ["21.2", "s", "16.2", "s", "-5.0", "s"]
    assert json.loads((tmp_path / "table.json").read_text())["section"] == "4.2"


def test_the_table_for_programs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    code, out = invoke(monkeypatch, runs([], autopilot=None), "--out", str(tmp_path), "--json")
    assert code == 1
    read = json.loads(out)
    assert len(read["rows"]) == 12
    assert read["rows"][0] == {
        "environment": "calm",
        "event": "time_to_origin_s",
        "own_s": None,
        "ours_s": None,
        "difference_s": None,
    }
