"""Vehicle, board and firmware by number: APM_BUILD (AP_Vehicle_Type.h), HAL_BOARD (AP_HAL_Boards.h), MAV_TYPE and
FIRMWARE_VERSION_TYPE of MAVLink.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

VehicleKind = Literal["rover", "copter", "plane", "sub", "unknown"]

_BUILDS: Mapping[int, VehicleKind] = {1: "rover", 2: "copter", 3: "plane", 7: "sub", 13: "copter"}
_IN_NAMES: tuple[tuple[str, VehicleKind], ...] = (
    ("rover", "rover"),
    ("copter", "copter"),
    ("heli", "copter"),
    ("plane", "plane"),
    ("sub", "sub"),
)
_KINDS_BY_TYPE: tuple[tuple[VehicleKind, tuple[int, ...]], ...] = (
    ("plane", (1, 7, 16, 19, 20, 21, 22, 23, 24, 25, 28)),
    ("copter", (2, 3, 4, 13, 14, 15, 29, 35)),
    ("rover", (10, 11)),
    ("sub", (12,)),
)


def kind_from_build(number: int) -> VehicleKind:
    """Kind of vehicle from VER.BU."""
    return _BUILDS.get(number, "unknown")


def kind_from_name(text: str) -> VehicleKind:
    """Kind of vehicle from a firmware's name."""
    lower = text.lower()
    return next((kind for part, kind in _IN_NAMES if part in lower), "unknown")


def kind_from_mav_type(number: int) -> VehicleKind:
    """Kind of vehicle from HEARTBEAT.type of an ArduPilot."""
    return next((kind for kind, numbers in _KINDS_BY_TYPE if number in numbers), "unknown")


MAV_TYPES: Mapping[int, str] = {
    1: "fixed wing", 2: "quadrotor", 3: "coaxial helicopter", 4: "helicopter", 5: "antenna tracker",
    10: "ground rover", 11: "surface boat", 12: "submarine", 13: "hexarotor", 14: "octorotor", 15: "tricopter",
    29: "dodecarotor", 35: "decarotor",
}  # fmt: skip
_BOARDS: Mapping[int, str] = {3: "SITL (a simulator)", 7: "Linux", 10: "ChibiOS", 12: "ESP32", 13: "QURT", 99: "none"}
_SUBTYPES: Mapping[int, str] = {
    1000: "", 1001: "Erle-Board", 1002: "PXF", 1003: "Navio", 1004: "Zynq", 1005: "BBBMini", 1006: "Bebop",
    1009: "Erle-Brain 2", 1010: "BH", 1012: "PXFmini", 1013: "Navio2", 1014: "Disco", 1015: "Aero", 1016: "DARK",
    1018: "BeagleBone Blue", 1019: "OcPoC Zynq", 1020: "Edge", 1021: "RST Zynq", 1022: "PocketBeagle",
    1023: "Navigator", 1024: "VNav", 1025: "OBAL", 1026: "CANZero", 1027: "PilotPi", 1028: "PocketBeagle 2",
    5001: "FMUv3", 5009: "generic", 5013: "FMUv5",
}  # fmt: skip
SITL_BOARD = 3
SURFACE_BOAT = 11  # MAV_TYPE
BOAT_FRAME = 2  # FRAME_CLASS of Rover


@dataclass(frozen=True, slots=True)
class MotionLimits:
    """Normal motion of a class of vehicles."""

    lean_deg: float | None
    """Normal roll and pitch; None if any is normal."""
    lean_s: float
    """Time for which a larger lean is normal."""
    overturned_deg: float
    """Tilt from which the vehicle does not right itself."""
    shock_mps2: float
    """Acceleration without gravity that waves, kerbs, gusts and landings cause."""


MOTION_LIMITS: Mapping[VehicleKind, MotionLimits] = {
    # A hull heels to 30 deg in waves and rights itself from 60 to 90; small craft slam at 2 to 3 g (ISO 12217, 2631-5).
    "rover": MotionLimits(45.0, 1.0, 80.0, 35.0),
    # Lean is limited by ANGLE_MAX; hard landings reach 3 g.
    "copter": MotionLimits(65.0, 0.5, 90.0, 40.0),
    # Bank is limited by ROLL_LIMIT_DEG; belly landings and catapults reach 5 g.
    "plane": MotionLimits(65.0, 1.0, 100.0, 60.0),
    "sub": MotionLimits(None, 1.0, 100.0, 30.0),
    "unknown": MotionLimits(None, 1.0, 90.0, 40.0),
}
_RELEASES: Mapping[int, str] = {
    0: "development", 64: "alpha", 128: "beta", 192: "release candidate", 255: "official release",
}  # fmt: skip


def board_name(board: int, subtype: int) -> str:
    """Name of a board from VER.BT and VER.BST."""
    name = _BOARDS.get(board, f"board type {board}")
    detail = _SUBTYPES.get(subtype, "")
    return f"{name} {detail}".strip()


def release_name(number: int) -> str:
    """Release type from VER.FWT, or from the lowest byte of AUTOPILOT_VERSION.flight_sw_version."""
    below = [edge for edge in _RELEASES if edge <= number]
    return _RELEASES[max(below)] if below else ""
