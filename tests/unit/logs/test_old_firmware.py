"""Layouts of older ArduPilot firmware, by the FMT records of its releases.

Copter 3.2 to 3.4: `CURR IhhhHfh TimeMS,Throttle,Volt,Curr,Vcc,CurrTot,Volt2` and `EKF1` to `EKF4` (ArduCopter/Log.pde,
libraries/DataFlash/DataFlash.h of those releases), `RCOU` with Ch1 and, in Plane and Rover, Chan1.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from dataflash_records import ITSELF, described, record

import xitl_cli.logs.signals as signals
from xitl_cli.logs.formats import open_log
from xitl_cli.logs.model.log import Log
from xitl_cli.plugins.logs.analyses import estimator, power, radio
from xitl_cli.plugins.logs.analyses.power import batteries

ROWS = 200
STEP_MS = 100


def _texts() -> bytes:
    return described(1, b"MSG", "IZ", "TimeMS,Message") + record(1, "IZ", 1, b"ArduCopter V3.2.1 (36b405fb)")


def _parameters(**values: float) -> bytes:
    rows = [record(2, "INf", 1, name.encode(), value) for name, value in values.items()]
    return described(2, b"PARM", "INf", "TimeMS,Name,Value") + b"".join(rows)


@contextmanager
def _log(folder: Path, *parts: bytes) -> Iterator[Log]:
    path = folder / "old.bin"
    path.write_bytes(ITSELF + b"".join(parts))
    with open_log(path) as log:
        yield log


def _currents(kind: bytes, letters: str, columns: str, *values: float) -> bytes:
    rows = [record(10, letters, 1000 + STEP_MS * row, *values) for row in range(ROWS)]
    return described(10, kind, letters, columns) + b"".join(rows)


def test_whole_numbers_of_before_2016_are_hundredths(tmp_path: Path) -> None:
    columns = "TimeMS,Throttle,Volt,Curr,Vcc,CurrTot,Volt2"
    with _log(tmp_path, _texts(), _currents(b"CURR", "IhhhHfh", columns, 395, 1549, 2744, 5354, 646.0, 0)) as log:
        (battery,) = batteries(log)
        section = power.analyse(log)
    assert battery.current_a is not None
    assert battery.voltage_v[0] == pytest.approx(15.49)
    assert battery.current_a[0] == pytest.approx(27.44)
    assert battery.used_mah is not None
    assert battery.used_mah[0] == 646.0
    assert section is not None
    assert {fact.value for fact in section.facts if fact.unit == "A"} == {27.44}


def test_floating_point_is_volts_and_amperes(tmp_path: Path) -> None:
    with _log(tmp_path, _texts(), _currents(b"CURR", "Ifff", "TimeMS,Volt,Curr,CurrTot", 1200.0, 27.44, 646.0)) as log:
        (battery,) = batteries(log)
    assert battery.current_a is not None
    assert battery.voltage_v[0] == 1200.0, "a high-voltage boat, and not 12 V"
    assert battery.current_a[0] == pytest.approx(27.44)


@pytest.mark.parametrize("stem", ["Ch", "Chan", "C"])
def test_outputs_are_found_by_every_name_they_had(stem: str, tmp_path: Path) -> None:
    names = ",".join(f"{stem}{channel}" for channel in range(1, 9))
    rows = [record(11, "Ihhhhhhhh", 1000 + STEP_MS * row, *range(1100, 1900, 100)) for row in range(ROWS)]
    with _log(tmp_path, _texts(), described(11, b"RCOU", "Ihhhhhhhh", f"TimeMS,{names}"), *rows) as log:
        found = signals.outputs(log)
    assert {channel: each.values[0] for channel, each in found.items()} == {n: 1000.0 + 100 * n for n in range(1, 9)}


def test_what_is_no_pulse_is_no_output(tmp_path: Path) -> None:
    """A board that logged more channels than it had: what stood in memory."""
    columns = "TimeMS,Chan1,Chan2,Chan3"
    rows = [record(11, "Ihhh", 1000 + STEP_MS * row, 447, -20414, 11948) for row in range(ROWS)]
    with _log(tmp_path, _texts(), described(11, b"RCOU", "Ihhh", columns), *rows) as log:
        section = radio.analyse(log)
    assert section is not None
    assert {fact.key: fact.value for fact in section.facts}["outputs"] == 0
    assert not section.findings


def test_motors_of_old_copters_rest_at_their_lower_end(tmp_path: Path) -> None:
    """MOT_SPIN_ARMED: they turn a little above RC3_MIN on the ground; full is the only end that limits."""
    parameters = _parameters(RC1_MIN=1000, RC1_MAX=2000, RC1_TRIM=1500, RC3_MIN=1100, RC3_MAX=1900)
    pulses = [1100] * (ROWS // 2) + [1900] * (ROWS // 2)
    rows = [record(11, "Ih", 1000 + STEP_MS * row, pulse) for row, pulse in enumerate(pulses)]
    with _log(tmp_path, _texts(), parameters, described(11, b"RCOU", "Ih", "TimeMS,Ch1"), *rows) as log:
        section = radio.analyse(log)
    assert section is not None
    (finding,) = (each for each in section.findings if each.key == "radio.saturated")
    assert finding.evidence[0].at_ns == (1000 + STEP_MS * ROWS // 2) * 1_000_000


EKF1 = ("IccCfffffffccc", "TimeMS,Roll,Pitch,Yaw,VN,VE,VD,PN,PE,PD,GX,GY,GZ")
EKF4 = ("IcccccccbbBBH", "TimeMS,SV,SP,SH,SMX,SMY,SMZ,SVT,OFN,EFE,FS,TS,SS")


def test_the_first_filter_is_read(tmp_path: Path) -> None:
    solution, health = [], []
    for row in range(ROWS):
        at_ms = 1000 + STEP_MS * row
        solution.append(record(12, "IccCffffffccc", at_ms, 100, -100, 9000, 3.0, 4.0, 0.0, row, 0.0, 0.0, 6, 6, 6))
        ratio = 250 if 50 <= row < 100 else 20
        health.append(record(13, EKF4[0], at_ms, 10, 10, 10, 10, ratio, 10, 0, 0, 0, 0, 0, 0b11_0011_1111))
    armed = described(14, b"EV", "B", "Id") + record(14, "B", 10)
    parts = (described(12, b"EKF1", "IccCffffffccc", EKF1[1]), described(13, b"EKF4", *EKF4))
    with _log(tmp_path, _texts(), *parts, solution[0], health[0], armed, *solution[1:], *health[1:]) as log:
        speed = signals.ground_speed(log)
        section = estimator.analyse(log)
    assert speed is not None
    assert (speed.source, speed.values[0]) == ("EKF1.VN, VE", 5.0)
    assert section is not None
    facts = {fact.key: fact.value for fact in section.facts}
    assert (facts["filter"], facts["ratio_compass_max"]) == ("EKF1", 2.5)
    (refused,) = (each for each in section.findings if each.key == "estimator.refused.compass")
    assert "2.50" in refused.sentence
    assert np.isclose((refused.evidence[0].at_ns or 0) * 1e-9, 6.0)
