"""Remote control and outputs: each finding on either side of its limit, with its figures and evidence."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from made_log import MadeLog, MadeTable

from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Grid, Section, Severity
from xitl_cli.plugins.logs.analyses.radio import analyse

S = 1_000_000_000
ROWS = 1000
AT_NS = np.arange(ROWS) * S // 10
ARM = MadeTable("ARM", [10 * S], {"ArmState": [1]})  # from row 100


def column(first: float = 0.0, *parts: tuple[int, int, float]) -> np.ndarray:
    """A value in all rows, and others from one row to before another."""
    values = np.full(ROWS, first)
    for begin, end, other in parts:
        values[begin:end] = other
    return values


def rows(name: str, **columns: Any) -> MadeTable:
    return MadeTable(name, AT_NS, {key: np.broadcast_to(each, ROWS) for key, each in columns.items()})


def report(*tables: MadeTable, kind: Any = "dataflash") -> Section:
    section = analyse(MadeLog(*tables, kind=kind))
    assert section is not None
    return section


def said(section: Section) -> list[tuple[str, Severity, str]]:
    return [(each.key, each.severity, each.sentence) for each in section.findings]


def finding_of(section: Section, key: str) -> Finding | None:
    found = [each for each in section.findings if each.key == key]
    assert len(found) < 2
    return found[0] if found else None


def grid_of(section: Section, key: str) -> Grid:
    return next(grid for grid in section.grids if grid.key == key)


def test_channels_with_their_range_and_how_often_they_change() -> None:
    moved = column(1500.0, (500, 750, 1600.0))
    section = report(rows("RCIN", C1=1500.0, C2=moved, C3=np.where(np.arange(ROWS) % 2, 1100.0, 1900.0)))
    assert grid_of(section, "inputs").rows == (
        (1, 1500.0, 1500.0, 1500.0, "constant"),
        (2, 1500.0, 1500.0, 1600.0, "0 % of rows"),
        (3, 1100.0, 1500.0, 1900.0, "100 % of rows"),
    )
    assert section.facts[0] == Fact("input_channels", "Input channels in use", 3)
    (plot,) = section.plots
    assert [(trace.name, trace.style) for trace in plot.traces] == [("channel 2", "steps"), ("channel 3", "steps")]
    np.testing.assert_array_equal(plot.traces[0].y, moved)
    assert section.lacks == ("No outputs are logged; set the bit RCOUT of LOG_BITMASK.",)
    none = report()
    assert none.lacks[0].startswith("No remote control input is logged: ")
    assert (none.grids, none.plots, none.findings) == ((), (), ())


@pytest.mark.parametrize(
    ("table", "expected"),
    [
        (rows("RSSI", RXRSSI=column(0.9, (0, 50, 0.1))), None),  # five in a hundred
        (rows("RSSI", RXRSSI=column(0.9, (0, 51, 0.29))), "signal strength|5 %|29 %"),
        (rows("RSSI", RXRSSI=column(0.9, (0, 200, 0.3))), None),
        (rows("RSSI", RXLQ=column(90.0, (0, 100, 20.0))), "link quality|10 %|20 %"),
        (rows("RC_CHANNELS", rssi=column(254.0, (0, 100, 25.4), (100, 200, 255.0))), "signal strength|11 %|10 %"),
        (rows("RC_CHANNELS", rssi=255), None),
        (rows("RSSI", RXRSSI=column(0.9, (0, 400, -1.0), (400, 700, np.nan))), None),
        (rows("RSSI", RXRSSI=0.0), None),  # it is not measured
        (MadeTable("RSSI", AT_NS[:4], {"RXRSSI": [0.9, 0.1, 0.1, 0.1]}), None),
        (MadeTable("RSSI", AT_NS[:5], {"RXRSSI": [0.9, 0.1, 0.1, 0.1, 0.9]}), "signal strength|60 %|10 %"),
    ],
)
def test_a_weak_signal_by_its_share(table: MadeTable, expected: str | None) -> None:
    found = finding_of(report(table, kind="tlog" if table.name == "RC_CHANNELS" else "dataflash"), "radio.weak")
    if expected is None:
        assert found is None
        return
    what, share, least = expected.split("|")
    assert found is not None
    assert found.severity is Severity.NOTICE
    assert found.sentence == (
        f"The {what} of the remote control was under 30 % for {share} of the time, at least {least}"
    )
    weak = np.asarray(next(iter(table._values.values())))
    first, last = np.flatnonzero(weak == weak[weak > 0].min())[[0, -1]]
    assert [(each.at_ns, each.until_ns) for each in found.evidence] == [(int(AT_NS[first]), int(AT_NS[last]))]


@pytest.mark.parametrize(
    ("spans", "expected"),
    [
        ([(300, 350)], (Severity.WARNING, "Remote control was lost once: at 0:30.0 for 5.0 s")),
        (
            [(300, 350), (500, 501)],
            (Severity.WARNING, "Remote control was lost 2 times: at 0:30.0 for 5.0 s, 0:50.0 for 0.1 s"),
        ),
        ([(20, 40)], (Severity.NOTICE, "Remote control was lost once: at 0:02.0 for 2.0 s, only while disarmed")),
        ([(0, ROWS)], (Severity.NOTICE, "No remote control was received in this log")),
        ([], None),
    ],
)
def test_a_lost_remote_control(spans: list[tuple[int, int]], expected: Any) -> None:
    flags = column(1, *((begin, end, 3) for begin, end in spans)).astype(int)
    by_flag = report(rows("RCI2", Flags=flags), ARM)
    throttle = column(1500.0, *((begin, end, 909.0) for begin, end in spans))
    limits = MadeTable("PARM", [0, 0], {"Name": ["FS_THR_VALUE", "RCMAP_THROTTLE"], "Value": [910.0, 5.0]})
    by_throttle = report(rows("RCIN", C3=1000.0, C5=throttle), limits, ARM)
    for section, (message, field) in ((by_flag, ("RCI2", "Flags")), (by_throttle, ("RCIN", "C5"))):
        assert [(each[1], each[2]) for each in said(section)] == ([] if expected is None else [expected])
        if expected and spans[0][0]:
            assert section.findings[0].evidence == tuple(
                Evidence(message, field, int(AT_NS[begin]), int(AT_NS[end])) for begin, end in spans
            )


def test_when_the_throttle_is_no_sign_of_a_failsafe() -> None:
    low = rows("RCIN", C3=column(1500.0, (300, 350, 900.0)))

    def limits(**values: float) -> MadeTable:
        return MadeTable("PARM", [0] * len(values), {"Name": list(values), "Value": list(values.values())})

    assert said(report(low, limits(FS_THR_VALUE=910.0, FS_THR_ENABLE=0.0), ARM)) == []
    assert said(report(low, limits(FS_THR_VALUE=900.0), ARM)) == []  # not under it
    assert said(report(low, limits(FS_THR_ENABLE=1.0), ARM)) == []
    errors = MadeTable("ERR", [20 * S, 30 * S, 40 * S], {"Subsys": [5, 5, 6], "ECode": [1, 0, 1]})
    (found,) = report(errors, ARM).findings
    assert found.sentence == "Remote control was lost once: at 0:20.0 for 10.0 s"
    assert found.evidence == (Evidence("ERR", "ECode", 20 * S, 30 * S),)
    # The flag of the receiver, which tells of no loss, does not hide the error.
    assert [each.evidence for each in report(errors, rows("RCI2", Flags=1), ARM).findings] == [found.evidence]


def noisy(*held: tuple[int, int], seed: int = 3, repeats: int = 1) -> dict[str, np.ndarray]:
    sticks = 1500.0 + np.random.default_rng(seed).integers(-30, 31, (ROWS, 2))
    sticks = sticks[np.arange(ROWS) // repeats * repeats]
    for begin, end in held:
        sticks[begin:end] = sticks[begin]
    return {"C1": sticks[:, 0], "C2": sticks[:, 1]}


@pytest.mark.parametrize(
    ("sticks", "text"),
    [
        (noisy((400, 449)), None),
        (noisy((400, 450)), "from 0:40.0 for 4.9 s"),  # fifty rows of 0.1 s
        (noisy((400, 500), (600, 700)), "from 0:40.0 for 9.9 s, from 1:00.0 for 9.9 s"),
        (noisy((400, 500), repeats=2), None),  # it often repeats a value
        (noisy((100, 950)), None),  # it hardly ever moves
    ],
)
def test_a_receiver_that_holds_its_values(sticks: dict[str, np.ndarray], text: str | None) -> None:
    found = finding_of(report(rows("RCIN", **sticks)), "radio.held")
    if text is None:
        assert found is None
        return
    assert found is not None
    assert found.severity is Severity.NOTICE
    assert found.sentence == (
        f"All channels of the remote control were constant {text}, but they have noise at other times"
    )
    assert (found.evidence[0].message, found.evidence[0].at_ns) == ("RCIN", 40 * S)
    still = dict(sticks, C2=noisy(seed=9)["C2"])
    assert finding_of(report(rows("RCIN", **still)), "radio.held") is None  # another channel moves


def parameters(functions: dict[int, int], **more: float) -> MadeTable:
    values = dict(more)
    for channel, function in functions.items():
        values |= {f"SERVO{channel}_FUNCTION": function, f"SERVO{channel}_MIN": 1000, f"SERVO{channel}_MAX": 2000,
                   f"SERVO{channel}_TRIM": 1500}  # fmt: skip
    return MadeTable("PARM", [0] * len(values), {"Name": list(values), "Value": list(values.values())})


@pytest.mark.parametrize(
    ("parts", "expected"),
    [
        ([(200, 244, 2000.0)], None),  # 4.9 % of 900 rows
        ([(200, 245, 2000.0)], (Severity.NOTICE, "5 %", "0:20.0 for 4.5 s", 245)),
        ([(200, 245, 1997.5)], (Severity.NOTICE, "5 %", "0:20.0 for 4.5 s", 245)),
        ([(200, 245, 1997.0)], None),
        ([(200, 245, 1000.0)], (Severity.NOTICE, "5 %", "0:20.0 for 4.5 s", 245)),
        ([(200, 229, 2000.0), (300, 329, 2000.0), (400, 429, 2000.0)], None),  # never for three seconds
        ([(200, 230, 2000.0), (300, 329, 2000.0)], (Severity.NOTICE, "7 %", "0:20.0 for 3.0 s", 230)),
        ([(200, 424, 2000.0)], (Severity.NOTICE, "25 %", "0:20.0 for 22.4 s", 424)),
        ([(200, 425, 2000.0)], (Severity.WARNING, "25 %", "0:20.0 for 22.5 s", 425)),
        ([(200 + 100 * each, 290 + 100 * each, 2000.0) for each in range(6)],
         (Severity.NOTICE, "60 %", "0:20.0 for 9.0 s", 290)),
        ([(0, 100, 2000.0)], None),  # before arming
    ],
)  # fmt: skip
def test_an_output_at_its_end(parts: list[tuple[int, int, float]], expected: Any) -> None:
    port = column(1500.0, *parts)
    section = report(parameters({1: 73}), rows("RCOU", C1=port), ARM)
    found = finding_of(section, "radio.saturated")
    if expected is None:
        assert found is None
        return
    severity, share, longest, last = expected
    assert found is not None
    assert (found.severity, found.sentence) == (
        severity,
        f"output 1 (throttle port) was at the end of its range for {share} of the armed time, longest from {longest}",
    )
    assert found.evidence == (Evidence("RCOU", "C1", 20 * S, int(AT_NS[last])),)
    (plot,) = [each for each in section.plots if each.key == "outputs"]
    assert [(mark.at_ns, mark.until_ns, mark.text) for mark in plot.marks] == [
        (20 * S, int(AT_NS[last]), "radio.saturated")
    ]
    np.testing.assert_allclose(plot.traces[0].y, (port - 1500.0) / 5.0)


def test_outputs_that_do_not_steer_may_be_at_their_end() -> None:
    lights = report(parameters({1: 181}), rows("RCOU", C1=column(1500.0, (200, 900, 2000.0))), ARM)
    assert said(lights) == []
    unknown = report(rows("RCOU", C1=column(1500.0, (200, 900, 1900.0))))
    found = finding_of(unknown, "radio.saturated")
    assert found is not None
    assert found.severity is Severity.NOTICE  # what it drives is not known
    assert "for 70 % of the time, longest from 0:20.0 for 70.0 s" in found.sentence
    assert unknown.lacks[-1].startswith("What the outputs drive is not known: the log has no SERVOn_FUNCTION")


def swings(size: float, half_rows: int) -> np.ndarray:
    """To and fro from one end to the other, with a change of direction every so many rows."""
    return 1500.0 + 500.0 * size * np.where(np.arange(ROWS) // half_rows % 2, 0.5, -0.5)


@pytest.mark.parametrize(
    ("command", "expected"),
    [
        (swings(0.19, 5), None),
        (swings(0.21, 5), "1.0"),  # a change of direction each half second
        (swings(0.5, 6), "0.8"),
        (swings(0.5, 8), "0.6"),  # 1.25 changes a second
        (swings(0.5, 9), None),
        (1500.0 + np.arange(ROWS) % 2 * 10.0, None),  # a tremble of 2 %
    ],
)
def test_outputs_that_swing(command: np.ndarray, expected: str | None) -> None:
    section = report(parameters({1: 26}), rows("RCOU", C1=command))
    found = finding_of(section, "radio.oscillation")
    if expected is None:
        assert found is None
        return
    assert found is not None
    assert found.severity is Severity.NOTICE
    assert found.sentence.endswith(f"swings to and fro {expected} times a second by more than 20 % of its range")
    assert found.evidence == (Evidence("RCOU", "C1", 0, int(AT_NS[-1])),)


def test_swings_of_a_short_record_are_not_counted() -> None:
    for many, counted in ((52, True), (51, False), (49, False)):
        table = MadeTable("RCOU", AT_NS[:many], {"C1": swings(0.5, 5)[:many]})
        section = report(parameters({1: 26}), table)
        assert (grid_of(section, "outputs").rows[0][-1] is not None) is counted


def test_a_ramp_with_rests_is_one_move() -> None:
    ramp = 1200.0 + np.arange(ROWS) // 10 * 6.0
    section = report(parameters({1: 26}), rows("RCOU", C1=ramp))
    name, least, mean, most, at_end, longest, turns = grid_of(section, "outputs").rows[0]
    assert str(name).startswith("output 1 (")
    assert (least, most, at_end, longest, turns) == (-60.0, pytest.approx(58.8), 0.0, 0.0, 0.0)
    assert mean == pytest.approx(-0.6, abs=0.01)


@pytest.mark.parametrize(
    ("port", "starboard", "expected"),
    [
        (1600.0, 1670.0, None),  # 14 %
        (1600.0, 1680.0,
         "output 1 (throttle port) worked at 20 % and output 3 (throttle starboard) at 36 % on average"),
        (1680.0, 1600.0,
         "output 1 (throttle port) worked at 36 % and output 3 (throttle starboard) at 20 % on average"),
        (column(1500.0, (100, 199, 1900.0)), 1500.0, None),  # for less than a hundred rows
        (column(1500.0, (100, 200, 1900.0)), 1500.0,
         "output 1 (throttle port) worked at 80 % and output 3 (throttle starboard) at 0 % on average"),
        (column(1500.0, (0, 100, 1900.0)), 1500.0, None),  # before arming
    ],
)  # fmt: skip
def test_port_against_starboard(port: Any, starboard: Any, expected: str | None) -> None:
    section = report(parameters({1: 73, 3: 74}), rows("RCOU", C1=port, C3=starboard), ARM)
    found = finding_of(section, "radio.uneven")
    assert (None if found is None else found.sentence) == expected
    if found is not None:
        assert (found.severity, found.evidence[0].at_ns) == (Severity.NOTICE, 10 * S)


@pytest.mark.parametrize(
    ("out", "speed", "expected"),
    [
        (column(50.0, (200, 300, 99.0)), 1.69, (10.0, 300)),
        (column(50.0, (200, 300, 98.9)), 1.0, None),
        (column(50.0, (200, 300, -99.0)), -1.69, (10.0, 300)),  # astern
        (column(50.0, (200, 300, 99.0)), 1.71, None),
        (column(50.0, (200, 249, 99.0)), 1.0, None),  # 4.9 s
        (column(50.0, (200, 250, 99.0)), 1.5, (5.0, 250)),
        (column(50.0, (200, 250, 99.0), (300, 400, 99.0)), column(1.0, (300, 400, 1.69)), (10.0, 400)),
    ],
)
def test_full_throttle_and_too_slow(out: np.ndarray, speed: Any, expected: Any) -> None:
    section = report(rows("RCOU", C1=1500.0), rows("THR", DesSpeed=2.0, Speed=speed, ThrOut=out))
    found = finding_of(section, "radio.too_slow")
    if expected is None:
        assert found is None
        return
    assert found is not None
    length_s, last = expected
    begin = last - round(length_s * 10)
    lag = 2.0 - abs(float(np.broadcast_to(speed, ROWS)[begin]))
    assert (found.severity, found.sentence) == (
        Severity.WARNING,
        f"At full throttle the vessel stayed {lag:.1f} m/s below the demanded speed, longest from "
        f"0:{begin // 10}.0 for {length_s:.1f} s",
    )
    assert found.evidence[-1] == Evidence("THR", "DesSpeed", int(AT_NS[begin]), int(AT_NS[last]))


def test_full_throttle_by_the_outputs_of_an_old_log() -> None:
    """Both thrusters are at their ends from row 200 and 220 on; the speed is logged between the rows of the outputs."""
    outputs = rows("RCOU", C1=column(1600.0, (200, 400, 2000.0)), C3=column(1600.0, (220, 400, 2000.0)))
    speeds = MadeTable("THR", AT_NS - S // 20, {"DesSpeed": np.full(ROWS, 2.0), "Speed": np.full(ROWS, 1.0)})
    found = finding_of(report(parameters({1: 73, 3: 74}), outputs, speeds), "radio.too_slow")
    assert found is not None
    assert [(each.at_ns, each.until_ns) for each in found.evidence] == [
        (int(AT_NS[221]) - S // 20, int(AT_NS[401]) - S // 20)
    ]
    assert finding_of(report(parameters({1: 181}), outputs, speeds), "radio.too_slow") is None


def test_how_often_the_steering_is_at_its_end() -> None:
    section = report(
        rows("RCOU", C1=1500.0), rows("STER", SteerOut=column(0.0, (0, 30, 4499.0), (30, 40, -4500.0),
        (40, 90, 4498.0))),
        rows("PIDS", Flags=column(2, (0, 125, 3))),
    )  # fmt: skip
    assert section.facts[1:] == (
        Fact("outputs", "Outputs in use", 1),
        Fact("steering_at_limit_percent", "Steering at its end", 4.0, "%"),
        Fact("steering_integrator_held_percent", "Steering rate controller limited", 12.5, "%"),
    )


def test_small_dips_on_the_way_up_are_no_swings() -> None:
    """Each rise is a quarter of the range, each dip a tenth."""
    way = np.cumsum(np.tile([0.25, -0.1], 12)) - 1.0
    command = np.concatenate([way, np.full(ROWS - len(way), way[-1])])
    section = report(parameters({1: 26}), rows("RCOU", C1=1500.0 + 500.0 * command))
    assert grid_of(section, "outputs").rows[0][-1] == 0.0
    falling = report(parameters({1: 26}), rows("RCOU", C1=1500.0 - 500.0 * command))
    assert grid_of(falling, "outputs").rows[0][-1] == 0.0
