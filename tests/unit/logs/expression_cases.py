"""Expressions over a made log, for the one who reads them here and the one in the report's page."""

from __future__ import annotations

import numpy as np
from made_log import MadeLog, MadeTable

S = 1_000_000_000


def made_signals() -> MadeLog:
    """ATT at 10 Hz with a heading through north, XKF1 at 7 Hz with two instances, GPS at 3 Hz and late, MODE twice."""
    att_s = np.arange(0.0, 20.0, 0.1)
    core_s = np.arange(0.05, 21.0, 1.0 / 7.0)
    gps_s = np.arange(2.0, 18.0, 1.0 / 3.0)
    cores = np.tile([0, 1], len(core_s))
    twice_s = np.repeat(core_s, 2)
    roll = 10.0 * np.sin(att_s)
    roll[50] = np.nan
    return MadeLog(
        MadeTable(
            "ATT",
            ns(att_s),
            {"Roll": roll, "Yaw": np.mod(350.0 + 4.0 * att_s, 360.0), "DesYaw": np.full(len(att_s), 5.0)},
            units={"Roll": "deg", "Yaw": "deg", "DesYaw": "deg"},
        ),
        MadeTable(
            "XKF1",
            ns(twice_s),
            {"C": cores, "VN": 3.0 + 0.1 * twice_s + cores, "VE": 4.0 - 0.05 * twice_s, "Flags": cores},
            "C",
            units={"VN": "m/s", "VE": "m/s"},
        ),
        MadeTable(
            "GPS",
            ns(gps_s),
            {"Spd": 5.0 + np.cos(gps_s), "GCrs": np.mod(355.0 + 5.0 * gps_s, 360.0), "NSats": (gps_s // 4).astype(int)},
            units={"Spd": "m/s", "GCrs": "deg"},
        ),
        MadeTable("MODE", [S, 9 * S], {"ModeNum": [4, 10]}),
        MadeTable("/truth/state", ns(gps_s), {"pose.x": gps_s**2, "v_mps": np.stack([gps_s, -gps_s], axis=1)}),
    )


def ns(seconds: np.ndarray) -> np.ndarray:  # type: ignore[type-arg]
    return np.rint(seconds * S).astype(np.int64)


CASES = (
    "ATT.Roll",
    "ATT.DesYaw - ATT.Yaw",
    "wrap180(ATT.DesYaw - ATT.Yaw)",
    "wrap360(ATT.Roll)",
    "wrap_pi(radians(ATT.Roll) * 40)",
    "hypot(XKF1.VN, XKF1.VE)",
    "hypot(XKF1[1].VN, XKF1[0].VE)",
    "hypot(XKF1.VN, XKF1.VE) - GPS.Spd",
    "GPS.GCrs - ATT.Yaw",
    "wrap180(GPS.GCrs - ATT.Yaw)",
    "GPS.NSats + 0 * ATT.Yaw",
    "MODE.ModeNum + 0 * ATT.Yaw",
    "where(MODE.ModeNum == 10 and ATT.Roll > 0, ATT.Roll, -1)",
    "not ATT.Roll > 2",
    "0 < ATT.Roll <= 5 or ATT.Yaw > 300",
    "ATT.Roll == ATT.Roll",
    "ATT.Roll != ATT.Roll",
    "-ATT.Roll ** 2",
    "2 ** -ATT.Roll / 3",
    "ATT.Roll % 3",
    "ATT.Roll % -3",
    "(ATT.Roll + 1) * 2 - 3 / 4",
    "ATT.Roll - 1 - 2",
    "ATT.Roll / 2 / 5",
    "abs(ATT.Roll) + sign(ATT.Roll) + floor(ATT.Roll) + ceil(ATT.Roll)",
    "sqrt(ATT.Roll)",
    "exp(ATT.Roll / 10) + log(abs(ATT.Roll) + 1) + log10(abs(ATT.Roll) + 1)",
    "sin(radians(ATT.Roll)) + cos(radians(ATT.Roll)) + tan(radians(ATT.Roll))",
    "asin(ATT.Roll / 10) + acos(ATT.Roll / 10) + atan(ATT.Roll)",
    "degrees(atan2(XKF1.VE, XKF1.VN))",
    "min(ATT.Roll, 3, ATT.Yaw)",
    "max(ATT.Roll, -3)",
    "clip(ATT.Roll, -2, 2)",
    "unwrap(ATT.Yaw)",
    "unwrap(radians(ATT.Yaw))",
    "diff(ATT.Roll)",
    "derivative(unwrap(ATT.Yaw))",
    "derivative(XKF1.VN)",
    "integral(hypot(XKF1.VN, XKF1.VE))",
    "integral(ATT.Roll)",
    "smooth(ATT.Roll, 1.5)",
    "smooth(GPS.Spd, 4) - GPS.Spd",
    "/truth/state.pose.x / 2",
    "/truth/state.pose.x/time_s",
    "/truth/state.v_mps[1] - /truth/state.v_mps[0]",
    "/truth/state.pose.x - XKF1[0].VN",
    "time_s - ATT.Roll * 0",
    "1e-2 * ATT.Roll + .5",
    "true and ATT.Roll > 0",
    "hypot(XKF1.VN, XKF1.VE, 1)",
)

UNITS = {
    "ATT.DesYaw - ATT.Yaw": "deg",
    "hypot(XKF1.VN, XKF1.VE)": "m/s",
    "derivative(XKF1.VN)": "m/s/s",
    "integral(hypot(XKF1.VN, XKF1.VE))": "m",
    "derivative(unwrap(ATT.Yaw))": "deg/s",
    "radians(derivative(ATT.Roll))": "rad/s",
    "degrees(atan2(XKF1.VE, XKF1.VN))": "deg",
    "XKF1.VN ** 2": "m²/s/s",
    "sqrt(XKF1.VN ** 2 + XKF1.VE ** 2)": "m/s",
    "2 * ATT.Roll + 1": "deg",
    "ATT.Roll + XKF1.VN": "",
    "XKF1.VN / XKF1.VE": "",
    "XKF1.VN / integral(XKF1.VE)": "1/s",
    "XKF1.VN / integral(XKF1.VE) * integral(XKF1.VE)": "m/s",
    "1 / GPS.Spd": "s/m",
    "MODE.ModeNum * 2": "",
    "ATT.Roll > 2": "",
    "sin(radians(ATT.Roll))": "",
    "where(ATT.Roll > 0, XKF1.VN, 0)": "m/s",
}
REFUSED = (
    "ATT.Roll -",
    "ATT.Roll = 2",
    "sin(ATT.Roll",
    "nosuch(ATT.Roll)",
    "abs()",
    "abs(ATT.Roll, 1)",
    "ATT.Roll; 1",
    "ATT.Roll if 1 else 2",
    "[ATT.Roll]",
    "ATT.Roll in 2",
    "__import__('os')",
    "ATT.Roll + 'x'",
    "ATT.Roll and 1",
    "not ATT.Roll",
    "(ATT.Roll > 1) + 1",
    "smooth(ATT.Roll, 0)",
    "smooth(ATT.Roll, ATT.Yaw)",
    "3 + 4",
    "ATT.Yew",
    "ATX.Yaw",
    "XKF1[7].VN",
    "ATT",
    "(" * 60 + "ATT.Roll" + ")" * 60,
    "1" + "+1" * 600,
)
