"""What `doctor` says of one thing: how it stands, what was found, what to do."""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any, NamedTuple

OK, WARNING, PROBLEM = "ok", "warning", "problem"
_COLOURS = {OK: "32", WARNING: "33", PROBLEM: "1;31"}


class Finding(NamedTuple):
    """level: ok, warning (works, less well) or problem (will not work). advice: empty when there is nothing to do."""

    check: str
    level: str
    found: str
    advice: str = ""


def exit_code(findings: Iterable[Finding]) -> int:
    return 1 if any(finding.level == PROBLEM for finding in findings) else 0


def text(findings: Iterable[Finding], colour: bool = False) -> str:
    """One line a finding, and one below it for what to do."""
    lines = []
    for finding in findings:
        level = finding.level.ljust(len(PROBLEM))
        if colour:
            level = f"\033[{_COLOURS[finding.level]}m{level}\033[0m"
        lines.append(f"{level}  {finding.check:<14}  {finding.found}")
        if finding.advice:
            lines.append(f"{'':25}→ {finding.advice}")
    return "\n".join(lines)


def to_objects(findings: Iterable[Finding]) -> list[dict[str, str]]:
    return [finding._asdict() for finding in findings]


def to_json(findings: Iterable[Finding]) -> str:
    return json.dumps(to_objects(findings), indent=2, ensure_ascii=False)


def from_objects(objects: Any) -> list[Finding]:
    """Raises ValueError for what `to_objects` did not make."""
    try:
        findings = [Finding(**{key: str(value) for key, value in one.items()}) for one in objects]
    except (AttributeError, TypeError):
        raise ValueError("not findings of a doctor") from None
    if any(finding.level not in _COLOURS for finding in findings):
        raise ValueError("not findings of a doctor")
    return findings
