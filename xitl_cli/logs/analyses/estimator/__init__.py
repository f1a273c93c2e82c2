"""The estimator: when it had an origin and a position, what it refused, where it jumped, how far it was off."""

from __future__ import annotations

import itertools

import numpy as np

from xitl_cli.logs import signals
from xitl_cli.logs.analyses.estimator import agreement, biases, jumps, ratios, truth
from xitl_cli.logs.analyses.estimator.cores import Core, cores, whole
from xitl_cli.logs.analyses.estimator.phases import Origin, Use, first_position_ns, never_positioned, origin, uses
from xitl_cli.logs.analyses.instants import Instants, grid, inside, number
from xitl_cli.logs.log import Log
from xitl_cli.logs.sections import Evidence, Fact, Finding, Grid, Mark, Plot, Section, Severity, Trace
from xitl_cli.logs.text import length_text
from xitl_cli.logs.words.estimator import MAG_FUSION, SOURCE_SETS
from xitl_cli.logs.words.kinds import firmware_text

_HEIGHTS_APART_M = 10.0
_HEIGHT_MOVED_M = 1.0
_MOST_REFUSED = 100  # of each measurement and core, in the table


def analyse(log: Log) -> Section | None:
    every = cores(log)
    tested = ratios.ratios(log, every)
    position, yaw = truth.position_error(log), truth.yaw_error(log)
    if not every and not tested and position is None and yaw is None:
        if log.format == "mcap":
            return None
        lack = "The log has no messages of an estimator (XKF, NKF, EKF_STATUS_REPORT); EK3_LOG_LEVEL 0 logs them."
        return Section("estimator", "Estimator", lacks=(lack,))
    instants = Instants(log)
    stray_m = signals.stray_truth_m(log)
    armed = [(span.from_ns, span.until_ns) for span in signals.armed(log)]
    primary = jumps.primary_core(every)
    core = next((one for one in every if one.number == primary), None)
    found, used = origin(log, every, instants), uses(log)
    if position is not None:
        position = position.while_in(armed)
    if yaw is not None:
        yaw = yaw.while_in(armed)
    facts = [
        Fact("filter", "Filter", _filter(log, every)),
        Fact("cores", "Cores", len(every) or None),
        Fact("primary_core", "Core in use", primary if every else None),
        *_origin_facts(found, every, instants),
        *_selection(log),
        Fact("lane_switches", "Core switches", len(jumps.lane_switches(log, every)) if every else None),
        *ratios.facts(tested, primary, armed),
        *agreement.facts(every, armed),
        *agreement.timing(log),
        *biases.facts(log, core),
        *truth.facts(position, yaw),
    ]
    findings = [
        *_filters(used, armed, instants),
        *never_positioned(every, armed, instants),
        *_height(log, found, instants),
        *ratios.findings(tested, primary, armed, instants),
        *jumps.findings(log, every, core, armed, instants),
        *biases.findings(log, core, instants),
        *agreement.findings(every, armed, stray_m is not None, instants),
        *truth.findings(position, yaw, instants),
        *_not_truth(stray_m),
    ]
    marks = (*_armed_marks(armed), *jumps.marks(log, every, core))
    plots = [*_drawn(ratios.plot(tested, marks)), *_innovations(core, marks), *truth.plots(position, yaw)]
    grids = [each for each in (_uses(used, instants), _refusals(tested, armed, instants)) if each is not None]
    known = tuple(fact for fact in facts if fact.value is not None)
    return Section(
        "estimator", "Estimator", known, tuple(findings), tuple(grids), tuple(plots), _lacks(log, every, core)
    )


def _filter(log: Log, every: list[Core]) -> str | None:
    if not every:
        return None
    return "embedded, messages as EKF3" if (firmware_text(log) or "").startswith("xitl ") else every[0].filter


def _origin_facts(found: Origin | None, every: list[Core], instants: Instants) -> list[Fact]:
    facts = []
    if found is not None:
        when = "before the log began" if found.set_ns is None else instants.second(found.set_ns)
        facts += [
            Fact("origin_set", "Origin set", when, "" if found.set_ns is None else "s"),
            Fact("origin_latitude_deg", "Origin latitude", number(found.latitude_deg, 7), "deg"),
            Fact("origin_longitude_deg", "Origin longitude", number(found.longitude_deg, 7), "deg"),
            Fact("origin_altitude_m", "Origin altitude (ORGN)", number(found.altitude_m, 2), "m"),
            Fact("origin_height_m", "Height of the origin (OH)", number(found.height_m, 2), "m"),
        ]
    if (first_ns := first_position_ns(every)) is not None:
        early = first_ns <= instants.start_ns + 10**9
        value = "before the log began" if early else instants.second(first_ns)
        facts.append(Fact("first_position", "First absolute position", value, "" if early else "s"))
    return facts


def _selection(log: Log) -> list[Fact]:
    """XKFS: what the filter takes its measurements from, at the end."""
    table = log.tables.get("XKFS")
    if table is None or not len(table):
        return []
    last = slice(len(table) - 1, len(table))
    facts = []
    if "SS" in table.columns:
        number_of_set = int(table.values("SS", last, raw=True)[0])
        facts.append(Fact("source_set", "Source set", SOURCE_SETS.get(number_of_set, str(number_of_set))))
    if "MAG_FUSION" in table.columns:
        fusion = int(table.values("MAG_FUSION", last, raw=True)[0])
        facts.append(Fact("mag_fusion", "Compass fused as", MAG_FUSION.get(fusion, str(fusion))))
    return facts


def _filters(used: list[Use], armed: list[tuple[int, int]], instants: Instants) -> list[Finding]:
    """Attitude that fell back from a filter to DCM while armed."""
    fallbacks = [
        (before, use)
        for before, use in itertools.pairwise(used)
        if use.name == "DCM" and inside(np.array([use.from_ns]), armed)[0]
    ]
    if not fallbacks:
        return []
    before, use = fallbacks[0]
    lasted = length_text(sum(each.until_ns - each.from_ns for _, each in fallbacks) * 1e-9)
    return [
        Finding(
            "estimator.dcm_fallback",
            Severity.CRITICAL,
            f"{before.name} gave up and DCM took over while armed for {lasted}, first at {instants.text(use.from_ns)}",
            tuple(Evidence("ATT", "AEKF", each.from_ns, each.until_ns, "0") for _, each in fallbacks[:20]),
            "Look at test ratios and faults just before; DCM gives no position worth steering by.",
        )
    ]


def _height(log: Log, found: Origin | None, instants: Instants) -> list[Finding]:
    if found is None or found.height_m is None:
        return []
    heights = [height for _, height in found.heights]
    moved_m = max(heights) - min(heights)
    findings = []
    if moved_m >= _HEIGHT_MOVED_M:
        at_ns = found.heights[1][0]
        findings.append(
            Finding(
                "estimator.height_origin_moved",
                Severity.NOTICE,
                f"The height of the estimator's origin moved by {moved_m:.1f} m in {len(heights) - 1} steps, first at "
                f"{instants.text(at_ns)}",
                tuple(Evidence("XKF1", "OH", when, value=f"{height:.2f} m") for when, height in found.heights[:20]),
                "Altitudes before and after are not of one datum; EK3_OGN_HGT_MASK switches this on.",
            )
        )
    gps_m = _gps_altitude_m(log, found.heights[0][0])
    if gps_m is not None and abs(gps_m - found.height_m) >= _HEIGHTS_APART_M:
        findings.append(
            Finding(
                "estimator.height_origin_off",
                Severity.NOTICE,
                f"The estimator's origin is at {found.height_m:.1f} m, GPS was at {gps_m:.1f} m when it was set",
                (Evidence("XKF1", "OH", found.heights[0][0], value=f"{found.height_m:.1f} m"), Evidence("GPS", "Alt")),
                "Take heights from one of the two, not across them.",
            )
        )
    return findings


def _not_truth(apart_m: float | None) -> list[Finding]:
    if apart_m is None:
        return []
    sentence = (
        f"SIM is no truth here: its vehicle moved unlike the receiver and came to be {apart_m:.0f} m from it, so the "
        "sensors were fed from outside"
    )
    step = "Compare the estimate with the recording of the simulator that fed the sensors (run.mcap)."
    return [Finding("estimator.truth_of_another", Severity.NOTICE, sentence, (Evidence("SIM"), Evidence("GPS")), step)]


def _gps_altitude_m(log: Log, at_ns: int) -> float | None:
    table = log.tables.get("GPS")
    if table is None or not {"Alt", "Status"} <= set(table.columns):
        return None
    fixed = np.flatnonzero(whole(table, "Status") >= 3)
    if not len(fixed):
        return None
    nearest = fixed[np.argmin(np.abs(table.stamp_ns[fixed] - at_ns))]
    return number(float(table.values("Alt", np.array([nearest]))[0]))


def _armed_marks(armed: list[tuple[int, int]]) -> tuple[Mark, ...]:
    return tuple(Mark(begin, "armed", end, Severity.OK) for begin, end in armed[:50])


def _drawn(plot: Plot | None) -> list[Plot]:
    return [] if plot is None else [plot]


def _innovations(core: Core | None, marks: tuple[Mark, ...]) -> list[Plot]:
    table = None if core is None else core.innovations
    if table is None:
        return []
    rows = (
        ("velocity", "m/s", ("IVN", "IVE", "IVD")),
        ("position", "m", ("IPN", "IPE", "IPD")),
        ("yaw", "deg", ("IYAW",)),
    )
    found = []
    for what, unit, columns in rows:
        traces = [
            Trace(column, table.stamp_ns, np.asarray(table.values(column), dtype=np.float64))
            for column in columns
            if column in table.columns
        ]
        if traces:
            title = f"Innovations, {what}"
            found.append(Plot(f"innovations_{what}", title, f"innovation ({unit})", tuple(traces), marks=marks))
    return found


def _uses(used: list[Use], instants: Instants) -> Grid | None:
    if not used:
        return None
    rows = [
        (
            instants.second(use.from_ns),
            instants.second(use.until_ns),
            number((use.until_ns - use.from_ns) * 1e-9),
            use.name,
        )
        for use in used
    ]
    return grid("filters", "Filter in use", ("from (s)", "until (s)", "duration (s)", "filter"), rows)


def _refusals(tested: list[ratios.Ratios], armed: list[tuple[int, int]], instants: Instants) -> Grid | None:
    rows = []
    for one in tested:
        for begin, end in one.refused[:_MOST_REFUSED]:
            inner = inside(one.stamp_ns, [(begin, end)])
            on = "armed" if inside(np.array([begin, end]), armed).any() else "not armed"
            worst = number(one.values[inner].max(), 2)
            rows.append((one.core, one.of, instants.second(begin), number((end - begin) * 1e-9), worst, on))
    if not rows:
        return None
    rows.sort(key=lambda row: row[2])
    columns = ("core", "measurement", "from (s)", "for (s)", "largest ratio", "while")
    return grid("refused", "Measurements refused", columns, rows)


def _lacks(log: Log, every: list[Core], core: Core | None) -> tuple[str, ...]:
    lacks = []
    own = (firmware_text(log) or "").startswith("xitl ")
    if core is not None and core.innovations is None and not own:
        lacks.append("Innovations are not in the log (XKF3); EK3_LOG_LEVEL 0 logs them.")
    if every and core is not None and core.health is None:
        lacks.append("Test ratios are not in the log (XKF4).")
    if not every and log.format == "tlog":
        lacks.append("Telemetry has test ratios only a few times a second, and of the core in use.")
    return tuple(lacks)
