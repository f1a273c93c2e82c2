"""Capsizes and impacts: found, and not where nothing happened."""

import numpy as np
import pytest
from made_log import MadeLog, MadeTable
from made_vessel import vessel
from numpy.typing import NDArray

from tests.golden import Golden
from tests.recorded import CALM, EXTERNAL_AHRS, GUST, LINUX
from xitl_cli.logs.formats import open_log
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Finding, Severity
from xitl_cli.plugins.logs.analyses import attitude

S = 1_000_000_000
Array = NDArray[np.float64]
STAMPS = np.arange(0, 60 * S, S // 25) + 5 * S
TIMES_S = (STAMPS - 5 * S) * 1e-9


def found(log: Log) -> dict[str, Finding]:
    section = attitude.analyse(log)
    assert section is not None
    return {each.key: each for each in section.findings}


def over(t_s: Array, to_deg: float = 178.0, from_s: float = 20.0, for_s: float = 17.0) -> Array:
    return np.where((t_s >= from_s) & (t_s < from_s + for_s), to_deg, 3.0 * np.sin(t_s))


def inertial(accel_frd: Array, at_ns: Array = STAMPS) -> MadeTable:
    columns = {f"Acc{axis}": accel_frd[:, place] for place, axis in enumerate("XYZ")}
    return MadeTable("IMU", at_ns, columns | {f"Gyr{axis}": np.full(len(at_ns), 1e-3) for axis in "XYZ"})


def at_rest(rows: int = len(STAMPS)) -> Array:
    return np.random.default_rng(3).normal((0.0, 0.0, -9.8), 0.3, (rows, 3))


def test_a_capsize_is_found_with_time_duration_and_roll() -> None:
    boat = MadeTable("PARM", [0], {"Name": ["FRAME_CLASS"], "Value": [2.0]})
    finding = found(vessel("boat", roll_deg=over, armed_s=2.0, further=(boat,)))["attitude.overturned"]
    assert finding.severity == Severity.CRITICAL
    assert "capsized: at roll 178°" in finding.sentence
    assert "16.9 s from 0:25.0, armed" in finding.sentence
    assert finding.evidence[0].at_ns == 25 * S
    assert finding.next_step


def test_a_vessel_that_pitches_over_its_bow_has_capsized() -> None:
    finding = found(vessel("boat", pitch_deg=over, armed_s=2.0))["attitude.overturned"]
    assert finding.severity == Severity.CRITICAL
    assert "pitch 178°" in finding.sentence


def test_tilt_is_the_angle_between_mast_and_vertical() -> None:
    """The mast's vertical part is cos(roll) cos(pitch); 45° of each is a tilt of 60°."""
    log = vessel("boat", roll_deg=lambda t_s: np.full_like(t_s, 45.0), pitch_deg=lambda t_s: np.full_like(t_s, 45.0))
    tilt = attitude.tilt_series(log)
    assert tilt is not None
    assert tilt.tilt_deg == pytest.approx(60.0, abs=1e-6)


def test_motors_that_run_meanwhile_are_said() -> None:
    outputs = MadeTable("RCOU", STAMPS, {"C3": np.full(len(STAMPS), 1900)})
    disarmed = MadeTable("ARM", [5 * S, 50 * S], {"ArmState": [1, 0]})
    parameters = {"SERVO3_FUNCTION": 70.0, "SERVO3_MIN": 1100.0, "SERVO3_MAX": 1900.0, "SERVO3_TRIM": 1500.0}
    told = MadeTable("PARM", [0] * 4, {"Name": list(parameters), "Value": list(parameters.values())})
    finding = found(vessel("boat", roll_deg=over, further=(outputs, told, disarmed)))["attitude.overturned"]
    assert "with its motors running at up to 100 %" in finding.sentence


def test_carried_upside_down_is_a_notice() -> None:
    rows = MadeTable("ARM", [5 * S, 6 * S, 7 * S], {"ArmState": [0, 1, 0]})
    finding = found(vessel("boat", roll_deg=over, further=(rows,)))["attitude.overturned"]
    assert finding.severity == Severity.NOTICE


def test_what_turned_over_just_after_disarming_is_critical() -> None:
    rows = MadeTable("ARM", [5 * S, 22 * S], {"ArmState": [1, 0]})
    finding = found(vessel("boat", roll_deg=over, further=(rows,)))["attitude.overturned"]
    assert finding.severity == Severity.CRITICAL
    assert "just disarmed" in finding.sentence


def test_waves_of_thirty_degrees_are_sailing() -> None:
    log = vessel("boat", roll_deg=lambda t_s: 30.0 * np.sin(t_s), armed_s=1.0, further=(inertial(at_rest()),))
    assert {key: finding.severity for key, finding in found(log).items()} == {"attitude.upright": Severity.OK}


def test_waves_that_roll_a_boat_are_a_notice_with_their_size_and_begin() -> None:
    def rolling(t_s: Array) -> Array:
        return np.where(t_s < 20.0, 2.0, 20.0) * np.sin(2.0 * t_s)

    boat = MadeTable("PARM", [0], {"Name": ["FRAME_CLASS"], "Value": [2.0]})
    keys = found(vessel("boat", roll_deg=rolling, armed_s=1.0, further=(boat,)))
    assert set(keys) == {"attitude.upright", "attitude.rolling"}
    assert keys["attitude.rolling"].severity == Severity.NOTICE
    assert "rolled by 14° and pitched by 0° RMS" in keys["attitude.rolling"].sentence  # 20° / √2
    begin_ns = keys["attitude.rolling"].evidence[0].at_ns
    assert begin_ns is not None
    assert 25.0 <= begin_ns / S <= 26.5  # the log begins at 5 s
    assert set(found(vessel("rover", roll_deg=rolling, armed_s=1.0))) == {"attitude.upright"}


def test_a_boat_that_is_stopped_by_an_obstacle_has_an_impact_of_its_own_size() -> None:
    accel = at_rest()
    accel[500:503, 0] -= 12.0
    boat = MadeTable("PARM", [0], {"Name": ["FRAME_CLASS"], "Value": [2.0]})
    finding = found(vessel("boat", armed_s=1.0, further=(boat, inertial(accel))))["attitude.impact"]
    assert finding.evidence[0].at_ns is not None
    assert abs(finding.evidence[0].at_ns - STAMPS[501]) <= S // 10
    assert "attitude.impact" not in found(vessel("rover", armed_s=1.0, further=(inertial(accel),)))


def test_a_wave_that_lifts_a_boat_is_no_impact() -> None:
    accel = at_rest()
    accel[500:503, 2] -= 12.0
    boat = MadeTable("PARM", [0], {"Name": ["FRAME_CLASS"], "Value": [2.0]})
    assert "attitude.impact" not in found(vessel("boat", armed_s=1.0, further=(boat, inertial(accel))))


def test_heeling_to_sixty_degrees_is_a_warning() -> None:
    log = vessel("boat", roll_deg=lambda t_s: over(t_s, 60.0, for_s=3.0), armed_s=1.0)
    assert found(log)["attitude.leaning"].severity == Severity.WARNING


def test_an_estimate_that_the_accelerometers_contradict_is_doubted() -> None:
    keys = found(vessel("boat", roll_deg=over, armed_s=2.0, further=(inertial(at_rest()),)))
    assert "attitude.overturned" not in keys
    assert "accelerometers show it upright" in keys["attitude.doubtful"].sentence


def copter(mode: int, roll: Array) -> MadeLog:
    return MadeLog(
        MadeTable("MSG", STAMPS[:1], {"Message": ["ArduCopter V4.5.0 (12345678)"]}),
        MadeTable("MODE", STAMPS[:1], {"ModeNum": [mode], "Mode": [mode]}),
        MadeTable("ARM", STAMPS[:1], {"ArmState": [1]}),
        MadeTable("ATT", STAMPS, {"Roll": roll, "Pitch": roll * 0.0, "Yaw": roll * 0.0}),
    )


def test_a_flip_in_acro_is_flying_and_lying_so_is_not() -> None:
    acro, stabilize = 1, 0
    flip = over(TIMES_S, for_s=1.0)
    assert "attitude.overturned" not in found(copter(acro, flip))
    assert found(copter(stabilize, flip))["attitude.overturned"].severity == Severity.CRITICAL
    assert found(copter(acro, over(TIMES_S)))["attitude.overturned"].severity == Severity.CRITICAL


def knocked(peak_mps2: float, shaken_mps2: float = 0.0, at: int = 600) -> MadeTable:
    accel = at_rest()
    accel[:, 0] += shaken_mps2 * np.sin(40.0 * TIMES_S)
    accel[at, 0] = peak_mps2
    return inertial(accel)


def test_an_impact_is_found_at_its_instant() -> None:
    finding = found(vessel("boat", armed_s=1.0, further=(knocked(120.0),)))["attitude.impact"]
    assert finding.severity == Severity.CRITICAL
    assert "120 m/s² at 0:29.0" in finding.sentence
    assert finding.evidence[0].at_ns == int(STAMPS[600])


@pytest.mark.parametrize(("peak_mps2", "range_g"), [(78.4, 8), (157.0, 16), (314.0, 32)])
def test_the_end_of_a_known_range_is_said(peak_mps2: float, range_g: int) -> None:
    finding = found(vessel("boat", armed_s=1.0, further=(knocked(peak_mps2),)))["attitude.impact"]
    assert f"the end of its range of {range_g} g" in finding.sentence


def test_what_class_and_vibration_explain_is_no_impact() -> None:
    assert "attitude.impact" not in found(vessel("boat", armed_s=1.0, further=(knocked(30.0),)))
    assert "attitude.impact" not in found(vessel("boat", armed_s=1.0, further=(knocked(70.0, 25.0),)))


def test_a_damaged_row_is_no_impact() -> None:
    accel = at_rest()
    accel[600, 1] = 4e5
    assert "attitude.impact" not in found(vessel("boat", armed_s=1.0, further=(inertial(accel),)))


def test_a_knock_ashore_is_a_notice() -> None:
    rows = MadeTable("ARM", [5 * S, 50 * S], {"ArmState": [0, 1]})
    assert found(vessel("boat", further=(rows, knocked(120.0))))["attitude.knock"].severity == Severity.NOTICE


def test_contacts_of_a_recording_are_told(golden: Golden) -> None:
    log = vessel("run", armed_s=1.0)
    touched = {"what": ["rock", "rock", "quay"], "speed_mps": [0.4, 0.2, 1.3], "began": [1, 0, 1]}
    log.tables = log.tables | {"/contacts": MadeTable("/contacts", [20 * S, 21 * S, 30 * S], touched)}
    finding = found(log)["attitude.contact"]
    golden("finding", finding.sentence, "0:30.0", "1.30 m/s", "2 times")


@pytest.mark.parametrize("path", [CALM, GUST, EXTERNAL_AHRS, LINUX], ids=lambda path: path.stem)
def test_real_boats_that_sailed_well_are_fine(path) -> None:
    with open_log(path) as log:
        assert set(found(log)) == {"attitude.upright"}


def test_an_inverted_copter_with_its_motors_running_is_said_without_parameters() -> None:
    log = copter(0, over(TIMES_S))
    log.tables = log.tables | {"RCOU": MadeTable("RCOU", STAMPS, {"C1": np.full(len(STAMPS), 1700)})}
    finding = found(log)["attitude.overturned"]
    assert "was inverted: at roll 178° for 17.0 s" in finding.sentence
    assert "with its motors running at up to 75 %" in finding.sentence
