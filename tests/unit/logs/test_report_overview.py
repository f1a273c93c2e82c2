"""The overview of a report and a page of signals, from files whose content is known."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from dataflash_records import ITSELF, described, record

from sim_core.geodesy import LocalFrame
from xitl_cli.logs.model.analysis import LogAnalysis
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.sections import Fact, Plot, Section, Trace
from xitl_cli.logs.report.build import build_report, open_all, short_names
from xitl_cli.logs.report.signal_page import is_image, signal_page, write_image

S = 1_000_000_000
HEAD = (
    ITSELF
    + described(1, b"ATT", "QccC", "TimeUS,Roll,Pitch,Yaw")
    + described(2, b"MSG", "QZ", "TimeUS,Message")
    + described(3, b"POS", "QLLf", "TimeUS,Lat,Lng,Alt")
    + described(4, b"ARM", "QB", "TimeUS,ArmState")
    + described(5, b"MODE", "QMBB", "TimeUS,Mode,ModeNum,Rsn")
    + described(6, b"GPS", "QBLLff", "TimeUS,Status,Lat,Lng,Spd,GCrs")
    + described(7, b"RCOU", "QHH", "TimeUS,C1,C3")
    + described(8, b"CMD", "QHHHLLfB", "TimeUS,CTot,CNum,CId,Lat,Lng,Alt,Frame")
)
LAT, LON, ALT = 47.0, 8.0, 400.0


def us(at_s: float) -> int:
    return round(at_s * 1e6)


def deg(value: float) -> int:
    return round(value * 1e7)


def sailed(folder: Path, name: str = "a.bin", seconds: int = 30, yaw_deg: float = 359.0) -> Path:
    """From 10 s on: 1e-5 deg a second to the north, the yaw goes up by 0.2 deg a second."""
    rows = [record(2, "QZ", us(10.0), b"ArduRover V4.5.7 (0123abcd)")]
    rows += [
        record(8, "QHHHLLfB", us(10.0), 3, n, 16, deg(LAT + 1e-4 * n), deg(LON + 1e-4 * n), 0.0, 0) for n in range(3)
    ]
    for second in range(seconds):
        at = us(10.0 + second)
        rows.append(record(1, "QccC", at, 100, 0, round(((yaw_deg + 0.2 * second) % 360.0) * 100)))
        rows.append(record(3, "QLLf", at, deg(LAT + 1e-5 * second), deg(LON), ALT))
        rows.append(record(6, "QBLLff", at, 3, deg(LAT + 1e-5 * second), deg(LON), 1.25, 0.0))
        rows.append(record(7, "QHH", at, 1500 + second, 1600))
        if second == 3:
            rows.append(record(4, "QB", at, 1))
        if second in (0, 5):
            rows.append(record(5, "QMBB", at, second * 2, second * 2, 1))
    path = folder / name
    path.write_bytes(HEAD + b"".join(rows))
    return path


def test_the_overview_of_one_log(tmp_path: Path) -> None:
    report = build_report([sailed(tmp_path)], [])
    overview = report.overview
    assert overview.origin == pytest.approx((LAT, LON, ALT), abs=1e-6)
    (track,) = overview.tracks
    frame = LocalFrame(LAT, LON, ALT)
    expected = frame.ned(LAT + 1e-5 * np.arange(30.0), np.full(30, LON), np.full(30, ALT))
    assert track.name == "estimate"
    np.testing.assert_allclose(track.north_m, expected[:, 0], atol=0.02)
    np.testing.assert_allclose(track.east_m, 0.0, atol=0.02)
    np.testing.assert_allclose(track.at_s, 10.0 + np.arange(30.0))
    assert track.speed_mps is not None
    np.testing.assert_allclose(track.speed_mps, 1.25)
    there = frame.ned(LAT + 1e-4 * np.array([1.0, 2.0]), LON + 1e-4 * np.array([1.0, 2.0]), np.full(2, ALT))
    assert [point.name for point in overview.waypoints] == ["1", "2"]
    np.testing.assert_allclose([(point.north_m, point.east_m) for point in overview.waypoints], there[:, :2], atol=0.02)
    assert [(mark.text, mark.at_ns, mark.until_ns) for mark in overview.modes] == [
        ("MANUAL", 10 * S, 15 * S), ("AUTO", 15 * S, 39 * S),
    ]  # fmt: skip
    assert [(mark.text, mark.at_ns, mark.until_ns) for mark in overview.armed] == [("armed", 13 * S, 39 * S)]
    plots = {plot.key: plot for plot in overview.plots}
    assert list(plots) == ["overview.speed", "overview.yaw", "overview.outputs"]
    assert [trace.name for trace in plots["overview.outputs"].traces] == ["channel 1", "channel 3"]
    assert plots["overview.outputs"].traces[0].y.tolist() == [1500.0 + second for second in range(30)]
    assert (plots["overview.speed"].y_label, plots["overview.outputs"].y_label) == ("speed (m/s)", "pulse (us)")
    yaw = plots["overview.yaw"].traces[0]
    assert yaw.name == "yaw (ATT.Yaw)"
    assert np.isnan(yaw.y).sum() == 1  # the line is broken at north
    assert overview.lacks == ()
    (file,) = report.files
    assert (file.vehicle, file.format, file.span_ns) == (
        "rover, ArduRover V4.5.7 (0123abcd)",
        "dataflash",
        (10 * S, 39 * S),
    )


def test_a_log_without_positions_and_modes_says_so(tmp_path: Path) -> None:
    path = tmp_path / "b.bin"
    path.write_bytes(HEAD + record(1, "QccC", us(1.0), 0, 0, 0) + record(1, "QccC", us(2.0), 0, 0, 0))
    overview = build_report([path], []).overview
    assert (overview.tracks, overview.origin, overview.waypoints) == ((), None, ())
    assert overview.lacks == (
        "no position was logged, so there is no map; log POS, GPS or an odometry topic",
        "no mode was logged; log MODE messages or heartbeats",
    )


def test_sections_and_failures_of_analyses(tmp_path: Path) -> None:
    steps: list[str] = []
    many = Plot("p", "P", "m", (Trace("t", np.arange(100_000) * 1_000_000, np.zeros(100_000)),))

    def works(log: Log) -> Section:
        return Section("one", "One", (Fact("rows", "Rows", len(log.tables["ATT"])),), plots=(many,))

    def fails(log: Log) -> Section:
        raise ValueError("broken")

    analyses = [LogAnalysis("one", works), LogAnalysis("two", fails), LogAnalysis("none", lambda log: None)]
    path = sailed(tmp_path)
    report = build_report([path, tmp_path / "missing.bin", path], analyses, steps.append)
    (file,) = report.files
    assert [section.facts[0].value for section in file.sections] == [30]
    assert len(file.sections[0].plots[0].traces[0].x) < 20_000
    assert [(failure.analysis, failure.error) for failure in file.failures] == [("two", "ValueError: broken")]
    assert [refusal.path.name for refusal in report.refusals] == ["missing.bin"]
    assert steps == ["a.bin: one", "a.bin: two", "a.bin: none", "overview"]
    assert build_report([path], [], overview=False).overview.tracks == ()


def test_files_are_opened_once_and_in_order(tmp_path: Path) -> None:
    from contextlib import ExitStack

    one, other = sailed(tmp_path, "a.bin"), sailed(tmp_path, "b.bin")
    with ExitStack() as opened:
        logs, refusals = open_all([other, one, other, tmp_path / "no.bin"], opened)
        assert [log.path for log in logs] == [other, one]
        assert len(refusals) == 1
    assert short_names([one]) == ["a.bin"]


# Signals


def test_a_page_of_signals_by_unit(tmp_path: Path) -> None:
    path = sailed(tmp_path)
    page, refusals = signal_page(
        [path, tmp_path / "no.bin"], ["ATT.Roll", "RCOU", "ATT.Pitch", "MODE.ModeNum"], 12.0, 14.0
    )
    assert len(refusals) == 1
    assert page.title == "a.bin"
    (part,) = page.parts
    plots = {plot.title: plot for plot in part.section.plots}
    assert list(plots) == ["ATT.Roll, RCOU.C1, RCOU.C3 and 2 more"]
    (plot,) = part.section.plots
    assert plot.key == "signals.numbers"
    found = {trace.name: (trace.x.tolist(), trace.y.tolist(), trace.style) for trace in plot.traces}
    at = [12 * S, 13 * S, 14 * S]
    assert found["ATT.Roll"] == (at, [1.0, 1.0, 1.0], "line")
    assert found["RCOU.C1"] == (at, [1502.0, 1503.0, 1504.0], "steps")
    assert found["MODE.ModeNum"][0] == []
    assert len(page.notices) == 1
    with pytest.raises(LogError, match="has no value between --from and --until"):
        signal_page([path], ["ATT.Roll"], 100.0, None)
    with pytest.raises(LogError):
        signal_page([tmp_path / "no.bin"], ["ATT.Roll"], None, None)


def test_what_is_an_image() -> None:
    assert [is_image(Path(name)) for name in ("a.html", "a.htm", "a", "a.PNG", "a.svg", "a.pdf")] == [
        False, False, False, True, True, True,
    ]  # fmt: skip
    with pytest.raises(LogError, match=r"cannot plot to \.gif; name a file that ends in"):
        is_image(Path("a.gif"))


@pytest.mark.medium
def test_an_image_of_signals_has_their_names_and_is_the_same_again(tmp_path: Path) -> None:
    page, _ = signal_page([sailed(tmp_path)], ["ATT.Roll", "RCOU.C1 * 1"], None, None)
    image = tmp_path / "a.svg"
    write_image(page, image)
    first = image.read_bytes()
    text = first.decode()
    assert {"a.bin", "ATT.Roll", "time (s)"} <= set(re.findall(r"<text[^>]*>([^<]*)</text>", text))
    write_image(page, image)
    assert image.read_bytes() == first
    other = tmp_path / "b.svg"
    other.write_bytes(b"not an image")
    with pytest.raises(LogError, match="svg"):
        write_image(page, other)
    assert other.read_bytes() == b"not an image"
    write_image(page, tmp_path / "c.png")
    assert (tmp_path / "c.png").read_bytes().startswith(b"\x89PNG")
