"""What was demanded beside what was done."""

import numpy as np
import pytest
from made_log import MadeLog, MadeTable
from numpy.typing import NDArray

from tests.golden import Golden
from tests.recorded import CALM, EXTERNAL_AHRS, GUST, LINUX
from xitl_cli.logs.formats import open_log
from xitl_cli.logs.model.sections import Finding, Section, Severity
from xitl_cli.plugins.logs.analyses import control

S = 1_000_000_000
Array = NDArray[np.float64]
STAMPS = np.arange(0, 120 * S, S // 10)
T_S = np.round(STAMPS * 1e-9, 3)
ROWS = len(STAMPS)


def log_of(*tables: MadeTable, firmware: str = "ArduRover", mode: int = 10) -> MadeLog:
    return MadeLog(
        MadeTable("MSG", [0], {"Message": [f"{firmware} V4.7.0 (12345678)"]}),
        MadeTable("MODE", [0], {"ModeNum": [mode], "Mode": [mode]}),
        MadeTable("ARM", [0, S], {"ArmState": [0, 1]}),
        *tables,
    )


def analysed(log: MadeLog) -> Section:
    section = control.analyse(log)
    assert section is not None
    return section


def found(log: MadeLog) -> dict[str, Finding]:
    return {each.key: each for each in analysed(log).findings}


def steered(demanded: Array | float, yaw: Array | float) -> MadeTable:
    return MadeTable("NTUN", STAMPS, {"DesYaw": np.full(ROWS, demanded), "Yaw": np.full(ROWS, yaw) % 360.0})


def attitude(yaw: Array | float) -> MadeTable:
    zero = np.zeros(ROWS)
    return MadeTable("ATT", STAMPS, {"Roll": zero, "Pitch": zero, "Yaw": np.full(ROWS, yaw) % 360.0, "DesYaw": zero})


def speeds(demanded: Array | float, achieved: Array | float) -> MadeTable:
    return MadeTable("THR", STAMPS, {"DesSpeed": np.full(ROWS, demanded), "Speed": np.full(ROWS, achieved)})


def test_a_heading_that_is_not_reached_is_found(golden: Golden) -> None:
    yaw = np.where((T_S > 40) & (T_S < 70), 190.0, 91.0)
    finding = found(log_of(steered(90.0, yaw), attitude(yaw), speeds(2.0, 2.0)))["control.heading_off"]
    assert finding.severity == Severity.WARNING
    golden("finding", finding.sentence, "100 deg", "29.8 s", "0:40.1", "190 deg", "90 deg")
    assert finding.evidence[0].message == "NTUN"


def test_the_short_way_round_is_the_error() -> None:
    assert "control.heading_off" not in found(log_of(steered(350.0, 8.0), attitude(8.0), speeds(2.0, 2.0)))


def test_a_turn_takes_its_time() -> None:
    demanded = np.where(T_S < 60, 10.0, 190.0)
    yaw = np.clip(10.0 + 15.0 * (T_S - 60.0), 10.0, 190.0)
    assert set(found(log_of(steered(demanded, yaw), attitude(yaw), speeds(2.0, 2.0)))) == {"control.followed"}


def test_a_large_error_for_a_short_time_neither_fails_nor_follows() -> None:
    """Half of the time off by a right angle, for 14 s at once."""
    yaw = np.where(T_S % 28 < 14, 190.0, 100.0)
    assert found(log_of(steered(100.0, yaw), attitude(yaw), speeds(2.0, 2.0))) == {}


def test_a_demand_flat_at_0_is_none() -> None:
    """Rover steers its legs by turn rate and leaves both columns at 0."""
    section = control.analyse(log_of(steered(0.0, 180.0), attitude(180.0), speeds(2.0, 2.0)))
    assert section is not None
    assert not any(fact.key.startswith("heading") for fact in section.facts)
    assert {each.key for each in section.findings} == {"control.followed"}


def test_a_mode_without_a_heading_demands_none() -> None:
    hold = 4
    log = log_of(steered(90.0, 200.0), attitude(200.0), speeds(2.0, 2.0), mode=hold)
    assert "control.heading_off" not in found(log)


def test_a_vessel_that_lies_still_is_not_off_its_heading() -> None:
    speed = speeds(np.where(T_S < 5, 2.0, 0.0), 0.0)
    assert "control.heading_off" not in found(log_of(steered(90.0, 200.0), attitude(200.0), speed))


def test_a_vessel_that_turns_on_the_spot_is_off_its_heading() -> None:
    speed = speeds(np.where(T_S < 5, 2.0, 0.0), 0.0)
    motor = MadeTable("RCOU", STAMPS, {"C1": np.full(ROWS, 1800)})
    names = {"SERVO1_FUNCTION": 73.0, "SERVO1_MIN": 1100.0, "SERVO1_MAX": 1900.0, "SERVO1_TRIM": 1500.0}
    told = MadeTable("PARM", [0] * 4, {"Name": list(names), "Value": list(names.values())})
    assert "control.heading_off" in found(log_of(steered(90.0, 200.0), attitude(200.0), speed, motor, told))


@pytest.mark.parametrize(
    ("demanded", "achieved", "key"),
    [(2.0, 1.2, "control.too_slow"), (2.0, 3.2, "control.too_fast"), (-2.0, -1.0, "control.too_slow")],
)
def test_a_speed_that_is_not_held_is_found(demanded: float, achieved: float, key: str) -> None:
    assert set(found(log_of(speeds(demanded, achieved)))) == {key}


def test_gathering_way_is_not_being_slow() -> None:
    achieved = 2.0 * (1.0 - np.exp(-np.maximum(T_S - 20.0, 0.0) / 5.0))
    assert set(found(log_of(speeds(np.where(T_S < 20, 0.0, 2.0), achieved)))) == {"control.followed"}


def test_a_turn_rate_that_is_not_reached_is_found() -> None:
    turning = {"DesTurnRate": np.where(T_S > 50, 60.0, 1.0), "TurnRate": np.where(T_S > 50, 5.0, 1.0)}
    steering = MadeTable("STER", STAMPS, turning)
    assert "control.turn_rate_off" in found(log_of(steering, speeds(2.0, 2.0)))


def flown(demanded: Array | float, roll: Array | float) -> MadeTable:
    zero = np.zeros(ROWS)
    columns = {"DesRoll": np.full(ROWS, demanded), "Roll": np.full(ROWS, roll), "DesPitch": zero + 1.0, "Pitch": zero}
    return MadeTable("ATT", STAMPS, columns | {"Yaw": zero, "DesYaw": zero})


def test_a_copter_that_does_not_obey_has_lost_control(golden: Golden) -> None:
    roll = np.where((T_S > 60) & (T_S < 65), 80.0, 2.0)
    finding = found(log_of(flown(2.0, roll), firmware="ArduCopter", mode=5))["control.attitude_lost"]
    assert finding.severity == Severity.CRITICAL
    golden("finding", finding.sentence, "78 deg", "4.8 s", "1:00.1")


def test_sticks_stirred_on_the_ground_are_no_loss() -> None:
    stirred = np.where((T_S > 60) & (T_S < 65), 45.0, 1.0)
    assert "control.attitude_lost" not in found(log_of(flown(stirred, 1.0), firmware="ArduCopter", mode=5))


def test_in_acro_no_attitude_is_demanded() -> None:
    roll = np.where((T_S > 60) & (T_S < 65), 80.0, 2.0)
    assert "control.attitude_lost" not in found(log_of(flown(2.0, roll), firmware="ArduCopter", mode=1))


def test_a_late_response_is_followed_with_its_delay_and_the_error_that_is_left() -> None:
    with open_log(EXTERNAL_AHRS) as log:
        section = control.analyse(log)
    assert section is not None
    facts = {fact.key: fact.value for fact in section.facts}
    (followed,) = section.findings
    assert facts["turn_rate_error_rms_degps"] == pytest.approx(16.0, abs=0.5)
    # 4.3 deg/s at a shift of ten rows of 0.1 s, over all rows of STER
    assert "after a delay of 1.0 s" in followed.sentence
    assert "turn rate within 6.2 deg/s RMS" in followed.sentence


@pytest.mark.parametrize("path", [CALM, GUST, EXTERNAL_AHRS, LINUX], ids=lambda path: path.stem)
def test_real_boats_that_sailed_well_followed(path) -> None:
    with open_log(path) as log:
        section = control.analyse(log)
    assert section is not None
    assert {each.key for each in section.findings} == {"control.followed"}
    assert {"speed_error_rms_mps", "turn_rate_error_rms_degps"} <= {fact.key for fact in section.facts}
