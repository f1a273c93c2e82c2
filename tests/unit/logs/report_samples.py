"""A small report made by hand, with hostile text wherever a log could put some."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from xitl_cli.logs.clocks.time_line import TimeLine
from xitl_cli.logs.model.log import Damage, LogHealth
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Grid, Mark, Plot, Section, Severity, Trace
from xitl_cli.logs.report.file_report import FileReport, RefusedFile
from xitl_cli.logs.report.model import MapTrack, MapWaypoint, Overview, Report

HOSTILE = '</script><script>document.title="taken"</script><img src=x onerror="document.title=1">\x1b[31m'
SECONDS = 60.0
AT_S = np.arange(0.0, SECONDS, 0.005)
AT_NS = (AT_S * 1e9).astype(np.int64)

DAMAGED = LogHealth(1000, 90, damaged=2, damage=(Damage(417, 17, "no record begins here"),), lost_bytes=34)


def scheduler_section() -> Section:
    window_ns = np.arange(10, 61, 10, dtype=np.int64) * 1_000_000_000
    return Section(
        "scheduler",
        "Scheduler",
        facts=(Fact("loops", "Loops", 14400), Fact("load_pct", "Load", None, "%"), Fact("rate_hz", "Rate", 50.0, "Hz")),
        findings=(
            Finding("scheduler.fine", Severity.OK, "load stayed under 61 %"),
            Finding(
                "scheduler.long_loops",
                Severity.WARNING,
                f"12 of 14400 loops were long {HOSTILE}",
                (Evidence("PM", "MaxT", 43_200_000_000, 53_200_000_000, "23 ms"),),
                "look at what else happened then",
            ),
        ),
        grids=(
            Grid(
                "windows",
                "Windows",
                ("at (s)", "long", "with"),
                ((43.2, 4, HOSTILE), (None, 2, "x" * 70), (1e-9, 0, None)),
            ),
        ),
        plots=(
            Plot(
                "max",
                "Longest loop",
                "MaxT (us)",
                (Trace("PM.MaxT", window_ns, np.array([2500.0, 2600, 2550, 2500, 23184, 2600]), "steps"),),
                marks=(Mark(43_200_000_000, HOSTILE, 53_200_000_000, Severity.WARNING),),
            ),
        ),
        lacks=(f"tasks are in a file {HOSTILE}",),
    )


def sensor_section() -> Section:
    rng = np.random.default_rng(3)
    tau_s = np.logspace(-2, 2, 40)
    return Section(
        "sensors",
        "Sensors",
        findings=(
            Finding(
                "sensors.gap",
                Severity.CRITICAL,
                "the gyroscope stopped",
                (Evidence("IMU", None, 20_000_000_000),),
                "look",
            ),
        ),
        plots=(
            Plot("gyro", "Rates", "rad/s", (Trace(f"GyrX {HOSTILE}", AT_NS, rng.normal(0.0, 0.01, len(AT_NS))),)),
            Plot("allan", "Allan", "rad/s", (Trace("GyrX", tau_s, 1e-3 / np.sqrt(tau_s)),), kind="loglog", x_label="s"),
        ),
    )


def sample_overview() -> Overview:
    thin = slice(None, None, 20)
    east_m, north_m = 20.0 * np.sin(AT_S / 10.0)[thin], 20.0 * np.cos(AT_S / 10.0)[thin]
    speed = Trace("speed (GPS.Spd)", AT_NS, 2.0 + np.sin(AT_S))
    return Overview(
        (Plot("overview.speed", "Speed over ground", "speed (m/s)", (speed,)),),
        (MapTrack("estimate", AT_S[thin], east_m, north_m, np.full(len(east_m), 2.0)),),
        (MapWaypoint("1", 0.0, 20.0), MapWaypoint("2", 20.0, 0.0)),
        (Mark(0, "MANUAL", 10_000_000_000), Mark(10_000_000_000, HOSTILE, 60_000_000_000)),
        (Mark(5_000_000_000, "armed", 55_000_000_000),),
        (43.1, 5.9, 12.0),
    )


def sample_report(health: LogHealth = DAMAGED) -> Report:
    file = FileReport(
        f"boat{HOSTILE.replace('/', '_')}.bin",
        Path("boat.bin"),
        "dataflash",
        "boot",
        (0, int(SECONDS * 1e9)),
        health,
        {},
        (scheduler_section(), sensor_section()),
        TimeLine(),
        f"Rover {HOSTILE}",
    )
    return Report(
        (file,), (RefusedFile(Path("x.ulg"), "x.ulg: looks like a PX4 log; convert it first"),), sample_overview()
    )
