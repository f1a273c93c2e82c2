"""Remote control and outputs with troubles that were put there."""

from __future__ import annotations

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from xitl_cli.logs.model.codes import servo_function_name
from xitl_cli.logs.model.sections import Section, Severity
from xitl_cli.logs.signals import output_names
from xitl_cli.plugins.logs.analyses.radio import analyse

S = 1_000_000_000
ROWS = 1000
STAMPS = np.arange(ROWS) * S // 10


def parameters(**more: float) -> MadeTable:
    values = {"SERVO1_FUNCTION": 73.0, "SERVO1_MIN": 1000.0, "SERVO1_MAX": 2000.0, "SERVO1_TRIM": 1500.0,
              "SERVO3_FUNCTION": 74.0, "SERVO3_MIN": 1000.0, "SERVO3_MAX": 2000.0, "SERVO3_TRIM": 1500.0,
              "SERVO5_FUNCTION": 0.0} | more  # fmt: skip
    return MadeTable("PARM", np.zeros(len(values)), {"Name": list(values), "Value": list(values.values())})


def rcou(port: np.ndarray, starboard: np.ndarray, **more: np.ndarray) -> MadeTable:
    return MadeTable("RCOU", STAMPS, {"C1": port, "C3": starboard, **more})


def gentle(mean: float = 1600.0) -> np.ndarray:
    return mean + 50.0 * np.sin(2.0 * np.pi * np.arange(ROWS) / 80.0)


def report(*tables: MadeTable) -> Section:
    section = analyse(MadeLog(*tables))
    assert section is not None
    return section


def found(section: Section) -> dict[str, Severity]:
    return {finding.key: finding.severity for finding in section.findings}


def test_outputs_have_the_names_of_their_functions():
    section = report(parameters(), rcou(gentle(), gentle(), C5=np.full(ROWS, 1900.0), C7=np.full(ROWS, 1100.0)))
    assert found(section) == {}
    grid = next(grid for grid in section.grids if grid.key == "outputs")
    assert [row[0] for row in grid.rows] == ["output 1 (throttle port)", "output 3 (throttle starboard)"]
    # 1550 to 1650 of 1500 and 2000: a tenth to three tenths of the way.
    assert grid.rows[0][1] == pytest.approx(10.0, abs=0.1)
    assert grid.rows[0][3] == pytest.approx(30.0, abs=0.1)
    assert [servo_function_name(number) for number in (33, 40, 70, 94, 250)] == [
        "motor 1", "motor 8", "throttle", "script 1", "function 250",
    ]  # fmt: skip


@pytest.mark.parametrize(("rows", "expected"), [(20, None), (100, Severity.NOTICE), (400, Severity.WARNING)])
def test_saturation_by_share_and_length(rows, expected):
    port = gentle()
    port[200 : 200 + rows] = 2000.0
    section = report(parameters(), rcou(port, gentle()))
    assert found(section).get("radio.saturated") == expected
    if expected is not None:
        evidence = next(each for each in section.findings if each.key == "radio.saturated").evidence[0]
        assert (evidence.at_ns, evidence.until_ns) == (20 * S, (20 + rows // 10) * S)


def test_disarmed_outputs_do_not_count():
    port = gentle()
    port[:500] = 2000.0
    armed = MadeTable("ARM", [60 * S], {"ArmState": [1]})
    assert found(report(parameters(), rcou(port, gentle()), armed)) == {}


def test_port_works_harder_than_starboard():
    assert found(report(parameters(), rcou(gentle(1700.0), gentle(1560.0)))) == {"radio.uneven": Severity.NOTICE}


def test_fast_swings_are_an_oscillation_and_slow_ones_are_not():
    stamps = np.arange(5000) * S // 50
    for swing_hz, expected in ((2.0, {"radio.oscillation"}), (0.7, {"radio.oscillation"}), (0.5, set()), (0.2, set())):
        pulse = 1500.0 + 300.0 * np.sin(2.0 * np.pi * swing_hz * np.arange(5000) / 50.0)
        section = report(parameters(), MadeTable("RCOU", stamps, {"C1": pulse, "C3": pulse}))
        assert set(found(section)) == expected
        grid = next(grid for grid in section.grids if grid.key == "outputs")
        assert grid.rows[0][6] == pytest.approx(swing_hz, rel=0.1)


def test_full_throttle_below_the_speed_asked_for():
    full = np.full(ROWS, 1600.0)
    full[300:400] = 2000.0
    speed = np.full(ROWS, 2.0)
    speed[300:400] = 1.0
    thr = MadeTable("THR", STAMPS, {"DesSpeed": np.full(ROWS, 2.0), "Speed": speed})
    section = report(parameters(), rcou(full, full), thr)
    assert set(found(section)) == {"radio.too_slow", "radio.saturated"}
    finding = next(each for each in section.findings if each.key == "radio.too_slow")
    assert (finding.evidence[0].at_ns, finding.evidence[0].until_ns) == (30 * S, 40 * S)
    assert "1.0 m/s" in finding.sentence


def rcin(**channels: np.ndarray) -> MadeTable:
    return MadeTable("RCIN", STAMPS, channels)


def test_radio_failsafe_by_the_flag():
    flags = np.ones(ROWS, dtype=int)
    flags[300:350] = 2
    armed = MadeTable("ARM", [0], {"ArmState": [1]})
    section = report(rcin(C1=np.full(ROWS, 1500.0)), MadeTable("RCI2", STAMPS, {"Flags": flags}), armed)
    assert found(section) == {"radio.failsafe": Severity.WARNING}
    evidence = section.findings[0].evidence[0]
    assert (evidence.message, evidence.at_ns, evidence.until_ns) == ("RCI2", 30 * S, 35 * S)


def test_radio_failsafe_by_the_throttle_of_an_old_log():
    throttle = np.full(ROWS, 1500.0)
    throttle[300:350] = 900.0
    section = report(rcin(C1=gentle(), C3=throttle), parameters(FS_THR_VALUE=910.0))
    assert found(section) == {"radio.failsafe": Severity.WARNING}
    assert section.findings[0].evidence[0].field == "C3"


def test_a_receiver_that_holds_its_last_values():
    random = np.random.default_rng(0)
    sticks = {f"C{channel}": 1500.0 + random.integers(-3, 4, ROWS) for channel in (1, 2, 3, 4)}
    assert found(report(rcin(**sticks))) == {}
    held = {name: each.copy() for name, each in sticks.items()}
    for each in held.values():
        each[400:600] = each[400]
    section = report(rcin(**held))
    assert found(section) == {"radio.held": Severity.NOTICE}
    assert section.findings[0].evidence[0].at_ns == 40 * S


def test_a_weak_signal():
    strength = np.full(ROWS, 0.9)
    strength[500:600] = 0.1
    section = report(rcin(C1=gentle()), MadeTable("RSSI", STAMPS, {"RXRSSI": strength}))
    assert found(section) == {"radio.weak": Severity.NOTICE}
    assert "10 %" in section.findings[0].sentence


def test_motors_of_a_recording():
    command = np.zeros((ROWS, 8))
    command[:, 0] = command[:, 1] = 0.3
    command[100:500, 0] = 1.0
    table = MadeTable("/actuators", STAMPS, {"command": command, "armed": np.ones(ROWS)})
    section = analyse(MadeLog(table, kind="mcap"))
    assert section is not None
    assert found(section) == {"radio.saturated": Severity.WARNING, "radio.uneven": Severity.NOTICE}
    assert analyse(MadeLog(kind="mcap")) is None


def test_commands_of_a_recording_have_their_names():
    names = np.array(["propeller 0, rudder 0"] * ROWS)
    table = MadeTable("/actuators", STAMPS, {"command": np.zeros((ROWS, 2)), "names": names})
    assert output_names(MadeLog(table, kind="mcap")) == {1: "propeller 0", 2: "rudder 0"}
    older = MadeTable("/actuators", STAMPS, {"command": np.zeros((ROWS, 2))})
    assert output_names(MadeLog(older, kind="mcap")) == output_names(MadeLog()) == {}
