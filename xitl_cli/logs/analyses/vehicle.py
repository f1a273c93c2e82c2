"""Origin of the log: vehicle, firmware, board, date, duration, completeness."""

from __future__ import annotations

import datetime
import re
from collections.abc import Iterator, Mapping

import numpy as np

from xitl_cli.logs.clocks.readings import utc_offset
from xitl_cli.logs.clocks.time_line import LogClock
from xitl_cli.logs.model.codes import MAV_TYPES, SITL_BOARD, board_name, release_name
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Section, Value
from xitl_cli.logs.model.table import Table
from xitl_cli.logs.model.text import length_text
from xitl_cli.logs.signals import px4
from xitl_cli.logs.signals.series import rounded
from xitl_cli.logs.signals.spans import spells
from xitl_cli.logs.signals.states import (
    LOCKSTEP,
    autopilot_heartbeats,
    autopilot_messages,
    firmware_text,
    first_text,
    last_parameters,
    vehicle_kind,
)

_EMBEDDED = re.compile(r"^xitl (\S+), messages and modes as")
_HASH = re.compile(r"\(([0-9a-f]{6,12})\)")
_REBOOT_NS = 1_000_000_000
_STEADY = ("IMU", "ATT", "PARM", "GPS", "MSG")


def analyse(log: Log) -> Section | None:
    if log.span_ns is None:
        return None
    facts = facts_of(log)
    findings = [*_simulated(log, last_parameters(log)), *_reboots(log), *_losses(log)]
    lacks = []
    if not {"firmware", "firmware_version", "firmware_commit", "firmware_release", "board"} & {f.key for f in facts}:
        lacks.append("Which firmware this was is not logged: no VER, no firmware name in MSG, no AUTOPILOT_VERSION.")
    return Section("vehicle", "Vehicle", facts, tuple(findings), lacks=tuple(lacks))


def facts_of(log: Log) -> tuple[Fact, ...]:
    """Facts from the log without an analysis, which is fast. Empty for a log without a stamped row."""
    if log.span_ns is None:
        return ()
    beats = autopilot_heartbeats(log)
    parameters = last_parameters(log)
    logging: list[Fact] = []
    rows = (("LOG_BITMASK", "log_bitmask"), ("LOG_DISARMED", "log_disarmed"), ("LOG_BACKEND_TYPE", "log_backend"))
    logging.extend(
        Fact(key, name, int(parameters[name])) for name, key in rows if abs(parameters.get(name, np.inf)) < 2**32
    )
    clock = LogClock(log)
    times: list[Fact] = []
    length_s = (clock.end_ns - clock.start_ns) * 1e-9
    times.append(Fact("duration_s", "Duration", rounded(length_s, 1), "s"))
    if log.base == "boot" and not log.zero_ns:
        times.append(Fact("uptime_start_s", "Uptime at the start", rounded(clock.start_ns * 1e-9, 1), "s"))
        times.append(Fact("uptime_end_s", "Uptime at the end", rounded(clock.end_ns * 1e-9, 1), "s"))
    start, source = _utc_at_start(log, clock)
    if start is not None:
        times.append(Fact("utc_start", f"UTC at the start ({source})", start.strftime("%Y-%m-%d %H:%M:%S")))
    times.extend(
        Fact(f"recording_{key}", label, log.facts[key])
        for key, label in (("profile", "Profile"), ("technique", "Technique"), ("seed", "Seed"))
        if key in log.facts
    )
    every = (
        Fact("vehicle", "Vehicle", None if (kind := vehicle_kind(log)) == "unknown" else kind),
        Fact("vehicle_type", "Type", None if beats is None else MAV_TYPES.get(int(beats.values("type", raw=True)[0]))),
        *_firmware(log),
        *times,
        *logging,
    )
    return tuple(fact for fact in every if fact.value is not None)


def _firmware(log: Log) -> Iterator[Fact]:
    text = firmware_text(log)
    version = log.tables.get("VER")
    said = autopilot_messages(log, "AUTOPILOT_VERSION")
    name: Value = text
    number_text: Value = None
    commit: Value = None
    build: Value = None
    board: Value = None
    if text is not None and (own := _EMBEDDED.match(text)):
        name, number_text = "xitl embedded autopilot", own.group(1)
    elif text is not None and (found := _HASH.search(text)):
        commit = found.group(1)
    if version is not None:
        row = {column: version.values(column, raw=True)[-1] for column in version.columns}
        name = str(row["FWS"]) if "FWS" in row and str(row["FWS"]) else name
        if {"Maj", "Min", "Pat"} <= set(row):
            number_text = f"{row['Maj']}.{row['Min']}.{row['Pat']}"
        commit = f"{int(row['GH']):08x}" if "GH" in row else commit
        build = release_name(int(row["FWT"])) if "FWT" in row else None
        board = board_name(int(row["BT"]), int(row.get("BST", 0))) if "BT" in row else None
    elif said is not None and "flight_sw_version" in said.columns:
        packed = int(said.values("flight_sw_version", raw=True)[-1])
        if packed:
            number_text = number_text or f"{packed >> 24}.{packed >> 16 & 255}.{packed >> 8 & 255}"
            build = release_name(packed & 255)
        commit = commit or _custom_version(said)
    if log.format == "ulog":
        name = log.facts.get("sys_name")
        number_text, commit, board = px4.release(log)
    yield Fact("firmware", "Firmware", name)
    yield Fact("firmware_version", "Version", number_text)
    yield Fact("firmware_commit", "Commit", commit)
    yield Fact("firmware_release", "Release", build or None)
    yield Fact("board", "Board", board)


def _custom_version(said: Table) -> str | None:
    if "flight_custom_version" not in said.columns:
        return None
    characters = np.asarray(said.values("flight_custom_version", raw=True))[-1:].ravel()
    text = bytes(int(each) & 255 for each in characters).split(b"\0", 1)[0].decode("ascii", "replace")
    return text if text.isprintable() and text else None


def _utc_at_start(log: Log, clock: LogClock) -> tuple[datetime.datetime | None, str]:
    found = utc_offset(log)
    if found is None:
        return None, ""
    try:
        epoch = datetime.datetime(1970, 1, 1, tzinfo=datetime.UTC)
        return epoch + datetime.timedelta(microseconds=(clock.start_ns + found.offset_ns) // 1000), found.source
    except OverflowError:
        return None, ""


def _simulated(log: Log, parameters: Mapping[str, float]) -> Iterator[Finding]:
    if log.format == "ulog":
        if "SITL" in log.facts.get("ver_hw", "").upper():
            yield _simulated_finding("PX4", (Evidence("ver_hw", value=log.facts["ver_hw"]),))
        return
    version = log.tables.get("VER")
    evidence: list[Evidence] = []
    if version is not None and "BT" in version.columns and int(version.values("BT", raw=True)[-1]) == SITL_BOARD:
        evidence.append(Evidence("VER", "BT", value=str(SITL_BOARD)))
    if "SIM" in log.tables:
        evidence.append(Evidence("SIM"))
    if any(name.startswith("SIM_") for name in parameters):
        evidence.append(Evidence("PARM", "Name", value="SIM_…"))
    if evidence:
        yield _simulated_finding("ArduPilot", tuple(evidence))
        return
    said = first_text(log, LOCKSTEP)
    if said is None:
        return
    sentence = "The embedded autopilot ran in lockstep: its clock stood still while it worked"
    step = "Judge deadlines and load on a run in real time (clock.mode: realtime)."
    evidence = [Evidence("MSG", "Message", said[0], value=said[1])]
    yield Finding.notice("vehicle.lockstep", sentence, tuple(evidence), step)


def _simulated_finding(autopilot: str, evidence: tuple[Evidence, ...]) -> Finding:
    sentence = (
        f"A SITL build of {autopilot} made this log: no board had a part in it, and vibration, power and radio are "
        "what models say"
    )
    step = "Take no processor time, jitter, noise or supply from it; those need a log of the board."
    return Finding.notice("vehicle.simulated", sentence, evidence, step)


def _reboots(log: Log) -> Iterator[Finding]:
    """Clocks that start again. Rows slightly out of order do not count."""
    if log.format != "dataflash":
        return
    counts = []
    for name in _STEADY:
        if (table := log.tables.get(name)) is None:
            continue
        stamps = table.stamp_ns
        if len(stamps) < 4:
            continue
        # Use two rows on either side, because a damaged stamp is a single row.
        before, after = np.minimum(stamps[:-3], stamps[1:-2]), np.maximum(stamps[2:-1], stamps[3:])
        back = np.flatnonzero(after < before - _REBOOT_NS) + 1
        counts.append((len(back), name, [int(stamps[row]) for row in back[:20]]))
    several = sorted(count for count in counts if count[0])
    if not several or len(several) < min(2, len(counts)):
        return
    many, name, last = several[len(several) // 2]
    times = "once" if many == 1 else f"{many} times"
    first = f"the first time after {length_text(last[0] * 1e-9)} of uptime"
    yield Finding.critical(
        "vehicle.reboots",
        f"The autopilot's clock started again {times} inside this log, {first}: it rebooted",
        tuple(Evidence(name, "TimeUS", at_ns) for at_ns in last),
        "Look at supply voltage, watchdog (WDOG) and the last messages before; judge each part by itself.",
    )


def _losses(log: Log) -> Iterator[Finding]:
    table = log.tables.get("DSF")
    if table is None or "Dp" not in table.columns:
        return
    dropped = np.asarray(table.values("Dp", raw=True), dtype=np.int64)
    new = np.diff(dropped, prepend=0)
    new[new < 0] = dropped[new < 0]
    lost = int(new.sum())
    if lost == 0:
        return
    sentence = f"{lost} records never reached this log: the logger had no room for them"
    spans = spells(table.stamp_ns, new > 0)
    evidence = tuple(Evidence("DSF", "Dp", begin, end, str(lost)) for begin, end in spans)
    step = "Use a faster card, raise LOG_FILE_BUFSIZE or log less (LOG_BITMASK); gaps here need not be gaps in flight."
    yield Finding.warning("vehicle.log_dropped", sentence, evidence, step)
