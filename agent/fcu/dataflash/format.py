"""Records of a DataFlash log: A3 95, a type number, a packed little-endian payload.

The log describes itself. FMT gives each type's letters and columns, FMTU its units and multipliers. UNIT and MULT
define their characters.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable, Mapping
from typing import Any, Callable

FMT_TYPE = 128
FMT_ROW = ("FMT", "BBnNZ", "Type,Length,Name,Format,Columns", "-b---", "-----")
_HEAD = b"\xa3\x95"

# Letter: struct code, and the divisor of a reader.
_LETTERS: Mapping[str, tuple[str, float]] = {
    "b": ("b", 1),
    "B": ("B", 1),
    "h": ("h", 1),
    "H": ("H", 1),
    "i": ("i", 1),
    "I": ("I", 1),
    "q": ("q", 1),
    "Q": ("Q", 1),
    "f": ("f", 1),
    "d": ("d", 1),
    "n": ("4s", 1),
    "N": ("16s", 1),
    "Z": ("64s", 1),
    "M": ("B", 1),
    "c": ("h", 100),
    "C": ("H", 100),
    "e": ("i", 100),
    "E": ("I", 100),
    "L": ("i", 1e7),
}
_INTEGERS = {
    code: (-(1 << bits - 1), (1 << bits - 1) - 1) if code.islower() else (0, (1 << bits) - 1)
    for code, bits in (("b", 8), ("B", 8), ("h", 16), ("H", 16), ("i", 32), ("I", 32), ("q", 64), ("Q", 64))
}
_LARGEST_FLOAT = 3.4028234e38

# The characters are ArduPilot's. `#` marks the column that distinguishes the instances of a message.
UNITS: Mapping[str, str] = {
    "-": "",
    "?": "UNKNOWN",
    "#": "instance",
    "%": "%",
    "b": "B",
    "d": "deg",
    "D": "deglatitude",
    "E": "rad/s",
    "G": "Gauss",
    "h": "degheading",
    "k": "deg/s",
    "m": "m",
    "n": "m/s",
    "o": "m/s/s",
    "O": "degC",
    "P": "Pa",
    "s": "s",
    "S": "satellites",
    "U": "deglongitude",
    "Y": "us",
    "z": "Hz",
}
MULTIPLIERS: Mapping[str, float] = {
    "-": 0.0,
    "?": 1.0,
    "0": 1.0,
    "A": 1e-1,
    "B": 1e-2,
    "C": 1e-3,
    "F": 1e-6,
    "G": 1e-7,
}
_SERVOS = ",".join(f"C{channel}" for channel in range(1, 15))
_ROWS = (
    ("FMTU", "QBNN", "TimeUS,FmtType,UnitIds,MultIds", "s---", "F---"),
    ("UNIT", "QbZ", "TimeUS,Id,Label", "s--", "F--"),
    ("MULT", "Qbd", "TimeUS,Id,Mult", "s--", "F--"),
    ("PARM", "QNff", "TimeUS,Name,Value,Default", "s---", "F---"),
    ("MSG", "QZ", "TimeUS,Message", "s-", "F-"),
    ("MODE", "QMBB", "TimeUS,Mode,ModeNum,Rsn", "s---", "F---"),
    ("ARM", "QBI", "TimeUS,ArmState,ArmChecks", "s--", "F--"),
    ("EV", "QB", "TimeUS,Id", "s-", "F-"),
    ("ERR", "QBB", "TimeUS,Subsys,ECode", "s--", "F--"),
    (
        "CMD",
        "QHHHffffLLfB",
        "TimeUS,CTot,CNum,CId,Prm1,Prm2,Prm3,Prm4,Lat,Lng,Alt,Frame",
        "s-------DUm-",
        "F-------GG0-",
    ),
    (  # the item that becomes active
        "MISE",
        "QHHHffffLLfB",
        "TimeUS,CTot,CNum,CId,Prm1,Prm2,Prm3,Prm4,Lat,Lng,Alt,Frame",
        "s-------DUm-",
        "F-------GG0-",
    ),
    (
        "IMU",
        "QBfffffffQ",
        "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,T,SampleUS",
        "s#EEEoooOs",
        "F-000000-F",
    ),
    (  # GMS and GWk are 0 until GPS time is known
        "GPS",
        "QBBIHBLLefffBQ",
        "TimeUS,I,Status,GMS,GWk,NSats,Lat,Lng,Alt,Spd,GCrs,VZ,U,SampleUS",
        "s#-s-SDUmnhn-s",
        "F--C-0GGB000-F",
    ),
    ("GPA", "QBCCCBIH", "TimeUS,I,HAcc,VAcc,SAcc,VV,SMS,Delta", "s#mmn-ss", "F-BBB-CC"),
    ("MAG", "QBhhhhhhQ", "TimeUS,I,MagX,MagY,MagZ,OfsX,OfsY,OfsZ,SampleUS", "s#GGGGGGs", "F-CCCCCCF"),
    ("BARO", "QBfcQ", "TimeUS,I,Press,Temp,SampleUS", "s#POs", "F-0BF"),
    ("ATT", "Qffffff", "TimeUS,DesRoll,Roll,DesPitch,Pitch,DesYaw,Yaw", "sddddhh", "F000000"),
    ("POS", "QLLfff", "TimeUS,Lat,Lng,Alt,RelHomeAlt,RelOriginAlt", "sDUmmm", "FGG000"),
    (
        "XKF1",
        "QBccCffffffccce",
        "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,PN,PE,PD,GX,GY,GZ,OH",
        "s#ddhnnnmmmkkkm",
        "F-BBB000000BBBB",
    ),
    ("XKF4", "QBccccI", "TimeUS,C,SV,SP,SH,SM,SS", "s#-----", "F------"),
    ("XKQ", "QBffff", "TimeUS,C,Q1,Q2,Q3,Q4", "s#????", "F-????"),
    (  # variances by the numbers of EKF3's states: velocity NED is 4 to 6, position NED 7 to 9
        "XKV1",
        "QBffffffffffff",
        "TimeUS,C,V00,V01,V02,V03,V04,V05,V06,V07,V08,V09,V10,V11",
        "s#------------",
        "F-------------",
    ),
    ("ORGN", "QBLLe", "TimeUS,Type,Lat,Lng,Alt", "s#DUm", "F-GGB"),
    ("RCIN", "Q" + "H" * 14, "TimeUS," + _SERVOS, "s" + "Y" * 14, "F" + "-" * 14),
    ("RCOU", "Q" + "H" * 14, "TimeUS," + _SERVOS, "s" + "Y" * 14, "F" + "-" * 14),
    ("NTUN", "QfffHf", "TimeUS,WpDist,WpBrg,DesYaw,Yaw,XTrack", "smhhhm", "F000B0"),
    ("STER", "Qhff", "TimeUS,SteerIn,LatAcc,TurnRate", "s-ok", "F-00"),
    ("THR", "Qhff", "TimeUS,ThrIn,DesSpeed,Speed", "s-nn", "F-00"),
    ("PM", "QHHHIH", "TimeUS,LR,NLon,NL,MaxT,Load", "sz---%", "F----A"),
    ("DSF", "QII", "TimeUS,Dp,Bytes", "s-b", "F-0"),
)
_TASK = (
    "TASK",
    "QBNfIIIIfIf",
    "TimeUS,I,Name,Rate,N,Miss,Skip,JMax,JMean,RMax,RMean",
    "s#-z---YYYY",
    "F--0---0000",
)
_QUANTILES = (  # J50: median of the start delay, from the histogram; JAtUS: time of the worst start
    "TSKQ",
    "QBIIQIIQ",
    "TimeUS,I,J50,J99,JAtUS,R50,R99,RAtUS",
    "s#YYsYYs",
    "F-00F00F",
)
_MISS = (  # Late: from DueUS to the start; Run: from the start to the end
    "MISS",
    "QNIQIII",
    "TimeUS,Name,Cycle,DueUS,Late,Run,Skip",
    "s--sYY-",
    "F--F00-",
)
_PM_IN_LOCKSTEP = ("PM", "QHHHI", "TimeUS,LR,NLon,NL,MaxT", "sz---", "F----")


class RecordFormat:
    """One type of record. `units` and `multipliers` have one character per column, as in FMTU.

    `pack` takes the values as a reader shows them: degrees for a letter L, whole milligauss for a letter h with a milli
    multiplier. It never raises for a value. A number out of range becomes the nearest possible one, NaN becomes 0 in an
    integer, and text is truncated. A wrong number of values raises struct.error.
    """

    def __init__(self, type_id: int, name: str, letters: str, columns: str, units: str, multipliers: str) -> None:
        names = columns.split(",")
        if not (0 < len(letters) <= 16 and len(names) == len(letters) == len(units) == len(multipliers)):
            raise ValueError(f"format {name}: give each of at most 16 columns a name, letter, unit and multiplier")
        if not (len(name) <= 4 and len(columns) <= 64 and 0 <= type_id <= 255):
            raise ValueError(f"format {name}: 4 characters of name, 64 of columns, and a type up to 255 fit")
        tables = ((letters, _LETTERS), (units, UNITS), (multipliers, MULTIPLIERS))
        unknown = [character for characters, table in tables for character in characters if character not in table]
        if unknown:
            raise ValueError(f"format {name}: no such letter, unit or multiplier: {' '.join(unknown)}")
        self.type_id = type_id
        self.name = name
        self.letters = letters
        self.columns = columns
        self.units = units
        self.multipliers = multipliers
        self._struct = struct.Struct("<3s" + "".join(_LETTERS[letter][0] for letter in letters))
        self.length = self._struct.size
        self.pack = self._packer()

    def _packer(self) -> Callable[..., bytes]:
        pack, prefix, letters = self._struct.pack, _HEAD + bytes((self.type_id,)), self.letters
        scaled = [(index, _LETTERS[letter][1]) for index, letter in enumerate(letters) if _LETTERS[letter][1] != 1]

        def plain(*values: Any) -> bytes:
            try:
                return pack(prefix, *values)
            except (struct.error, OverflowError):
                return pack(prefix, *map(_fitting, letters, values), *values[len(letters) :])

        def scaling(*values: Any) -> bytes:
            row = list(values)
            try:
                for index, factor in scaled:
                    row[index] = round(row[index] * factor)
                return pack(prefix, *row)
            except (struct.error, OverflowError, ValueError, IndexError):
                return pack(prefix, *map(_fitting, letters, values), *values[len(letters) :])

        return scaling if scaled else plain


def formats(rows: Iterable[tuple[str, str, str, str, str]]) -> dict[str, RecordFormat]:
    """Return the formats of a log by name, FMT first. The type number of each is its position in the rows."""
    by_name = {"FMT": RecordFormat(FMT_TYPE, *FMT_ROW)}
    for place, row in enumerate(rows, start=1):
        if row[0] in by_name:
            raise ValueError(f"format {row[0]} is defined twice")
        by_name[row[0]] = RecordFormat(place if place < FMT_TYPE else place + 1, *row)
    return by_name


def header(known: Mapping[str, RecordFormat], now_us: int) -> bytes:
    """Return the start of a log. `known` includes FMT, FMTU, UNIT and MULT."""
    if now_us <= 255:
        now_us = 0  # pymavlink reads the first bytes of FMTU as a type number, and 0 is not used
    fmt, fmtu, unit, mult = (known[name].pack for name in ("FMT", "FMTU", "UNIT", "MULT"))
    records = [fmt(f.type_id, f.length, f.name, f.letters, f.columns) for f in known.values()]
    records += [unit(now_us, ord(character), label) for character, label in UNITS.items()]
    records += [mult(now_us, ord(character), factor) for character, factor in MULTIPLIERS.items()]
    records += [fmtu(now_us, f.type_id, f.units, f.multipliers) for f in known.values()]
    return b"".join(records)


def _fitting(letter: str, value: Any) -> Any:
    """Return the nearest value that can be packed."""
    code, factor = _LETTERS[letter]
    if code.endswith("s"):
        return value.encode("ascii", "replace") if isinstance(value, str) else value
    if code == "d":
        return value
    if code == "f":
        return math.copysign(math.inf, value) if abs(value) > _LARGEST_FLOAT else value
    if value != value:
        return 0
    low, high = _INTEGERS[code]
    if isinstance(value, int) and factor == 1:
        return min(max(value, low), high)
    return round(min(max(value * factor, low), high))


FORMATS = formats((*_ROWS, _TASK, _QUANTILES, _MISS))
FORMATS_IN_LOCKSTEP = formats(_PM_IN_LOCKSTEP if row[0] == "PM" else row for row in _ROWS)
