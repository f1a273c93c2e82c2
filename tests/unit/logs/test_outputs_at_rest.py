"""What an output rests at is not the end of its range."""

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from xitl_cli.logs.model.sections import Finding, Severity
from xitl_cli.plugins.logs.analyses import radio
from xitl_cli.plugins.logs.analyses.outputs import OutputRange

S = 1_000_000_000
STAMPS = np.arange(600) * S // 10
ROVER = MadeTable("MSG", [0], {"Message": ["ArduRover V4.5.0 (12345678)"]})
ARMED = MadeTable("ARM", [0, 5 * S], {"ArmState": [0, 1]})


def saturated(pulse_us: np.ndarray, *further: MadeTable, **parameters: float) -> list[Finding]:
    outputs = MadeTable("RCOU", STAMPS, {"C1": pulse_us})
    tables = [outputs, ARMED, *further]
    if parameters:
        tables.append(MadeTable("PARM", np.zeros(len(parameters)), {
            "Name": list(parameters), "Value": list(parameters.values())}))  # fmt: skip
    section = radio.analyse(MadeLog(*tables))
    assert section is not None
    return [each for each in section.findings if each.key == "radio.saturated"]


THROTTLE = {"SERVO1_FUNCTION": 70.0, "SERVO1_MIN": 1000.0, "SERVO1_MAX": 2000.0}


def test_a_throttle_at_min_and_trim_is_idle() -> None:
    idle = np.full(600, 1000)
    assert not saturated(idle, ROVER, **THROTTLE, SERVO1_TRIM=1000.0)
    assert not saturated(idle, ROVER, **THROTTLE, SERVO1_TRIM=1010.0), "a trim a little above its end"


def test_at_its_other_end_it_is_saturated() -> None:
    (finding,) = saturated(np.full(600, 2000), ROVER, **THROTTLE, SERVO1_TRIM=1000.0)
    assert finding.severity == Severity.WARNING


def test_a_reversed_throttle_rests_at_max() -> None:
    assert not saturated(np.full(600, 2000), ROVER, **THROTTLE, SERVO1_TRIM=2000.0, SERVO1_REVERSED=1.0)


def test_backwards_at_full_is_saturated_where_trim_is_between() -> None:
    assert saturated(np.full(600, 1000), ROVER, **THROTTLE, SERVO1_TRIM=1500.0)


def test_the_throttle_of_a_plane_has_no_trim() -> None:
    plane = MadeTable("MSG", [0], {"Message": ["ArduPlane V4.5.0 (12345678)"]})
    assert not saturated(np.full(600, 1000), plane, **THROTTLE, SERVO1_TRIM=1500.0)
    assert saturated(np.full(600, 1000), plane, **THROTTLE, SERVO1_TRIM=1500.0, THR_MIN=-100.0), "with reverse thrust"


@pytest.mark.parametrize("function", [29.0, 41.0, 28.0, 1.0])
def test_gear_and_gripper_rest_at_their_ends(function: float) -> None:
    ends = {"SERVO1_MIN": 1000.0, "SERVO1_MAX": 2000.0, "SERVO1_TRIM": 1500.0}
    assert not saturated(np.full(600, 2000), ROVER, SERVO1_FUNCTION=function, **ends)


def test_a_command_is_the_share_of_the_range_from_neutral_to_an_end() -> None:
    pulses_us = np.array([1000.0, 1250.0, 1500.0, 1700.0, 1900.0])
    commands = [-1.0, -0.5, 0.0, 0.5, 1.0]
    assert OutputRange(1000.0, 1900.0, 1500.0, False, True).command(pulses_us) == pytest.approx(commands)
    assert -OutputRange(1000.0, 1900.0, 1500.0, True, True).command(pulses_us) == pytest.approx(commands)
    from_low = OutputRange(1000.0, 2000.0, 1000.0, False, True).command(np.array([900.0, 1000.0, 1250.0, 2000.0]))
    assert from_low == pytest.approx([0.0, 0.0, 0.25, 1.0])


def test_without_parameters_what_it_holds_while_disarmed_is_rest() -> None:
    pulses = np.full(600, 1100)
    assert not saturated(pulses, ROVER)
    pulses[100:400] = 1900
    (finding,) = saturated(pulses, ROVER)
    assert finding.severity == Severity.NOTICE, "what it drives is not known"


def test_motors_of_a_rover_turn_both_ways() -> None:
    """As of a boat whose motors stand at their places: neutral is no end."""
    motor = {"SERVO1_FUNCTION": 33.0, "SERVO1_MIN": 1000.0, "SERVO1_MAX": 2000.0, "SERVO1_TRIM": 1500.0}
    assert not saturated(np.full(600, 1500), ROVER, **motor)
    assert saturated(np.full(600, 1000), ROVER, **motor)


def test_a_gear_of_a_recording_is_no_motor() -> None:
    """Throttle at a half and the gear to one side is no pair of uneven propellers."""
    command = np.tile([0.5, -0.5], (600, 1))

    def uneven(names: str) -> bool:
        table = MadeTable("/actuators", STAMPS, {"command": command, "armed": np.ones(600), "names": [names] * 600})
        section = radio.analyse(MadeLog(table))
        assert section is not None
        return any(each.key == "radio.uneven" for each in section.findings)

    assert uneven("propeller 0, propeller 1")
    assert not uneven("propeller 0, steering 0")
