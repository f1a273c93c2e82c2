"""`xitl identify`: tables with a map of columns, files that it writes, sensors, and the script of the manoeuvres."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from pool import COLUMNS, SHIP_COLUMNS, boat, pool_run, write_ship_table, write_table

pytest.importorskip("scipy")

from xitl_cli.errors import UserError
from xitl_cli.main import main
from xitl_cli.plugins.identify.identification_page import findings
from xitl_cli.plugins.identify.prediction import Score
from xitl_cli.plugins.identify.sensors import SensorEstimate, SensorValue, sensors_text
from xitl_cli.plugins.identify.table_recording import read_column_map, read_table
from xitl_cli.profile import load_profile, load_with_origins

ROOT = Path(__file__).parents[4]


def identify(monkeypatch: pytest.MonkeyPatch, *arguments: str | Path) -> int:
    monkeypatch.setattr("sys.argv", ["xitl", "identify", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        main()
    return int(ended.value.code or 0)


@pytest.fixture
def columns(tmp_path: Path) -> Path:
    path = tmp_path / "columns.yaml"
    path.write_text(COLUMNS, encoding="utf-8")
    return path


def test_a_table_becomes_the_recording_that_wrote_it(tmp_path: Path, columns: Path) -> None:
    run = pool_run(boat(), 30.0, noise=0.0)
    read = read_table(write_table(run, tmp_path / "run.csv"), read_column_map(columns))
    at_s = np.arange(5.0, 25.0, 0.1)
    assert np.abs(read.motion_at(at_s) - run.motion_at(at_s)).max() < 0.02
    assert np.abs(read.mean_commands(np.arange(5.0, 25.0)) - run.mean_commands(np.arange(5.0, 25.0))).max() < 0.1


def test_commands_of_a_table(tmp_path: Path, columns: Path) -> None:
    text = "t,psi,x,y,r,left,right\n" + "".join(f"{n},0,0,0,0,1700,1480\n" for n in range(30))
    (tmp_path / "run.csv").write_text(text, encoding="utf-8")
    kinds = COLUMNS.replace("left, neutral: 1500, full: 1900", "left, neutral: 1500, full: 1900, law: thrust")
    kinds = kinds.replace("right, neutral: 1500, full: 1900", "right, neutral: 1500, full: 1100, dead: 10")
    columns.write_text(kinds, encoding="utf-8")
    commands = read_table(tmp_path / "run.csv", read_column_map(columns)).commands
    assert commands[0] == pytest.approx([np.sqrt(0.5), 0.05])


def test_the_wind_of_a_table(tmp_path: Path, columns: Path) -> None:
    text = "t,psi,x,y,r,left,right,speed,from\n"
    text += "".join(f"{n},0,0,0,0,1500,1500,{5 + n},{359 + 2 * (n % 2)}\n" for n in range(30))
    (tmp_path / "run.csv").write_text(text, encoding="utf-8")
    wind = "wind_speed: {column: speed, unit: m/s}\nwind_from: {column: from, unit: deg}\n"
    columns.write_text(COLUMNS + wind, encoding="utf-8")
    blown = read_table(tmp_path / "run.csv", read_column_map(columns)).wind_at(np.array([[0.0, 1.0], [1.5, 2.0]]))
    assert blown[0] == pytest.approx(np.array([[-5.0, 0.0873], [-6.0, -0.1047]]), abs=1e-3)  # from the north
    assert blown[1, 0] == pytest.approx([-6.5, 0.0087], abs=1e-3)
    columns.write_text(COLUMNS + wind.replace("unit: m/s", "unit: m/s, reversed: true"), encoding="utf-8")
    with pytest.raises(UserError, match="column 'speed' has speeds from -34 to -5 m/s; correct the unit"):
        read_table(tmp_path / "run.csv", read_column_map(columns))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("column: psi, unit: deg", "column: yaw, unit: deg"), "has no column 'yaw'; its columns are t, psi"),
        (("unit: deg/s", "unit: degrees"), "unit"),
        (("north: {column: x, unit: m}\n", ""), "north"),
        (("psi, unit: deg", "psi, unit: m/s"), "yaw.unit = m/s is no unit of yaw; write rad or deg"),
        (("yaw_rate:", "wind_from: {column: psi, unit: deg}\nyaw_rate:"), "wind_speed and wind_from belong together"),
        (("full: 1900", "full: 1500"), "equals neutral"),
        (
            ("neutral: 1500, full: 1900", "neutral: 0, full: 1"),
            "100 % of column 'left' are beyond full (median 1597.2, neutral 0, full 1); correct neutral and full",
        ),
    ],
)
def test_a_wrong_map(tmp_path: Path, columns: Path, change: tuple[str, str], words: str) -> None:
    columns.write_text(COLUMNS.replace(*change, 1), encoding="utf-8")
    with pytest.raises(UserError, match=re.escape(words)):
        read_table(write_table(pool_run(boat(), 25.0), tmp_path / "run.csv"), read_column_map(columns))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("t,psi\n1,2\n", "has 1 rows of data"),
        ("t,psi,x,y,r,left,right\n0,0,0,0,0,1500,1500\n1,2\n2,2\n", "run.csv:3: has 2 cells, but the first row has 7"),
        (
            "t,psi,x,y,r,left,right\n0,0,0,0,0,1500,1500\n1,0,nan,0,0,1500,1500\n2,,0,0,0,1500,1500\n",
            "run.csv:3: column 'x' is 'nan'; write a finite number, or leave the cell empty",
        ),
        (
            "t,psi,x,y,r,left,right\n0,0,0,0,0,1500,1500\n1,0,inf,0,0,1500,1500\n2,,0,0,0,1500,1500\n",
            "run.csv:3: column 'x' is 'inf'; write a finite number, or leave the cell empty",
        ),
        ("t,psi,x,y,r,left,right\n1,0,0,0,0,1,1\n2,0,0,0,0,1,1\n0,0,0,0,0,1,1\n", "goes from 2 s back to 0 s in row 4"),
    ],
)
def test_a_wrong_table(tmp_path: Path, columns: Path, text: str, words: str) -> None:
    (tmp_path / "run.csv").write_text(text, encoding="utf-8")
    with pytest.raises(UserError, match=re.escape(words)):
        read_table(tmp_path / "run.csv", read_column_map(columns))


@pytest.mark.slow
def test_a_file_of_the_vehicle_and_a_page(
    tmp_path: Path, columns: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    table = write_table(pool_run(boat(), 130.0), tmp_path / "run.csv")
    out, page = tmp_path / "mine.yaml", tmp_path / "page.html"
    arguments = ("vessel", table, "--columns", columns, "--vehicle", "vehicles/asv-third", "--no-wind")
    changed = ("--set", "vehicle.damping_linear.yaw=0.8", "--free", "damping_linear.yaw", "--out", out)
    assert identify(monkeypatch, *arguments, *changed, "--report", page, "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert told["keys"]["damping_linear.yaw"]["value"] == pytest.approx(1.069, rel=0.05)
    errors = {(own["model"], own["horizon_s"]): own["yaw rate (rad/s)"] for own in told["scores"]}
    assert errors["identified", 5.0] < errors["linear", 5.0] < errors["persistence", 5.0]
    vehicle = load_profile(str(out)).vehicle
    assert vehicle is not None
    assert vehicle.damping_linear.yaw == pytest.approx(told["keys"]["damping_linear.yaw"]["value"])
    assert "extends: vehicles/asv-third\n" in out.read_text(encoding="utf-8")
    (tmp_path / "use.yaml").write_text("extends: [identify-excitation, mine.yaml]\n", encoding="utf-8")
    assert load_with_origins(str(tmp_path / "use.yaml")).runnable().vehicle == vehicle
    assert "Root mean square errors on the tested logs" in page.read_text(encoding="utf-8")
    assert identify(monkeypatch, *arguments, *changed) == 2
    assert "mine.yaml exists" in capsys.readouterr().err


@pytest.mark.nightly
@pytest.mark.slow
def test_a_ship_with_revolutions_rudder_and_wind_in_its_table(
    tmp_path: Path, columns: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    kvlcc2 = load_profile("vehicles/kvlcc2-l7").vehicle
    assert kvlcc2 is not None
    assert kvlcc2.mmg is not None
    columns.write_text(SHIP_COLUMNS, encoding="utf-8")
    table = write_ship_table(kvlcc2, tmp_path / "ship.csv", 400.0, 4)
    true = {f"mmg.derivatives.{name}": kvlcc2.mmg.derivatives[name] for name in ("N_v", "N_r")}
    true["mmg.r_0"] = kvlcc2.mmg.r_0
    changed = [part for key, value in true.items() for part in ("--set", f"vehicle.{key}={1.3 * value}", "--free", key)]
    arguments = ("vessel", table, "--columns", columns, "--vehicle", "vehicles/kvlcc2-l7", "--window", "30")
    assert identify(monkeypatch, *arguments, "--no-wind", *changed, "--json") == 0
    keys = json.loads(capsys.readouterr().out)["keys"]
    for key, value in true.items():
        assert keys[key]["value"] == pytest.approx(value, rel=0.05), key


def test_a_vehicle_that_predicts_no_better_than_persistence() -> None:
    def found(surge: float) -> list[str]:
        errors = {"identified": (surge, 0.1, 0.1), "linear": (0.2, 0.1, 0.1), "persistence": (0.2, 0.1, 0.1)}
        own = tuple(Score(model, 5.0, 9, (*values, 1.0, 1.0)) for model, values in errors.items())
        result = SimpleNamespace(keys=(), correlated=(), scores=own)
        return [finding.sentence for finding in findings(result)]  # type: ignore[arg-type]

    assert found(0.1) == []
    assert "a boat that keeps its velocity predicts as well: 0.19 m/s" in found(0.19)[0]


def test_a_table_without_a_map(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    table = write_table(pool_run(boat(), 25.0), tmp_path / "run.csv")
    assert identify(monkeypatch, "vessel", table, "--vehicle", "vehicles/asv-third") == 2
    assert "run.csv is a table; give --columns" in capsys.readouterr().err


def test_the_result_does_not_replace_the_vehicle_that_it_extends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    start = tmp_path / "boat.yaml"
    start.write_text("extends: vehicles/asv-third\n", encoding="utf-8")
    assert identify(monkeypatch, "vessel", "run.bin", "--vehicle", start, "--out", start, "--overwrite") == 2
    assert "is the vehicle to begin with" in capsys.readouterr().err


def test_a_log_without_outputs_or_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    log = ROOT / "tests/data"
    empty = tmp_path / "empty.bin"
    empty.write_bytes(b"")
    assert log.is_dir()
    assert identify(monkeypatch, "vessel", empty, "--vehicle", "vehicles/asv-third") == 2
    assert "empty.bin" in capsys.readouterr().err
    assert identify(monkeypatch, "sensors", empty) == 2
    assert "empty.bin" in capsys.readouterr().err


def test_the_sensors_block_is_a_part_of_a_profile(tmp_path: Path) -> None:
    values = (
        SensorValue("imu.rate_hz", 200.0, None),
        SensorValue("imu.gyro_noise_density_radpsprthz", 5e-5, 1e-6),
        SensorValue("gnss.latency_s", 0.12, 0.02, "a note"),
    )
    path = tmp_path / "mine.yaml"
    path.write_text("extends: sitl\n" + sensors_text(SensorEstimate(60.0, values, ()), "log.bin"), encoding="utf-8")
    sensors = load_profile(str(path)).sensors
    assert sensors is not None
    assert sensors.gnss is not None
    assert sensors.gnss.latency_s == pytest.approx(0.12)


def test_the_script_of_the_board_has_the_steps_of_the_profile() -> None:
    text = (ROOT / "firmware_params/lua/xitl_excitation.lua").read_text(encoding="utf-8")
    table = re.findall(r"^  \{ ([\d.]+), (-?[\d.]+), (-?[\d.]+) \},$", text, re.MULTILINE)
    driver = load_profile("identify-excitation").driver
    assert driver is not None
    steps = [step for step in driver.script if step.rc_us is not None]
    ends = [step.at_s for step in driver.script[2:]]
    assert len(table) == len(steps)
    for row, step, end_s in zip(table, steps, ends, strict=True):
        duration_s, steering, throttle = map(float, row)
        pulses = SimpleNamespace(steering=step.rc_us[0], throttle=step.rc_us[2])
        assert end_s - step.at_s == pytest.approx(duration_s)
        assert (pulses.steering, pulses.throttle) == (1500 + round(400 * steering), 1500 + round(400 * throttle))


@pytest.mark.slow
def test_sensors_of_a_run_at_rest(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from tests.recorded_run import recorded_run

    run = recorded_run(
        "identify-excitation",
        60.0,
        "environment.current.speed_mps=0",
        "driver.script=[{at_s: 0, mode: MANUAL, arm: true}]",
    )
    assert identify(monkeypatch, "sensors", run / "autopilot.bin", "--out", tmp_path / "s.yaml", "--json") == 0
    told = json.loads(capsys.readouterr().out)
    values = {own["key"]: own["value"] for own in told["sensors"]}
    assert values["imu.gyro_noise_density_radpsprthz"] == pytest.approx(4.9e-5, rel=0.05)
    assert values["imu.accel_noise_density_mps2prthz"] == pytest.approx(6.9e-4, rel=0.05)
    assert values["gnss.horizontal_noise_m"] == pytest.approx(0.15, rel=0.2)
    assert values["gnss.velocity_noise_mps"] == pytest.approx(0.05, rel=0.2)
    assert "gnss.latency_s" not in values
    assert any("latency" in lack for lack in told["lacks"])
