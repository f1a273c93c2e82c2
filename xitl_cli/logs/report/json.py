"""A report as one JSON object: stable keys, no NaN, without plots."""

from __future__ import annotations

import math
from dataclasses import asdict
from typing import Any

import numpy as np

from xitl_cli.logs.clocks.time_line import TimeLine
from xitl_cli.logs.model.sections import Finding, Section, Severity
from xitl_cli.logs.report.causes import group_findings
from xitl_cli.logs.report.file_report import FileReport, ReportedFiles
from xitl_cli.logs.report.wording import SEVERITY_NAMES

FORMAT = 1


def document(report: ReportedFiles) -> dict[str, Any]:
    """Return the report as a document. format: version of this layout.

    Instants: `at_ns` on the log's own time, `at_s` on the report's time line. findings: the most severe causes first,
    each followed by its consequences (`follows_from`, null for a cause). counts: of all findings. causes: counts of the
    causes, each with the highest severity of its group.
    """
    groups = group_findings(report)
    findings = []
    for group in groups:
        cause = group.cause
        key = {"file": cause.file.name, "key": cause.finding.key, "sentence": cause.finding.sentence}
        for placed, follows_from in ((cause, None), *((consequence, key) for consequence in group.consequences)):
            finding = _finding(placed.finding, placed.file.time_line)
            section = placed.section.key
            findings.append({"file": placed.file.name, "section": section, **finding, "follows_from": follows_from})
    return {
        "format": FORMAT,
        "worst": SEVERITY_NAMES[report.worst] if report.findings else None,
        "counts": {
            SEVERITY_NAMES[severity]: sum(placed.finding.severity == severity for placed in report.findings)
            for severity in sorted(Severity, reverse=True)
        },
        "causes": {
            SEVERITY_NAMES[severity]: sum(group.worst == severity for group in groups)
            for severity in sorted(Severity, reverse=True)
        },
        "findings": findings,
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


def _finding(finding: Finding, time_line: TimeLine) -> dict[str, Any]:
    return {
        "key": finding.key,
        "severity": SEVERITY_NAMES[finding.severity],
        "sentence": finding.sentence,
        "next_step": finding.next_step,
        "evidence": [
            {
                "message": evidence.message,
                "field": evidence.field,
                "at_ns": None if evidence.at_ns is None else int(evidence.at_ns),
                "until_ns": None if evidence.until_ns is None else int(evidence.until_ns),
                "at_s": None if evidence.at_ns is None else round(time_line.second(evidence.at_ns), 9),
                "until_s": None if evidence.until_ns is None else round(time_line.second(evidence.until_ns), 9),
                "value": evidence.value,
            }
            for evidence in finding.evidence
        ],
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


def plain(value: object) -> str | int | float | bool | None:
    """Value for JSON: numpy numbers become Python's; numbers that are not finite become null."""
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if isinstance(value, str | int | bool | None) else str(value)
