"""Sections of a campaign at the terminal and in JSON: their sentences first, then facts and tables."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from xitl_cli.commands.terminal import say

if TYPE_CHECKING:
    from rich.console import Console

    from xitl_cli.logs.model.sections import Section


def show_sections(console: Console, sections: Sequence[Section]) -> None:
    """Print the findings of each section, their next steps and its tables."""
    from xitl_cli.logs.model.sections import Severity
    from xitl_cli.logs.report.terminal import show_section

    styles = {Severity.CRITICAL: "bold red", Severity.WARNING: "yellow", Severity.NOTICE: "cyan", Severity.OK: "green"}
    for section in sections:
        for finding in section.findings:
            console.print()
            say(console, f"{finding.sentence}.", styles[finding.severity])
            if finding.next_step:
                say(console, finding.next_step)
        show_section(console, section)


def sections_document(sections: Sequence[Section]) -> dict[str, Any]:
    """Return the sections by their keys, as in `xitl logs analyze --json`."""
    from xitl_cli.logs.clocks.time_line import TimeLine
    from xitl_cli.logs.report.json import section_document

    return {section.key: section_document(section, TimeLine()) for section in sections}
