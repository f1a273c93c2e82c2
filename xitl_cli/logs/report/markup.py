"""A page's findings, facts and tables as HTML. Whatever comes from a log goes through `escape`."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from xitl_cli.logs.report.instants import evidence_text
from xitl_cli.logs.report.page import Card, Part
from xitl_cli.logs.report.words import NAMES, is_numeric, plural, sentence_text, value_text
from xitl_cli.logs.sections import Evidence, Fact, Finding, Grid, Severity
from xitl_cli.logs.timeline.line import TimeLine

_MOST_ROWS = 2000
_MOST_EVIDENCE = 12


def badge(severity: Severity) -> str:
    name = NAMES[severity]
    return f'<span class="badge {name}">{name}</span>'


def cards(shown: Sequence[Card]) -> str:
    """One that is alone needs no name: it is that of the page."""
    alone = len(shown) == 1
    return "".join(
        f'<article class="card">{"" if alone else f"<h2>{escape(card.name)}</h2>"}<dl>'
        + "".join(f"<dt>{escape(label)}</dt><dd>{escape(value)}</dd>" for label, value in card.facts)
        + "</dl>"
        + _state(card)
        + "</article>"
        for card in shown
    )


def _state(card: Card) -> str:
    if card.degraded is None:
        return ""
    word = "Degraded" if card.degraded else "Whole"
    notes = "; ".join(map(escape, card.notes)) or "every record was read"
    kind = "degraded" if card.notes or card.degraded else "whole"
    return f'<p class="state {kind}"><strong>{word}</strong>: {notes}.</p>'


def finding_items(found: Sequence[tuple[Finding, Part, str]]) -> str:
    """The list at the head of a page; the third of each is the id of its section."""
    return "".join(
        f'<li class="finding {NAMES[finding.severity]}" data-find>{badge(finding.severity)}<div>'
        f'<p class="sentence">{escape(sentence_text(finding.sentence))}</p>'
        + evidence_line(finding.evidence, part.time_line, section_id)
        + (f'<p class="next">{escape(sentence_text(finding.next_step))}</p>' if finding.next_step else "")
        + f'<p class="from"><a href="#{section_id}">{escape(part.section.title)}</a>'
        + (f" · {escape(part.label)}" if part.label else "")
        + "</p></div></li>"
        for finding, part, section_id in found
    )


def evidence_line(evidence: Sequence[Evidence], time_line: TimeLine, section_id: str) -> str:
    """Each with an instant is a button that leads there."""
    if not evidence:
        return ""
    shown = [_evidence(each, time_line, section_id) for each in evidence[:_MOST_EVIDENCE]]
    if len(evidence) > _MOST_EVIDENCE:
        shown.append(f'<span class="more">and {len(evidence) - _MOST_EVIDENCE} more</span>')
    return f'<p class="evidence">{"".join(shown)}</p>'


def _evidence(evidence: Evidence, time_line: TimeLine, section_id: str) -> str:
    text = escape(evidence_text(evidence, time_line))
    if evidence.at_ns is None:
        return f'<span class="at">{text}</span>'
    from_s = time_line.second(evidence.at_ns)
    until_s = from_s if evidence.until_ns is None else time_line.second(evidence.until_ns)
    return (
        f'<button type="button" class="at" data-from="{from_s:.6f}" data-until="{until_s:.6f}" '
        f'data-section="{section_id}" title="Show this in the plots">{text}</button>'
    )


def section_findings(findings: Sequence[Finding], time_line: TimeLine, section_id: str) -> str:
    if not findings:
        return ""
    items = "".join(
        f'<li class="{NAMES[finding.severity]}" data-find>{badge(finding.severity)}<div>'
        + escape(sentence_text(finding.sentence))
        + evidence_line(finding.evidence, time_line, section_id)
        + "</div></li>"
        for finding in sorted(findings, key=lambda each: -each.severity)
    )
    return f'<ul class="brief">{items}</ul>'


def facts(shown: Sequence[Fact]) -> str:
    if not shown:
        return ""
    rows = "".join(
        f"<div data-find><dt>{escape(sentence_text(fact.label))}</dt><dd>{escape(value_text(fact.value, fact.label))}"
        + (f' <span class="unit">{escape(fact.unit)}</span>' if fact.unit and fact.value is not None else "")
        + "</dd></div>"
        for fact in shown
    )
    return f'<dl class="facts">{rows}</dl>'


def grid(shown: Grid) -> str:
    numeric = [is_numeric(shown, index) for index in range(len(shown.columns))]
    head = "".join(
        f'<th scope="col"{_right(right)}>{escape(name)}</th>'
        for name, right in zip(shown.columns, numeric, strict=True)
    )
    body = "".join(
        "<tr data-find>"
        + "".join(
            f"<td{_right(right)}>{escape(value_text(value, name))}</td>"
            for value, right, name in zip(row, numeric, shown.columns, strict=False)
        )
        + "</tr>"
        for row in shown.rows[:_MOST_ROWS]
    )
    left_out = len(shown.rows) - _MOST_ROWS
    note = f" The first {_MOST_ROWS}; --json has all of them." if left_out > 0 else ""
    return (
        f'<figure class="grid" data-find><figcaption><h3>{escape(sentence_text(shown.title))}</h3>'
        f'<span class="note">{plural(len(shown.rows), "row")}.{note}</span></figcaption>'
        f'<div class="scroll" tabindex="0" role="region" aria-label="{escape(shown.title)}">'
        f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div></figure>"
    )


def lacks(sentences: Sequence[str]) -> str:
    if not sentences:
        return ""
    items = "".join(f"<li data-find>{escape(sentence_text(sentence))}</li>" for sentence in sentences)
    return f'<div class="lacks"><h3>Not judged</h3><ul>{items}</ul></div>'


def plot(plot_id: str, title: str, kind: str, note: str, payload: str, controls: str = "") -> str:
    """The script draws into it when it comes into view."""
    over_time = ' tabindex="0"' if kind in ("time", "bands") else ""
    return (
        f'<figure class="plot {kind}" id="{plot_id}" data-find{over_time} aria-label="{escape(title)}">'
        f"<figcaption><h3>{escape(sentence_text(title))}</h3>{controls}"
        f'<span class="note">{escape(note)}</span></figcaption>'
        '<div class="legend"></div><div class="canvas"></div>'
        f'<script type="application/json">{payload}</script></figure>'
    )


def _right(right: bool) -> str:
    return ' class="number"' if right else ""
