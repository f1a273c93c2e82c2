"""Analyses of who, what and when on logs that make no sense; all analyses on empty and on damaged ones."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable
from sound_sections import sound_sections

from tests.recorded import CALM
from xitl_cli.logs import open_log

ANALYSES = ("vehicle", "modes", "arming", "events", "missions", "parameters", "estimator")
TABLES: dict[str, tuple[str, ...]] = {
    "ARM": ("ArmState", "ArmChecks", "Forced", "Method"),
    "ATT": ("Roll", "Yaw", "AEKF"),
    "AUXF": ("function", "pos", "source"),
    "CMD": ("CTot", "CNum", "CId", "Lat", "Lng", "Alt", "Frame"),
    "DSF": ("Dp",),
    "EKF_STATUS_REPORT": ("flags", "velocity_variance", "compass_variance"),
    "ERR": ("Subsys", "ECode"),
    "EV": ("Id",),
    "GPS": ("Status", "GWk", "GMS", "Lat", "Lng", "Alt", "Spd", "GCrs"),
    "HEARTBEAT": ("type", "autopilot", "custom_mode", "base_mode", "_sysid"),
    "MISE": ("CNum",),
    "MISSION_CURRENT": ("seq", "total", "mission_state"),
    "MODE": ("Mode", "ModeNum", "Rsn"),
    "MON": ("Dly", "IErr"),
    "ORGN": ("Type", "Lat", "Lng", "Alt"),
    "PM": ("InE",),
    "POS": ("Lat", "Lng", "Alt"),
    "SIM": ("Yaw", "Lat", "Lng", "Alt"),
    "SYS_STATUS": ("onboard_control_sensors_present", "onboard_control_sensors_health"),
    "VER": ("BT", "BST", "Maj", "Min", "Pat", "FWT", "GH", "BU"),
    "WDOG": ("Task", "IErr"),
    "XKF1": ("C", "Yaw", "PN", "PE", "VN", "VE", "OH"),
    "XKF3": ("C", "IVN", "IYAW"),
    "XKF4": ("C", "SV", "SP", "SH", "SM", "FS", "TS", "SS", "PI", "OFN", "OFE"),
    "XKFS": ("C", "SS", "MAG_FUSION"),
    "XKT": ("C", "Cnt", "IMUMin", "EKFMax"),
}
SENTENCES = ("PreArm: x", "Reached waypoint #3", "Crash: Disarming", "Radio Failsafe", "", "Throttle armed", "Ω" * 9)
MEASURED = {
    *("Lat", "Lng", "Alt", "Yaw", "Roll", "SV", "SP", "SH", "SM", "PN", "PE", "VN", "VE", "OH", "OFN", "OFE"),
    *("IVN", "IYAW", "Spd", "GCrs", "IMUMin", "EKFMax", "velocity_variance", "compass_variance"),
}


def column(name: str, rows: int, random: np.random.Generator) -> np.ndarray[Any, Any]:
    if name not in MEASURED:
        wide = [0, 1, 2, 3, 4, 10, 255, 65_535, 2**31 - 1]
        return random.choice(np.array(wide), rows)
    values = random.choice([0.0, 1.0, -8.8, 63.9, 359.0, 1e30, -1e30, np.nan, np.inf], rows)
    return np.where(random.random(rows) < 0.5, random.normal(0.0, 50.0, rows), values)


def nonsense(seed: int) -> MadeLog:
    random = np.random.default_rng(seed)
    tables = []
    for name, columns in TABLES.items():
        if random.random() < 0.4:
            continue
        rows = int(random.choice([1, 2, 3, 40]))
        stamps = np.sort(random.integers(0, 100 * 10**9, rows))
        if random.random() < 0.3:
            stamps = random.choice([0, 10**9, 2**62], rows)
        kept = [one for one in columns if random.random() < 0.85]
        values = {one: column(one, rows, random) for one in kept}
        instance = "C" if "C" in kept else None
        tables.append(MadeTable(name, stamps, values, instance))
    said = random.choice(SENTENCES, 6)
    tables.append(MadeTable("MSG", np.arange(6) * 10**9, {"Message": said}))
    tables.append(
        MadeTable("PARM", np.arange(4), {"Name": ["A", "A", "", "FS_EKF_THRESH"], "Value": [1.0, np.nan, 2.0, 0.0]})
    )
    return MadeLog(*tables)


@pytest.mark.parametrize("seed", range(60))
def test_nonsense(seed: int) -> None:
    sound_sections(nonsense(seed), ANALYSES)


def test_an_empty_log() -> None:
    for kind in ("dataflash", "mcap", "tlog"):
        sound_sections(MadeLog(kind=kind))


@pytest.mark.medium
@pytest.mark.parametrize("seed", range(3))
def test_a_damaged_log(seed: int, tmp_path: Path) -> None:
    """One byte in a thousand is another one."""
    data = np.fromfile(CALM, np.uint8)[:1_500_000]
    random = np.random.default_rng(seed)
    places = random.integers(0, len(data), len(data) // 1000)
    data[places] = random.integers(0, 256, len(places))
    data.tofile(tmp_path / "damaged.bin")
    with open_log(tmp_path / "damaged.bin") as log:
        sound_sections(log)
