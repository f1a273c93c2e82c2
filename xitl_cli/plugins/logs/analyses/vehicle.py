"""Origin of the log: vehicle, firmware, board, date, duration, completeness."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from xitl_cli.logs.model.codes import SITL_BOARD
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Evidence, Finding, Section
from xitl_cli.logs.model.text import length_text
from xitl_cli.logs.signals.spans import spells
from xitl_cli.logs.signals.states import (
    LOCKSTEP,
    first_text,
    last_parameters,
)
from xitl_cli.logs.summary import vehicle_facts

_REBOOT_NS = 1_000_000_000
_STEADY = ("IMU", "ATT", "PARM", "GPS", "MSG")


def analyse(log: Log) -> Section | None:
    if log.span_ns is None:
        return None
    facts = vehicle_facts(log)
    findings = [*_simulated(log, last_parameters(log)), *_reboots(log), *_losses(log)]
    lacks = []
    if not {"firmware", "firmware_version", "firmware_commit", "firmware_release", "board"} & {f.key for f in facts}:
        lacks.append("The firmware is not logged: no VER, no firmware name in MSG, no AUTOPILOT_VERSION.")
    return Section("vehicle", "Vehicle", facts, tuple(findings), lacks=tuple(lacks))


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
    sentence = "The embedded autopilot ran in lockstep: its clock stopped while it computed"
    step = "Judge deadlines and load with a run in real time (clock.mode: realtime)."
    evidence = [Evidence("MSG", "Message", said[0], value=said[1])]
    yield Finding.notice("vehicle.lockstep", sentence, tuple(evidence), step)


def _simulated_finding(autopilot: str, evidence: tuple[Evidence, ...]) -> Finding:
    sentence = (
        f"A SITL build of {autopilot} made this log: no board was involved, and vibration, power and radio are "
        "values of models"
    )
    step = "Do not use its processor time, jitter, noise or supply. They need a log of the board."
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
        "Look at supply voltage, watchdog (WDOG) and the last messages before. Judge each part separately.",
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
    sentence = f"{lost} records are missing in this log: the logger had no space for them"
    spans = spells(table.stamp_ns, new > 0)
    evidence = tuple(Evidence("DSF", "Dp", begin, end, str(lost)) for begin, end in spans)
    step = "Use a faster card, raise LOG_FILE_BUFSIZE or log less (LOG_BITMASK). A gap here need not be one in flight."
    yield Finding.warning("vehicle.log_dropped", sentence, evidence, step)
