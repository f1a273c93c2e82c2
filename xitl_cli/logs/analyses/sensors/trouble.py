"""Sensors that stick, saturate, or that the autopilot itself holds for unwell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from xitl_cli.logs.analyses.instants import Instants
from xitl_cli.logs.log import Log
from xitl_cli.logs.sections import Evidence, Finding, Section, Severity
from xitl_cli.logs.sensing.columns import numbers, some
from xitl_cli.logs.sensing.holding import Hold, Holding, saturation
from xitl_cli.logs.sensing.inertial import Inertial
from xitl_cli.logs.signals import Series, ground_speed, yaw_rate

_STICKS = {"inertial unit", "magnetometer", "barometer"}
_TURN_DEG = 5.0
_FAST_TURN_DEGPS = 3.0
_MOVING_MPS = 0.3
_UNEXPLAINED_S = 5.0
_GYRO_LEAST_RADPS = 2.0  # 115 deg/s: the smallest range on the market is 125
_ACCEL_LEAST_MPS2 = 18.0  # the smallest is 2 g
_RATE_DROP = 0.8
_AT_ONCE_NS = 1_000_000_000
_STUCK = "sensors.stuck"


class Judged(Protocol):
    """What is needed of a sensor here."""

    @property
    def name(self) -> str: ...
    @property
    def sort(self) -> str: ...
    @property
    def message(self) -> str: ...
    @property
    def field(self) -> str: ...
    @property
    def stamp_ns(self) -> NDArray[np.int64]: ...
    @property
    def holding(self) -> Holding: ...
    @property
    def healthy(self) -> NDArray[np.bool_] | None: ...


def trouble(
    log: Log,
    found: Sequence[Judged],
    inertial: Sequence[Inertial],
    armed: Mapping[str, NDArray[np.bool_] | None],
    instants: Instants,
) -> Section:
    turning, speed = yaw_rate(log), ground_speed(log)
    by_sensor: dict[str, list[Finding]] = {}
    for sensor in found:
        stuck = _stuck(sensor, [each for each in found if each is not sensor], turning, speed, instants)
        by_sensor[sensor.name] = _as_one(stuck, _unwell(sensor, armed.get(sensor.name), instants))
    units = [finding for unit in inertial for finding in (*_saturated(unit, instants), *_unit_errors(unit, instants))]
    return Section("sensors", "Sensors", findings=(*_together(by_sensor, instants), *units))


def _as_one(stuck: list[Finding], unwell: list[Finding]) -> list[Finding]:
    """A sensor that stopped, and is called unhealthy for it, is one trouble."""
    if not (stuck and unwell and stuck[0].key == _STUCK and _begin(unwell[0]) >= _begin(stuck[0])):
        return [*stuck, *unwell]
    sentence = f"{stuck[0].sentence}; the autopilot called it unhealthy then"
    return [replace(stuck[0], sentence=sentence, evidence=(*stuck[0].evidence, *unwell[0].evidence)), *stuck[1:]]


def _together(by_sensor: Mapping[str, list[Finding]], instants: Instants) -> tuple[Finding, ...]:
    """All findings; sensors that stopped within a second in one, as the cause is none of them."""
    every = tuple(finding for findings in by_sensor.values() for finding in findings)
    stopped = {name: one for name, findings in by_sensor.items() for one in findings if one.key == _STUCK}
    begins = [_begin(one) for one in stopped.values()]
    if len(stopped) < 2 or max(begins) - min(begins) > _AT_ONCE_NS:
        return every
    *names, last = stopped
    one = Finding(
        "sensors.stopped_together",
        max(finding.severity for finding in stopped.values()),
        f"{', '.join(names)} and {last} stopped together at {instants.text(min(begins))}, while the vehicle moved: "
        "each shows one and the same value from then on",
        tuple(evidence for finding in stopped.values() for evidence in finding.evidence),
        "Look at what feeds them all: a link, a bus, or the process behind it.",
    )
    return (one, *(finding for finding in every if finding.key != _STUCK))


def _begin(finding: Finding) -> int:
    return min((one.at_ns for one in finding.evidence if one.at_ns is not None), default=0)


def _stuck(
    sensor: Judged, others: Sequence[Judged], turning: Series | None, speed: Series | None, instants: Instants
) -> list[Finding]:
    """Equal values for long are a fault when the vehicle moved meanwhile, or when the noise usually shows."""
    if sensor.sort not in _STICKS or not sensor.holding.holds:
        return []
    certain: list[tuple[Hold, str]] = []
    doubtful: list[Hold] = []
    for hold in sensor.holding.holds:
        from_ns, until_ns = (int(sensor.stamp_ns[row]) for row in (hold.first, hold.last))
        if _shared(sensor, from_ns, until_ns, others):
            continue
        why = _moved(sensor.sort, from_ns, until_ns, turning, speed)
        if why:
            certain.append((hold, why))
        elif sensor.sort == "inertial unit" and until_ns - from_ns >= _UNEXPLAINED_S * 1e9 and _lively(sensor):
            doubtful.append(hold)
    findings = []
    if certain:
        findings.append(
            Finding(
                _STUCK,
                Severity.WARNING,
                f"{sensor.name} shows one and the same value {_when(sensor, [hold for hold, _ in certain], instants)}, "
                f"while {certain[0][1]}",
                _evidence(sensor, [hold for hold, _ in certain]),
                "Check the sensor's bus and driver: a device that no longer answers may leave its last value behind.",
            )
        )
    if doubtful:
        findings.append(
            Finding(
                "sensors.still",
                Severity.NOTICE,
                f"{sensor.name} shows one and the same value {_when(sensor, doubtful, instants)}, though at other "
                "times no two samples are equal",
                _evidence(sensor, doubtful),
                "A simulated sensor without noise at rest does that; a real one is stuck.",
            )
        )
    return findings


def _shared(sensor: Judged, from_ns: int, until_ns: int, others: Sequence[Judged]) -> bool:
    """Whether all other sensors of the sort stood still as well for most of this time: then nothing moved."""
    alike = [each for each in others if each.sort == sensor.sort == "magnetometer"]
    for each in alike:
        spans = ((int(each.stamp_ns[hold.first]), int(each.stamp_ns[hold.last])) for hold in each.holding.holds)
        if not any(min(b, until_ns) - max(a, from_ns) > 0.8 * (until_ns - from_ns) for a, b in spans):
            return False
    return bool(alike)


def _lively(sensor: Judged) -> bool:
    """Whether noise usually shows in every sample."""
    return sensor.holding.usual < 1.5


def _moved(sort: str, from_ns: int, until_ns: int, turning: Series | None, speed: Series | None) -> str:
    """What contradicts a constant value; "" when nothing does.

    Turns are those of the gyroscope: a heading that is still being found changes without any.
    """
    if turning is not None and sort == "magnetometer":
        turned_deg = _turned_deg(turning, from_ns, until_ns)
        if turned_deg > _TURN_DEG:
            return f"the vehicle turned by {turned_deg:.0f}°"
    if speed is not None and sort == "inertial unit":
        inside = (speed.stamp_ns >= from_ns) & (speed.stamp_ns <= until_ns)
        if inside.any() and (fast := float(np.median(speed.values[inside]))) > _MOVING_MPS:
            return f"the vehicle made {fast:.2g} m/s"
    return ""


def _turned_deg(rate_degps: Series, from_ns: int, until_ns: int) -> float:
    """How far the heading went to and fro, by the rate without its median, which may be a bias unless it is fast."""
    inside = (rate_degps.stamp_ns >= from_ns) & (rate_degps.stamp_ns <= until_ns)
    if np.count_nonzero(inside) < 3:
        return 0.0
    rates, stamps = rate_degps.values[inside], rate_degps.stamp_ns[inside]
    usual = float(np.median(rates))
    if abs(usual) < _FAST_TURN_DEGPS:
        rates = rates - usual
    return float(np.ptp(np.cumsum(rates[1:] * np.diff(stamps) * 1e-9)))


def _when(sensor: Judged, holds: list[Hold], instants: Instants) -> str:
    spans = [
        f"from {instants.text(int(sensor.stamp_ns[hold.first]))} for "
        f"{(int(sensor.stamp_ns[hold.last]) - int(sensor.stamp_ns[hold.first])) * 1e-9:.1f} s"
        for hold in holds
    ]
    return some(spans)


def _evidence(sensor: Judged, holds: list[Hold]) -> tuple[Evidence, ...]:
    return tuple(
        Evidence(sensor.message, sensor.field, int(sensor.stamp_ns[hold.first]), int(sensor.stamp_ns[hold.last]))
        for hold in holds[:8]
    )


def _unwell(sensor: Judged, armed: NDArray[np.bool_] | None, instants: Instants) -> list[Finding]:
    """Rows in which the autopilot's own flag says unhealthy."""
    if sensor.healthy is None or sensor.healthy.all():
        return []
    bad = ~sensor.healthy
    count, whole = int(np.count_nonzero(bad)), len(bad)
    first = int(sensor.stamp_ns[int(np.argmax(bad))])
    last = int(sensor.stamp_ns[len(bad) - 1 - int(np.argmax(bad[::-1]))])
    sailing = bad if armed is None else bad & armed
    when = (
        "in every row"
        if count == whole
        else f"in {count} of {whole} rows, from {instants.text(first)} to {instants.text(last)}"
    )
    return [
        Finding(
            "sensors.unhealthy",
            Severity.WARNING if sailing.any() else Severity.NOTICE,
            f"{sensor.name} was unhealthy to the autopilot {when}"
            + ("" if sailing.any() or armed is None else ", only while disarmed"),
            (Evidence(sensor.message, "health", first, last, "0"),),
            "See what else happened then (errors, gaps); a sensor that is not fitted should be disabled.",
        )
    ]


def _saturated(unit: Inertial, instants: Instants) -> list[Finding]:
    findings = []
    for values, fields, least, what, measure in (
        (unit.gyro_radps, unit.gyro_fields, _GYRO_LEAST_RADPS, "gyroscope", "rad/s"),
        (unit.accel_mps2, unit.accel_fields, _ACCEL_LEAST_MPS2, "accelerometer", "m/s²"),
    ):
        if values is None:
            continue
        for axis in range(3):
            found = saturation(values[:, axis], least)
            if found is None:
                continue
            at_ns, until_ns = int(unit.stamp_ns[found.first]), int(unit.stamp_ns[found.last])
            field = fields[axis] if len(fields) == 3 else f"{fields[0]}[{axis}]"
            findings.append(
                Finding(
                    "sensors.saturated",
                    Severity.WARNING,
                    f"{unit.name}: the {what} is at the end of its range, {found.limit:.4g} {measure} on {field}, in "
                    f"{found.rows} samples, longest from {instants.text(at_ns)} for {(until_ns - at_ns) * 1e-9:.3g} s",
                    (Evidence(unit.table.name, field, at_ns, until_ns, f"{found.limit:.4g}"),),
                    "Damp the mounting or choose a larger range: what is cut off is lost to the estimator.",
                )
            )
    return findings


def _unit_errors(unit: Inertial, instants: Instants) -> list[Finding]:
    """Error counters that go up, and a measurement rate that falls."""
    findings = []
    for field, what in (("EG", "gyroscope"), ("EA", "accelerometer")):
        counts = numbers(unit.table, field, raw=True)
        if counts is None or len(counts) < 2:
            continue
        rises = np.flatnonzero(np.diff(counts) > 0)
        if len(rises):
            grown = int(counts[rises + 1].sum() - counts[rises].sum())
            findings.append(
                Finding(
                    "sensors.errors",
                    Severity.WARNING,
                    f"{unit.name}: the {what} driver counted {grown} errors, the first at "
                    f"{instants.text(int(unit.stamp_ns[rises[0] + 1]))}",
                    (Evidence(unit.table.name, field, int(unit.stamp_ns[rises[0] + 1]), None, str(grown)),),
                    "Check the bus of the sensor (wiring, clock rate, supply).",
                )
            )
    for field in ("GHz", "AHz"):
        rates = numbers(unit.table, field)
        if rates is None or not (rates > 0.0).any():
            continue
        usual = float(np.median(rates[rates > 0.0]))
        low = np.flatnonzero(rates < _RATE_DROP * usual)
        low = low[unit.stamp_ns[low] > unit.stamp_ns[0] + 5_000_000_000]  # the rate is measured from the start on
        if len(low):
            at_ns = int(unit.stamp_ns[low[int(np.argmin(rates[low]))]])
            findings.append(
                Finding(
                    "sensors.slow",
                    Severity.WARNING,
                    f"{unit.name}: the measurement rate fell from {usual:.0f} Hz to {rates[low].min():.0f} Hz at "
                    f"{instants.text(at_ns)}",
                    (Evidence(unit.table.name, field, at_ns, None, f"{rates[low].min():.0f}"),),
                    "The sensor's thread did not get to run, or its bus was held up: look at the scheduler then.",
                )
            )
    return findings
