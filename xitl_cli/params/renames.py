"""Parameters of ArduPilot Rover that changed their names from one version to the next.

From the release notes of Rover and from the conversions in its source, which name old and new. Values carry over where
nothing is said.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Rename:
    """`new` since `version`; `note` where the value does not simply carry over."""

    old: str
    new: str
    version: str
    note: str = ""


def _receivers() -> Iterator[Rename]:
    for number, suffix in ((1, ""), (2, "2")):
        yield Rename(f"GPS_TYPE{suffix}", f"GPS{number}_TYPE", "4.6")
        yield Rename(f"GPS_GNSS_MODE{suffix}", f"GPS{number}_GNSS_MODE", "4.6")
        yield Rename(f"GPS_RATE_MS{suffix}", f"GPS{number}_RATE_MS", "4.6")
        yield Rename(f"GPS_DELAY_MS{suffix}", f"GPS{number}_DELAY_MS", "4.6")
        yield Rename(f"GPS_COM_PORT{suffix}", f"GPS{number}_COM_PORT", "4.6")
        yield Rename(f"GPS_CAN_NODEID{number}", f"GPS{number}_CAN_NODEID", "4.6")
        yield Rename(f"GPS_MB{number}_TYPE", f"GPS{number}_MB_TYPE", "4.6")
        for axis in "XYZ":
            yield Rename(f"GPS_POS{number}_{axis}", f"GPS{number}_POS_{axis}", "4.6")
            yield Rename(f"GPS_MB{number}_OFS_{axis}", f"GPS{number}_MB_OFS_{axis}", "4.6")


_STREAMS = ("RAW_SENS", "EXT_STAT", "RC_CHAN", "RAW_CTRL", "POSITION", "EXTRA1", "EXTRA2", "EXTRA3", "PARAMS", "ADSB")

RENAMES: tuple[Rename, ...] = (
    *_receivers(),
    Rename("COMPASS_TYPEMASK", "COMPASS_DISBLMSK", "4.5"),
    Rename("BRD_SAFETYENABLE", "BRD_SAFETY_DEFLT", "4.4"),
    Rename("SYSID_THISMAV", "MAV_SYSID", "4.7"),
    Rename("SYSID_MYGCS", "MAV_GCS_SYSID", "4.7"),
    Rename("SYSID_ENFORCE", "MAV_OPTIONS", "4.7", "bit 0"),
    Rename("TELEM_DELAY", "MAV_TELEM_DELAY", "4.7"),
    *(Rename(f"SR{port}_{name}", f"MAV{port + 1}_{name}", "4.7") for port in range(7) for name in _STREAMS),
    Rename("ARMING_CHECK", "ARMING_SKIPCHK", "4.7", "it names the checks that are left out: 1 becomes 0"),
)


def other_name(name: str, present: Mapping[str, float]) -> Rename | None:
    """The rename by which `present` has the parameter, though not by this name; None where there is none."""
    for rename in RENAMES:
        if (rename.old == name and rename.new in present) or (rename.new == name and rename.old in present):
            return rename
    return None
