"""Analyses of sensors, receivers, vibration, radio and power on logs that make no sense: a section or none."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable
from sound_sections import sound_sections

from tests.recorded import CALM, EXTERNAL_AHRS
from xitl_cli.logs.formats.dataflash.file import DataFlashLog
from xitl_cli.logs.model.sections import Severity

ANALYSES = ("sensors", "gnss", "vibration", "radio", "power")
IMU = ("GyrX", "GyrY", "GyrZ", "AccX", "AccY", "AccZ", "T", "GH", "AH", "GHz", "AHz", "EG", "EA", "SampleUS")
CHANNELS = tuple(f"C{channel}" for channel in range(1, 5))
TABLES: dict[str, tuple[str, ...]] = {
    "IMU": ("I", *IMU),
    "VNIM": ("Temp", "MX", "AX", "AY", "AZ", "GX", "GY", "GZ"),
    "RAW_IMU": ("xgyro", "ygyro", "zgyro", "xacc", "yacc", "zacc", "temperature", "time_usec"),
    "MAG": ("I", "MagX", "MagY", "MagZ", "Health"),
    "BARO": ("I", "Press", "Temp", "H"),
    "RFND": ("I", "Dist"),
    "GPS": ("I", "Status", "NSats", "HDop", "Lat", "Lng", "Alt", "Spd", "GCrs", "VZ", "GWk", "GMS"),
    "GPA": ("I", "HAcc", "VAcc", "SAcc", "SMS", "Delta"),
    "GPS_RAW_INT": ("fix_type", "lat", "lon", "alt", "eph", "vel", "cog", "h_acc", "satellites_visible"),
    "VIBE": ("I", "VibeX", "VibeY", "VibeZ", "Clip"),
    "ISBH": ("N", "type", "instance", "mul", "smp_cnt", "smp_rate"),
    "RCIN": CHANNELS,
    "RCI2": ("Flags",),
    "RCOU": CHANNELS,
    "RSSI": ("RXRSSI", "RXLQ"),
    "STER": ("SteerOut",),
    "THR": ("DesSpeed", "Speed", "ThrOut"),
    "PIDS": ("Flags",),
    "BAT": ("I", "Volt", "Curr", "CurrTot", "RemPct", "Res", "H"),
    "SYS_STATUS": ("voltage_battery", "current_battery", "battery_remaining"),
    "POWR": ("Vcc", "Flags"),
    "MCU": ("MTemp",),
    "ERR": ("Subsys", "ECode"),
    "ARM": ("ArmState",),
    "XKF1": ("VN", "VE"),
    "XKF4": ("SS",),
}
WHOLE = {"I", "N", "type", "instance", "Status", "NSats", "GWk", "GMS", "fix_type", "satellites_visible", "Flags",
         "SS", "Subsys", "ECode", "ArmState", "Health", "H", "GH", "AH", "Clip", "smp_cnt", "SampleUS",
         "time_usec"}  # fmt: skip
NAMES = ("SERVO1_FUNCTION", "SERVO1_MIN", "SERVO1_MAX", "SERVO1_TRIM", "BATT_LOW_VOLT", "BATT_CAPACITY", "FS_THR_VALUE",
         "RCMAP_THROTTLE", "INS_GYRO_FILTER")  # fmt: skip


def column(name: str, rows: int, random: np.random.Generator) -> np.ndarray[Any, Any]:
    if name == "I":
        return random.integers(0, 3, rows)
    if name in WHOLE:
        return random.choice(np.array([0, 1, 2, 3, 6, 255, 65_535, 2**31 - 1]), rows)
    scale = random.choice([1e-3, 1.0, 50.0, 2000.0])
    values = random.choice([0.0, 1.0, -8.8, 63.9, 1500.0, 1e30, -1e30, np.nan, np.inf], rows)
    return np.where(random.random(rows) < random.random(), random.normal(0.0, scale, rows), values)


def nonsense(seed: int) -> MadeLog:
    random = np.random.default_rng(seed)
    tables = []
    for name, columns in TABLES.items():
        if random.random() < 0.4:
            continue
        rows = int(random.choice([1, 2, 3, 40, 400]))
        stamps = np.sort(random.integers(0, 100 * 10**9, rows))
        if random.random() < 0.3:
            stamps = np.arange(rows) * 20_000_000
        if random.random() < 0.2:
            stamps = random.choice([0, 10**9, 2**62, -(2**62)], rows)
        kept = [one for one in columns if random.random() < 0.9]
        values = {one: column(one, rows, random) for one in kept}
        tables.append(MadeTable(name, stamps, values, "I" if "I" in kept else None))
    blocks = random.integers(0, 40)
    tables.append(
        MadeTable(
            "ISBD", np.arange(blocks), {"N": random.integers(0, 3, blocks), "seqno": random.integers(0, 3, blocks)}
            | {axis: np.zeros((blocks, 32)) for axis in "xyz"},
        )
    )  # fmt: skip
    if not blocks:
        tables.pop()
    tables.append(
        MadeTable("PARM", np.arange(len(NAMES)), {"Name": NAMES, "Value": column("Value", len(NAMES), random)})
    )
    return MadeLog(*tables, kind="dataflash" if seed % 3 else "tlog")


@pytest.mark.medium
@pytest.mark.parametrize("block", range(10))
def test_nonsense_of_sensors(block: int) -> None:
    for seed in range(20 * block, 20 * block + 20):
        sound_sections(nonsense(seed), ANALYSES)


@pytest.mark.medium
def test_the_real_logs_of_a_healthy_boat_raise_no_alarm() -> None:
    found: dict[str, list[str]] = {}
    for name in ("calm", "gust"):
        with DataFlashLog(CALM.with_name(f"boat-auto-{name}.bin")) as log:
            for section in sound_sections(log, ANALYSES):
                assert section.worst <= Severity.NOTICE, [finding.sentence for finding in section.findings]
                found.setdefault(name, []).extend(finding.key for finding in section.findings)
    # The gusts take all the steering there is at the end of the mission; nothing does in the calm.
    assert found == {"calm": [], "gust": ["radio.saturated"]}


@pytest.mark.medium
def test_a_real_log_whose_injected_sensors_stopped_says_so() -> None:
    with DataFlashLog(EXTERNAL_AHRS) as log:
        found = {
            (finding.key, finding.sentence.split()[0]): finding
            for part in sound_sections(log, ANALYSES)
            for finding in part.findings
        }
    # The frames end 5 s before the log does; the last good ones were seen by pymavlink at 80.0 s and 79.8 s.
    stuck, lost = found[("sensors.stopped_together", "IMU[0]")], found[("gnss.fix_lost", "GPS[0]")]
    assert stuck.evidence[0].at_ns == pytest.approx(80.0e9, abs=0.1e9)
    assert lost.evidence[0].at_ns == pytest.approx(79.8e9, abs=0.1e9)
    assert ("sensors.unhealthy", "BARO[2]") in found
