"""A report as one JSON object: stable keys, no NaN, plots left out."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

import numpy as np

from xitl_cli.logs.clocks.time_line import TimeLine
from xitl_cli.logs.model.sections import Evidence, Finding, Section, Severity
from xitl_cli.logs.report.causes import FindingGroup, group_findings
from xitl_cli.logs.report.file_report import FileFinding, FileReport, ReportedFiles
from xitl_cli.logs.report.wording import SEVERITY_NAMES

FORMAT = 1


def document(report: ReportedFiles) -> dict[str, Any]:
    """format: version of this layout. Instants: `at_ns` on the log's own time, `at_s` on the report's time line.

    findings: the worst causes first, each followed by what follows from it (`follows_from`, null for a cause). counts:
    of all of them; causes: of the causes, each as severe as the worst that follows from it.
    """
    groups = group_findings(report)
    return {
        "format": FORMAT,
        "worst": SEVERITY_NAMES[report.worst] if report.findings else None,
        "counts": {
            SEVERITY_NAMES[severity]: sum(found.finding.severity == severity for found in report.findings)
            for severity in sorted(Severity, reverse=True)
        },
        "causes": {
            SEVERITY_NAMES[severity]: sum(group.worst == severity for group in groups)
            for severity in sorted(Severity, reverse=True)
        },
        "findings": [row for group in groups for row in _group(group)],
        "files": [_file(file) for file in report.files],
        "alignment": [_alignment(file) for file in report.files] if len(report.files) > 1 else [],
        "refused": [{"path": str(refusal.path), "reason": refusal.sentence} for refusal in report.refusals],
    }


def _file(file: FileReport) -> dict[str, Any]:
    return {
        "name": file.name,
        "path": str(file.path),
        **({"vessel": file.vessel, "vessels": list(file.vessels)} if file.vessel else {}),
        "format": file.format,
        "base": file.base,
        "span_ns": None if file.span_ns is None else list(file.span_ns),
        "duration_s": file.duration_s,
        "health": file.health.as_json(),
        "about": dict(file.facts),
        "sections": {section.key: section_document(section, file.time_line) for section in file.sections},
        "failures": [asdict(failure) for failure in file.failures],
    }


def section_document(section: Section, time_line: TimeLine) -> dict[str, Any]:
    return {
        "title": section.title,
        "worst": SEVERITY_NAMES[section.worst] if section.findings else None,
        "facts": {fact.key: plain(fact.value) for fact in section.facts},
        "units": {fact.key: fact.unit for fact in section.facts if fact.unit},
        "findings": [_finding(finding, time_line) for finding in section.findings],
        "grids": {
            grid.key: {
                "title": grid.title,
                "columns": list(grid.columns),
                "rows": [[plain(value) for value in row] for row in grid.rows],
            }
            for grid in section.grids
        },
        "lacks": list(section.lacks),
    }


def _group(group: FindingGroup) -> list[dict[str, Any]]:
    cause = group.cause
    named = {"file": cause.file.name, "key": cause.finding.key, "sentence": cause.finding.sentence}
    return [_found(cause, None), *(_found(found, named) for found in group.consequences)]


def _found(found: FileFinding, follows_from: dict[str, str] | None) -> dict[str, Any]:
    finding = _finding(found.finding, found.file.time_line)
    return {"file": found.file.name, "section": found.section.key, **finding, "follows_from": follows_from}


def _finding(finding: Finding, time_line: TimeLine) -> dict[str, Any]:
    return {
        "key": finding.key,
        "severity": SEVERITY_NAMES[finding.severity],
        "sentence": finding.sentence,
        "next_step": finding.next_step,
        "evidence": [_evidence(evidence, time_line) for evidence in finding.evidence],
    }


def _evidence(evidence: Evidence, time_line: TimeLine) -> dict[str, Any]:
    return {
        "message": evidence.message,
        "field": evidence.field,
        "at_ns": _whole(evidence.at_ns),
        "until_ns": _whole(evidence.until_ns),
        "at_s": None if evidence.at_ns is None else round(time_line.second(evidence.at_ns), 9),
        "until_s": None if evidence.until_ns is None else round(time_line.second(evidence.until_ns), 9),
        "value": evidence.value,
    }


def _alignment(file: FileReport) -> dict[str, Any]:
    line = file.time_line
    return {
        "file": file.name,
        "reference": line.reference,
        "method": line.method,
        "offset_s": line.offset_ns * 1e-9,
        "drift_ppm": plain(line.drift_ppm),
        "error_s": plain(line.error_s),
        "sentence": line.sentence,
    }


def _whole(value: int | None) -> int | None:
    return None if value is None else int(value)


def plain(value: object) -> str | int | float | bool | None:
    """As JSON knows it: numbers of numpy become Python's, what is no number becomes null."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if isinstance(value, str | int | bool | None) else str(value)
