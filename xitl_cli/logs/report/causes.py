"""Relations between findings: grouping by cause, and OK findings that other findings contradict.

Consequences of a finding are listed under it, the earliest first.

A cut link causes a gap of the sensors, a failsafe, a lost position and an unfinished mission. `CAUSES` lists the kinds
of findings that can follow from others, and the time in which they can. Whether they do depends on their instants on
the report's one time line. Thus a cause in one file explains findings in another. No finding is omitted.

A cause begins before its consequence, and one of its spells overlaps or closely precedes it. A spell of over a minute
is a state: it only explains findings that begin soon after its own beginning.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

from xitl_cli.logs.model.sections import Finding, Severity
from xitl_cli.logs.report.file_report import FileFinding, FileReport, ReportedFiles


@dataclass(frozen=True, slots=True)
class CauseRule:
    """Possible consequences of some kinds of findings, which begin up to `after_s` after the end of the cause.

    Kinds are keys of findings or the beginnings of keys: "gnss" includes all of gnss.…. `WHOLE_LOG`: at any time in the
    same log.
    """

    causes: tuple[str, ...]
    consequences: tuple[str, ...]
    after_s: float
    to_its_end: bool = False
    """Whether a state explains findings as long as it lasts."""
    least: Severity = Severity.NOTICE
    """Least severity of the cause."""


WHOLE_LOG = math.inf

_ANSWERS = {
    "modes.failsafe.link": (
        "faults", "links", "radio", "events.said", "events.error.5", "events.error.8", "events.error.26", "power",
        "vehicle", "scheduler", "modes",
    ),
    "modes.failsafe.battery": (
        "faults", "power", "actuation.battery_sag", "events.said.battery", "events.error.6", "modes",
    ),
}  # fmt: skip
"""Failsafes that name their trouble, and their possible causes; no other finding can have caused them."""

_ERRORS = ("events.error", "events.said")
_DEPARTED = (
    "sensors.field_step", "sensors.field_offset", "sensors.field_ramp", "sensors.field_drive", "sensors.pressure_step",
    "sensors.gyro_bias", "sensors.accel_bias", "actuation.gnss_drift",
)  # fmt: skip
_DRIVEN = ("actuation.thrust_loss", "actuation.reversed", "actuation.stuck", "actuation.unanswered")
_EKF = ("estimator", "events.error.16", "events.error.17", "events.error.24", "events.said.ekf_failsafe",
        "events.said.ekf_variance", "events.error.7")  # fmt: skip
_PX4 = ("px4.failure_detected", "px4.failsafe", "px4.rejected", "px4.estimate_reset", "px4.accel_clipping")
_ACTED = ("modes.failsafe", "arming.disarmed_by_failsafe", "missions.unfinished")
_HIT = (
    "attitude.impact", "attitude.contact", "attitude.overturned", "attitude.leaning", "control.attitude_lost",
    "control.rate_lost", "events.error.12", "events.error.25", "events.said.crash", "events.said.flight",
)  # fmt: skip
_MISJUDGED = ("attitude.overturned", "attitude.leaning", "attitude.rolling", "attitude.doubtful")
"""Findings on the estimated attitude, which inertial sensors determine."""
_MISLED = (
    "gnss.silent", "events.error.3", "events.error.18", "events.error.26", "events.said.sensor", "control",
    *_MISJUDGED, *_DRIVEN, *_EKF, *_ACTED,
)  # fmt: skip
"""Consequences of a sensor that fails."""
_MEASURES = ("estimator.position_error", "estimator.yaw_error")
"""Errors against the truth, at the instant of the largest: they measure consequences and cause nothing."""
_SILENT = ("links.silence", "links.sequence_loss", "links.loss", "radio.failsafe", "radio.none")

CAUSES = (
    CauseRule(("vehicle.simulated", "vehicle.lockstep"), ("scheduler.simulated_clock",), WHOLE_LOG),
    CauseRule(("scheduler.long_loops",), ("scheduler.longest_loop",), WHOLE_LOG),
    CauseRule(
        ("estimator.truth_of_another",),
        ("sensors.two_worlds", "estimator.cores_apart", "estimator.unused_core"),
        WHOLE_LOG,
    ),
    CauseRule(
        ("gnss.no_fix", "estimator.never_positioned"),
        ("estimator.never_positioned", "estimator.timeout", "events.error.7", "arming.refused"),
        WHOLE_LOG,
    ),
    CauseRule(
        ("faults.injected",),
        ("links", "sensors", "gnss", "estimator", "actuation", "power", *_ERRORS, "scheduler", "tasks",
         "time_bases", "radio", "control", "vibration", "faults.takeover", *_ACTED),
        5.0,
    ),
    CauseRule(
        ("power.breakdown", "power.brown_out", "power.input_lost", "power.low", "power.used_up", "power.overcurrent"),
        ("power", "events.error.6", "events.said.battery", "vehicle.reboots", "sensors.gap", "sensors.unhealthy",
         "control.too_slow", "radio.too_slow", *_ACTED),
        30.0,
    ),
    CauseRule(
        ("actuation.battery_sag",),
        ("power", "actuation.thrust_loss", "control", "radio.saturated", "radio.too_slow", "events.said.battery",
         "events.error.6", *_ACTED),
        30.0,
    ),
    CauseRule(("vehicle.reboots", "events.watchdog"), ("sensors", "links", "time_bases", "scheduler", *_ERRORS), 10.0),
    CauseRule(("time_bases.step", "time_bases.rate_step"), ("sensors", "gnss.silent", "scheduler", "time_bases"), 2.0),
    CauseRule(
        ("links.silence", "links.sequence_loss", "links.loss"),
        ("links", "sensors.gap", "sensors.missing", "sensors.recording_pauses", "gnss.silent", "gnss.fix_lost"),
        3.0,
    ),
    CauseRule(
        _SILENT,
        ("events.error.5", "events.error.8", "events.error.26", "events.said.radio_failsafe",
         "events.said.gcs_failsafe", "events.said.failsafe", "events.run_failed", *_ACTED),
        15.0,
    ),
    CauseRule(
        _HIT,
        (*_HIT, *_ERRORS, *_EKF, *_ACTED, *_PX4, *_DRIVEN, "gnss", "sensors", "vibration", "radio", "control", "power"),
        15.0,
    ),
    CauseRule(("attitude.rolling",), ("control", "radio", "actuation.unanswered", "missions.unfinished"), 15.0),
    CauseRule(("sensors.stopped_together",), ("gnss",), 2.0),
    CauseRule(("vibration",), ("sensors.saturated", "sensors.disagree", "vibration", "events.error.29", *_EKF), 5.0),
    CauseRule(("gnss.fix_lost", "gnss.silent"), ("sensors.gap",), 10.0),  # of an external AHRS, which needs fixes
    CauseRule(
        ("gnss",),
        ("gnss", "sensors.accel_bias", "control", "radio.saturated", "radio.too_slow", "events.error.11",
         "events.said.sensor", "arming.refused", *_DRIVEN, *_EKF, *_ACTED),
        30.0,
    ),
    CauseRule(
        ("gnss.poor",),
        ("estimator.position_error", "estimator.position_step", "actuation.gnss_drift"),
        0.0,
        to_its_end=True,
    ),
    CauseRule(
        ("sensors.gap", "sensors.stuck", "sensors.stopped_together", "sensors.unhealthy", "sensors.errors",
         "sensors.saturated", "sensors.compasses_disagree", "sensors.field_changes"),
        ("sensors", *_MISLED),
        10.0,
    ),
    CauseRule(("sensors.slow", "sensors.missing"), ("sensors.slow", "sensors.missing", "sensors.gap"), 10.0),
    CauseRule(  # many missing samples; they do not stop a sensor
        ("sensors.slow", "sensors.missing"),
        ("sensors.errors", "sensors.unhealthy", "sensors.disagree", "sensors.compasses_disagree",
         "sensors.field_changes", "sensors.barometers_drift", *_DEPARTED, *_MISLED),
        10.0,
        least=Severity.WARNING,
    ),
    CauseRule(
        _DEPARTED,
        ("sensors.compasses_disagree", "sensors.field_changes", "sensors.barometers_drift", "sensors.disagree", "gnss",
         "control", "radio.saturated", "radio.too_slow", *_MISJUDGED, *_DRIVEN, *_EKF, *_ACTED),
        30.0,
    ),
    CauseRule(
        ("sensors.gyro_bias",),  # the gyroscope turns the force that is compared with the receiver's velocity
        ("sensors.accel_bias",),
        30.0,
        to_its_end=True,
    ),
    CauseRule(  # the estimate tilts, and its roll and pitch then differ from the turns of the gyroscope
        ("sensors.accel_bias",),
        ("sensors.gyro_bias",),
        30.0,
        to_its_end=True,
    ),
    CauseRule(
        ("actuation.thrust_loss", "actuation.reversed", "actuation.stuck"),
        ("actuation.unanswered",),
        15.0,
    ),
    CauseRule(
        _DRIVEN,
        ("control", "radio.saturated", "radio.too_slow", "radio.oscillation", "attitude.contact", "attitude.impact",
         "missions.unfinished"),
        15.0,
    ),
    CauseRule(("estimator",), (*_EKF, "gnss.glitch", "events.error.11", "arming.refused", *_ACTED), 15.0),
    CauseRule(
        ("estimator.position_lost", "estimator.position_step", "estimator.yaw_reset", "estimator.faults",
         "estimator.lane_switch", "estimator.dcm_fallback"),
        ("control",),
        5.0,
    ),
    CauseRule(
        ("scheduler", "tasks", "events.main_loop_stuck", "events.error.19"),
        ("scheduler", "tasks", "events.main_loop_stuck", "events.error.19", "sensors.missing", "sensors.gap",
         "vehicle.log_dropped", "links.serial_overflow"),
        2.0,
    ),
    CauseRule(  # the main loop stopped: it waits for a silent IMU, and the autopilot then disarms
        ("sensors.recording_pauses",),
        ("sensors.gap", "sensors.missing", "sensors.slow", "gnss", *_ERRORS, *_ACTED, *_EKF),
        5.0,
    ),
    CauseRule(("vehicle.log_dropped",), ("sensors.gap", "sensors.missing", "sensors.recording_pauses"), 2.0),
    CauseRule(
        ("radio.too_slow", "radio.saturated", "radio.oscillation"),
        ("control", "radio", "missions.unfinished"),
        5.0,
    ),
    CauseRule(("control",), ("control", "radio", "missions.unfinished"), 5.0),
    CauseRule(
        (*_ERRORS, "modes.failsafe", "arming.disarmed_by_failsafe", "power.failsafe", "px4.failsafe"),
        (*_ERRORS, *_ACTED),
        5.0,
    ),
)  # fmt: skip
"""The causal table."""

_TOGETHER_S = 1.0
"""Events logged within a second of each other began together. Then the earlier kind in `_FIRST` is the cause."""
_SLOW = ("control", "radio")
_SLOW_TOGETHER_S = 3.0
"""The same for findings that must last for many seconds: an ordinary turn or wave may begin the spell that a fault then
keeps."""
_FIRST = (
    "faults", "power", "vehicle", "time_bases", "links", "attitude.contact", "attitude.impact", "vibration",
    "sensors", "actuation", "gnss", "scheduler", "control", "attitude", "estimator", "radio", "px4",
    "events.error", "events",
    "modes", "arming", "missions",
)  # fmt: skip
_SAME_S = 2.0
_EVENT_S, _WHOLE_SHARE = 60.0, 0.9
"""Longest event, and its largest share of a log."""
_STATE_REACH_S = 60.0
_AT_START_S = 10.0


@dataclass(frozen=True, slots=True)
class FindingGroup:
    """A finding and its consequences, in order of time."""

    cause: FileFinding
    consequences: tuple[FileFinding, ...] = ()

    @property
    def worst(self) -> Severity:
        return max(placed.finding.severity for placed in (self.cause, *self.consequences))


@dataclass(frozen=True, slots=True)
class _Placed:
    """A finding with its spans (s) on the report's time line."""

    found: FileFinding
    spans: tuple[tuple[float, float], ...]
    """Empty for a finding without an instant."""
    rank: int
    file: int
    """Number of its file."""
    place: int
    """Number of the finding among all."""
    start_s: float
    """Beginning of its file."""
    event_s: float
    """Longest span of an event of its file; a longer one is a state."""

    @property
    def begin_s(self) -> float:
        return self.spans[0][0] if self.spans else math.inf

    @property
    def together_s(self) -> float:
        """Time by which a cause may begin later than this consequence."""
        return _SLOW_TOGETHER_S if is_kind(self.found.finding.key, _SLOW) else _TOGETHER_S

    def rounded_s(self, begin_s: float) -> float:
        """Beginning of a cause: that of this consequence if both began together."""
        return self.begin_s if abs(begin_s - self.begin_s) <= self.together_s else begin_s

    @property
    def intended(self) -> bool:
        return is_kind(self.found.finding.key, ("faults",))

    @property
    def lasts(self) -> bool:
        """Whether it is an unintended state rather than an event."""
        longest_s = max((end - begin for begin, end in self.spans), default=math.inf)
        return longest_s > self.event_s and not self.intended

    def explains_until_s(self, span: tuple[float, float], reach_s: float, to_its_end: bool) -> float:
        """Latest beginning (s) of a consequence of this spell.

        A state explains findings that begin soon after its own beginning. If it holds from the start of the log, its
        beginning is unknown, and only the reach of the rule counts.
        """
        begin_s, end_s = span
        if end_s - begin_s <= self.event_s or self.intended or to_its_end:
            return end_s + reach_s
        seen = begin_s > self.start_s + _AT_START_S
        return begin_s + max(reach_s, _STATE_REACH_S if seen else 0.0)


def group_findings(report: ReportedFiles) -> list[FindingGroup]:
    """All findings in groups: the most severe groups first, then the earliest. OK findings have their own groups,
    last."""
    order = {id(file): place for place, file in enumerate(report.files)}
    placed = [_placed(found, order[id(found.file)], place) for place, found in enumerate(report.findings)]
    causes = [_cause(effect, placed) for effect in placed]
    first = [_root(place, causes, placed) for place in range(len(placed))]
    # A root that has a cause, which would be too late for this finding, has no group of its own.
    roots = [root if first[root] == root else place for place, root in enumerate(first)]
    groups = []
    for place, cause in enumerate(placed):
        if roots[place] != place:
            continue
        effects = [placed[other] for other, root in enumerate(roots) if root == place != other]
        effects.sort(key=lambda effect: (effect.begin_s, effect.rank))
        groups.append((cause, FindingGroup(cause.found, tuple(effect.found for effect in effects))))
    groups.sort(key=lambda pair: (-pair[1].worst, pair[0].begin_s))
    return [group for _, group in groups]


def _placed(found: FileFinding, file: int, place: int) -> _Placed:
    line = found.file.time_line
    spans = sorted(
        (line.second(each.at_ns), line.second(each.at_ns if each.until_ns is None else max(each.until_ns, each.at_ns)))
        for each in found.finding.evidence
        if each.at_ns is not None
    )
    key = found.finding.key
    rank = min((place for place, kind in enumerate(_FIRST) if is_kind(key, (kind,))), default=len(_FIRST))
    start_s, end_s = (-math.inf, math.inf) if found.file.span_ns is None else map(line.second, found.file.span_ns)
    return _Placed(found, tuple(spans), rank, file, place, start_s, min(_EVENT_S, _WHOLE_SHARE * (end_s - start_s)))


def is_kind(key: str, kinds: Sequence[str]) -> bool:
    """Whether the key of a finding is one of these, or begins with it."""
    return any(key == kind or key.startswith(f"{kind}.") for kind in kinds)


def _cause(effect: _Placed, every: Sequence[_Placed]) -> int | None:
    """Index of the earliest finding that causes this one."""
    if effect.found.finding.severity == Severity.OK:
        return None
    candidates = []
    for place, other in enumerate(every):
        if other is effect or other.found.finding.severity == Severity.OK:
            continue
        span = _explaining_span(effect, other)
        if span is not None:
            # A lasting finding is a state, such as a field that always changes: an event explains more. A notice
            # explains a worse finding only if nothing worse does. What was injected on purpose is a notice too.
            minor = other.found.finding.severity < min(effect.found.finding.severity, Severity.WARNING)
            minor = minor and not is_kind(other.found.finding.key, ("faults",))
            candidates.append((other.lasts, minor, effect.rounded_s(span[0]), other.rank, place))
        elif _is_repeated(effect, other):
            candidates.append((False, False, effect.rounded_s(other.begin_s), other.rank, place))
    return min(candidates)[-1] if candidates else None


@lru_cache(4096)  # a log with hundreds of findings has few kinds of them
def _reach(cause_key: str, severity: Severity, key: str) -> tuple[float, bool] | None:
    """Time in which a finding of one kind and severity can cause one of another kind, by the rule that allows most, and
    whether a state does to its end; None if no rule allows it."""
    allowed = [
        rule
        for rule in CAUSES
        if is_kind(cause_key, rule.causes) and severity >= rule.least and is_kind(key, rule.consequences)
    ]
    if not allowed or is_kind(cause_key, _MEASURES):
        return None
    return max(rule.after_s for rule in allowed), any(rule.to_its_end for rule in allowed)


def _explaining_span(effect: _Placed, cause: _Placed) -> tuple[float, float] | None:
    """Span of a cause for this finding; None if no rule allows it or the cause is later.

    A cause covers at least half of its consequence.
    """
    key, cause_key = effect.found.finding.key, cause.found.finding.key
    if key in _ANSWERS and not is_kind(cause_key, _ANSWERS[key]):
        return None
    reach = _reach(cause_key, cause.found.finding.severity, key)
    if reach is None:
        return None
    reach_s, to_its_end = reach
    if reach_s == WHOLE_LOG:
        return (-math.inf, math.inf) if effect.file == cause.file else None
    if not effect.spans:
        return None
    explained = [
        next(
            (
                span
                for span in cause.spans
                if span[0] - effect.together_s <= at <= cause.explains_until_s(span, reach_s, to_its_end)
            ),
            None,
        )
        for at, _ in effect.spans
    ]
    known = [span for span in explained if span is not None]
    if 2 * len(known) < len(effect.spans):
        return None
    # The cause begins first. If both begin together, the order of `_FIRST` decides.
    begin_s = known[0][0]
    apart_s = effect.begin_s - begin_s
    if abs(apart_s) <= effect.together_s:
        first = (cause.rank, begin_s, cause.place) < (effect.rank, effect.begin_s, effect.place)
    else:
        first = apart_s > 0.0
    return known[0] if first else None


def _is_repeated(finding: _Placed, other: _Placed) -> bool:
    """Whether an earlier file has the same finding, so that two recordings of one run report it once."""
    if finding.found.finding.key != other.found.finding.key or other.file >= finding.file:
        return False
    if not finding.spans or not other.spans:
        return False
    (begin, end), (other_begin, other_end) = finding.spans[0], other.spans[0]
    return begin <= other_end + _SAME_S and other_begin <= end + _SAME_S


def _root(place: int, causes: Sequence[int | None], placed: Sequence[_Placed]) -> int:
    """First cause of a chain; in a circular chain, its first finding.

    A chain of causes that each began "together" with the next must not lead to a later cause.
    """
    seen = [place]
    while (cause := causes[seen[-1]]) is not None:
        if placed[cause].spans and placed[cause].begin_s > placed[place].begin_s + placed[place].together_s:
            break
        if cause in seen:
            return min(seen[seen.index(cause) :])
        seen.append(cause)
    return seen[-1]


# OK findings that another finding of the run contradicts.

CONTRADICTED = {
    "control.followed": (
        "control", "actuation.thrust_loss", "actuation.reversed", "actuation.stuck", "actuation.unanswered",
        "actuation.gnss_drift", "sensors.field_step", "sensors.gyro_bias", "sensors.accel_bias",
    ),
    "attitude.upright": ("attitude.overturned", "attitude.leaning", "attitude.impact", "attitude.contact"),
    "links.whole": ("links.loss",),
    "links.sequence_whole": ("links.sequence_loss",),
    "scheduler.on_time": ("scheduler.long_loops", "scheduler.deadlines_missed", "scheduler.late_tasks"),
    "tasks.in_time": ("tasks.overruns",),
}  # fmt: skip
"""OK findings, and the kinds of findings that contradict them.

If a faulty sensor misled the estimate, good tracking by the estimate is not good tracking on the water.
"""


def without_contradictions(files: Iterable[FileReport]) -> tuple[FileReport, ...]:
    """The files without OK findings that another finding of this run contradicts."""
    files = tuple(files)
    bad = {
        finding.key
        for file in files
        for section in file.sections
        for finding in section.findings
        if finding.severity >= Severity.WARNING
    }
    consistent = []
    for file in files:
        sections = []
        for section in file.sections:
            findings = tuple(finding for finding in section.findings if not is_contradicted(finding, bad))
            sections.append(replace(section, findings=findings))
        consistent.append(replace(file, sections=tuple(sections)))
    return tuple(consistent)


def is_contradicted(finding: Finding, bad: Iterable[str]) -> bool:
    """Whether an OK finding is contradicted by a finding with one of these keys."""
    kinds = CONTRADICTED.get(finding.key, ()) if finding.severity == Severity.OK else ()
    return any(is_kind(key, kinds) for key in bad)
