"""The report model: results of the analyses of some logs. It needs no file any more."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from xitl_cli.logs.charts.chart import Chart
from xitl_cli.logs.model.analysis import AnalysisFailure
from xitl_cli.logs.model.sections import Mark, Plot, Severity
from xitl_cli.logs.model.table import Floats
from xitl_cli.logs.report.file_report import FileFinding, FileReport, FileSection, RefusedFile
from xitl_cli.logs.report.json import document
from xitl_cli.logs.report.signal_data import HeldLog


@dataclass(frozen=True, slots=True)
class MapTrack:
    """A path over ground."""

    name: str
    at_s: Floats
    """(N,) on the report's time line."""
    east_m: Floats
    """(N,)"""
    north_m: Floats
    """(N,)"""
    speed_mps: Floats | None = None
    """(N,)"""


@dataclass(frozen=True, slots=True)
class MapWaypoint:
    name: str
    east_m: float
    north_m: float


@dataclass(frozen=True, slots=True)
class Overview:
    """First part of every report: track, speed, yaw, outputs and states of all files on one time line."""

    plots: tuple[Plot, ...] = ()
    """x in nanoseconds on the report's time line."""
    tracks: tuple[MapTrack, ...] = ()
    waypoints: tuple[MapWaypoint, ...] = ()
    modes: tuple[Mark, ...] = ()
    """Spans on the report's time line, of the first file that has them."""
    armed: tuple[Mark, ...] = ()
    """Spans on the report's time line, of the first file that has them."""
    origin: tuple[float, float, float] | None = None
    """Latitude (deg), longitude (deg) and altitude (m) of the map's zero; None if unknown."""
    lacks: tuple[str, ...] = ()
    chart: Chart | None = None
    """Chart below the tracks."""


@dataclass(frozen=True, slots=True)
class Report:
    """All analyses of one or several logs.

    files: the logs that could be opened, in the given order. refusals: the others, with the reason. signals: signals of
    each log, for the selection list of a page.
    """

    files: tuple[FileReport, ...]
    refusals: tuple[RefusedFile, ...] = ()
    overview: Overview = Overview()
    signals: tuple[HeldLog, ...] = ()

    @property
    def findings(self) -> list[FileFinding]:
        """All findings, the most severe first, then in the order of files and sections."""
        every = [
            FileFinding(finding, section, file)
            for file in self.files
            for section in file.sections
            for finding in section.findings
        ]
        return sorted(every, key=lambda placed: -placed.finding.severity)

    @property
    def sections(self) -> list[FileSection]:
        """Every section of every file."""
        return [FileSection(section, file) for file in self.files for section in file.sections]

    @property
    def worst(self) -> Severity:
        """Highest severity of all findings."""
        return max((section.worst for file in self.files for section in file.sections), default=Severity.OK)

    @property
    def failures(self) -> list[AnalysisFailure]:
        """Analyses that failed."""
        return [failure for file in self.files for failure in file.failures]

    def as_json(self) -> dict[str, Any]:
        """The output of `xitl logs analyze --json`: stable keys, no NaN, without plots."""
        return document(self)
