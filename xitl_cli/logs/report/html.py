"""A page as one HTML file that needs no network. All text from a log is escaped by `escape`."""

from __future__ import annotations

import base64
import hashlib
import importlib.util
import itertools
import os
import re
import secrets
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from html import escape
from importlib import resources
from pathlib import Path

from xitl_cli.logs.clocks.time_line import TimeLine
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.sections import Evidence, Fact, Finding, Grid, Plot, Section, Severity
from xitl_cli.logs.model.text import plural
from xitl_cli.logs.report import wording
from xitl_cli.logs.report.model import Overview, Report
from xitl_cli.logs.report.page import FileCard, Page, PageFinding, PageGroup, PagePart, Replay, report_page
from xitl_cli.logs.report.plots import json_text, map_payload, page_payload, plot_payload, signals_payload, thinned_note

_MOST_ROWS = 2000
_MOST_EVIDENCE = 12
_SENTENCE = 60
"""Length of a cell, in characters, from which its text is wrapped."""
_WIDE = 100
"""Length of all columns, with at most _SENTENCE characters each, that does not fit on a small screen."""


def badge(severity: Severity) -> str:
    name = wording.SEVERITY_NAMES[severity]
    return f'<span class="badge {name}">{name}</span>'


def card_markup(shown: Sequence[FileCard]) -> str:
    """Cards of files. A single file needs no name, because the page has it."""
    cards = []
    for card in shown:
        name = f"<h2>{escape(card.name)}</h2>" if len(shown) > 1 else ""
        facts = "".join(f"<dt>{escape(label)}</dt><dd>{escape(value)}</dd>" for label, value in card.facts)
        state = ""
        if card.degraded is not None:
            word = "Degraded" if card.degraded else "Whole"
            notes = "; ".join(map(escape, card.notes)) or "every record was read"
            kind = "degraded" if card.notes or card.degraded else "whole"
            state = f'<p class="state {kind}"><strong>{word}</strong>: {notes}.</p>'
        cards.append(f'<article class="card">{name}<dl>{facts}</dl>{state}</article>')
    return "".join(cards)


def finding_items(groups: Sequence[PageGroup], parts: Sequence[PagePart]) -> str:
    """List in the header of a page: causes, and below each its consequences.

    The consequences are unfolded if one of them is more severe than the cause.
    """
    items = []
    for group in groups:
        below = ""
        if group.consequences:
            severities = [consequence.finding.severity for consequence in group.consequences]
            consequences = "".join(
                f'<li class="finding {wording.SEVERITY_NAMES[severity]}">'
                f"{finding_item(consequence, parts, severity)}</li>"
                for consequence, severity in zip(group.consequences, severities, strict=True)
            )
            unfolded = " open" if group.worst > group.cause.finding.severity else ""
            below = (
                f'<details class="follows"{unfolded}><summary>What follows from it: '
                f"{wording.severity_counts(severities)}</summary>"
                f'<ol class="consequences">{consequences}</ol></details>'
            )
        items.append(
            f'<li class="finding {wording.SEVERITY_NAMES[group.worst]}" data-find>'
            f"{finding_item(group.cause, parts, group.worst, below)}</li>"
        )
    return "".join(items)


def finding_item(placed: PageFinding, parts: Sequence[PagePart], worst: Severity, below: str = "") -> str:
    """One finding. worst: severity shown as its badge. A cause has that of its group, as counted in the page's
    header."""
    finding, part, section_id = placed.finding, parts[placed.part], section_name(placed.part)
    return (
        f'{badge(worst)}<div><p class="sentence">{escape(wording.sentence_text(finding.sentence))}</p>'
        + evidence_line(finding.evidence, part.time_line, section_id)
        + (f'<p class="next">{escape(wording.sentence_text(finding.next_step))}</p>' if finding.next_step else "")
        + f'<p class="from"><a href="#{section_id}">{escape(part.section.title)}</a>'
        + (f" · {escape(part.label)}" if part.label else "")
        + f"</p>{below}</div>"
    )


def section_name(number: int) -> str:
    """Id of a section on the page."""
    return f"s{number + 1}"


def evidence_line(evidence: Sequence[Evidence], time_line: TimeLine, section_id: str) -> str:
    """Evidence. An entry with an instant is a button that shows that instant in the section."""
    if not evidence:
        return ""
    shown = []
    for entry in evidence[:_MOST_EVIDENCE]:
        text = escape(wording.evidence_text(entry, time_line))
        if entry.at_ns is None:
            shown.append(f'<span class="at">{text}</span>')
            continue
        from_s = time_line.second(entry.at_ns)
        until_s = from_s if entry.until_ns is None else time_line.second(entry.until_ns)
        shown.append(
            f'<button type="button" class="at" data-from="{from_s:.6f}" data-until="{until_s:.6f}" '
            f'data-section="{section_id}" title="Show this in the plots">{text}</button>'
        )
    if len(evidence) > _MOST_EVIDENCE:
        shown.append(f'<span class="more">and {len(evidence) - _MOST_EVIDENCE} more</span>')
    return f'<p class="evidence">{"".join(shown)}</p>'


def section_findings(findings: Sequence[Finding], time_line: TimeLine, section_id: str) -> str:
    if not findings:
        return ""
    items = "".join(
        f'<li class="{wording.SEVERITY_NAMES[finding.severity]}" data-find>{badge(finding.severity)}<div>'
        + escape(wording.sentence_text(finding.sentence))
        + evidence_line(finding.evidence, time_line, section_id)
        + "</div></li>"
        for finding in sorted(findings, key=lambda finding: -finding.severity)
    )
    return f'<ul class="brief">{items}</ul>'


def facts_markup(shown: Sequence[Fact]) -> str:
    if not shown:
        return ""
    rows = "".join(
        f"<div data-find><dt>{escape(wording.sentence_text(fact.label))}</dt>"
        f"<dd>{escape(wording.value_text(fact.value, fact.label))}"
        + (f' <span class="unit">{escape(fact.unit)}</span>' if fact.unit and fact.value is not None else "")
        + "</dd></div>"
        for fact in shown
    )
    return f'<dl class="facts">{rows}</dl>'


def grid_markup(shown: Grid) -> str:
    numeric = [wording.is_numeric(shown, index) for index in range(len(shown.columns))]
    head = "".join(
        f'<th scope="col"{_right(right)}>{escape(name)}</th>'
        for name, right in zip(shown.columns, numeric, strict=True)
    )
    # Whether a table has sentences, and more columns than fit next to them on a small screen.
    rows = shown.rows[:_MOST_ROWS]
    longest = [
        max(len(name), *(len(wording.value_text(row[index], name)) for row in rows if index < len(row)), 0)
        for index, name in enumerate(shown.columns)
    ]
    wide = max(longest, default=0) >= _SENTENCE and sum(min(length, _SENTENCE) for length in longest) >= _WIDE
    labels = [f' data-column="{escape(name)}"' if wide else "" for name in shown.columns]
    body = "".join(
        "<tr data-find>"
        + "".join(
            f"<td{_right(right)}{label}>{escape(wording.value_text(value, name))}</td>"
            for value, right, name, label in zip(row, numeric, shown.columns, labels, strict=False)
        )
        + "</tr>"
        for row in rows
    )
    left_out = len(shown.rows) - _MOST_ROWS
    note = f" The first {_MOST_ROWS}; --json has all of them." if left_out > 0 else ""
    return (
        f'<figure class="{"grid wide" if wide else "grid"}" data-find><figcaption>'
        f"<h3>{escape(wording.sentence_text(shown.title))}</h3>"
        f'<span class="note">{plural(len(shown.rows), "row")}.{note}</span></figcaption>'
        f'<div class="scroll" tabindex="0" role="region" aria-label="{escape(shown.title)}">'
        f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div></figure>"
    )


def lacks_markup(sentences: Sequence[str]) -> str:
    if not sentences:
        return ""
    items = "".join(f"<li data-find>{escape(wording.sentence_text(sentence))}</li>" for sentence in sentences)
    return f'<div class="lacks"><h3>Not judged</h3><ul>{items}</ul></div>'


def plot_markup(plot_id: str, title: str, kind: str, note: str, payload: str, controls: str = "") -> str:
    """Markup of a plot. The script draws it when it becomes visible."""
    over_time = ' tabindex="0"' if kind in ("time", "bands") else ""
    return (
        f'<figure class="plot {kind}" id="{plot_id}" data-find{over_time} aria-label="{escape(title)}">'
        f"<figcaption><h3>{escape(wording.sentence_text(title))}</h3>{controls}"
        f'<span class="note">{escape(note)}</span></figcaption>'
        '<div class="legend"></div><div class="canvas"></div>'
        f'<script type="application/json">{payload}</script></figure>'
    )


def _right(right: bool) -> str:
    return ' class="number"' if right else ""


_OVERVIEW_ID = "overview"
_DOCTYPE = "<!doctype html>"
_BANDS = (("mode", "modes"), ("armed", "arming"), ("finding", "findings"))
_TOGGLES = (("mode", "Modes", "true"), ("armed", "Armed", "false"), ("finding", "Findings", "true"))
_PICKER_ID = "signals"
_SCRIPTS = ("data.js", "plots.js", "time.js", "expressions.js", "picker.js", "replay.js", "page.js")


def write(report: Report, path: Path, replay: Replay | None = None) -> None:
    """Write a report; replaces the file at `path`. Raises LogError if it cannot be written."""
    write_page(replace(report_page(report), replay=replay), path)


def write_page(page: Page, path: Path) -> None:
    """Write a page atomically; errors as in `write`."""
    write_text(path, html(page))


def write_sections(path: Path, title: str, subtitle: str, sections: Sequence[Section]) -> None:
    """Write a page of sections without a log. Raises LogError if plotly is not installed, and as in `write`."""
    write_page(Page(title, subtitle, tuple(PagePart(section, TimeLine()) for section in sections)), path)


def _unwritable(path: Path, error: OSError) -> LogError:
    return LogError(f"{path}: cannot be written ({error.strerror}); choose another place")


def refuse_other(
    path: Path, beginning: bytes = _DOCTYPE.encode(), kind: str = "page", name: str = "report.html"
) -> None:
    """Raise LogError if a file of another kind exists at the path: a log named by mistake would be lost.

    beginning: first bytes of a file that may be replaced. kind, name: its kind and an example, for the error.
    """
    try:
        if path.is_dir():
            raise LogError(f"{path}: is a directory; name a file in it, such as {path / name}")
        if not path.exists():
            return
        if path.is_file():
            with path.open("rb") as file:
                if file.read(len(beginning)) in (b"", beginning):
                    return
        raise LogError(f"{path}: exists and is not a {kind}; choose another file name, such as {name}")
    except OSError as error:
        raise _unwritable(path, error) from error


def write_text(path: Path, text: str) -> None:
    refuse_other(path)
    replace_file(path, text.encode("utf-8", "replace"))


def replace_file(path: Path, content: bytes) -> None:
    """Replace a file atomically. Raises LogError if it cannot be written."""
    final = Path(os.path.realpath(path))  # what a link leads to is replaced, and not the link
    mask = os.umask(0)
    os.umask(mask)
    try:
        with tempfile.NamedTemporaryFile("wb", dir=final.parent, prefix=f".{final.name}.", delete=False) as file:
            partial = Path(file.name)
            try:
                file.write(content)
                file.close()
                partial.chmod(0o666 & ~mask)
                partial.replace(final)
            except BaseException:
                partial.unlink(missing_ok=True)
                raise
    except OSError as error:
        raise _unwritable(path, error) from error


def html(page: Page) -> str:
    identified = [(part, section_name(number)) for number, part in enumerate(page.parts)]
    groups = page.grouped
    numbers = itertools.count(1)

    def next_plot() -> str:
        return f"p{next(numbers)}"

    nonce = secrets.token_urlsafe(16)
    overview = page.overview
    if overview is None or not overview.tracks:
        track = ""
    else:
        origin = overview.origin
        note = "" if origin is None else f"metres about {origin[0]:.6f}°, {origin[1]:.6f}°"
        track = plot_markup(
            next_plot(), "Track", "track", note, json_text(map_payload(overview)), _map_controls(overview)
        )
    side = track + _replay(page.replay, nonce)
    body = [
        _overview(page, next_plot),
        _picker(page),
        *(_part(part, section_id, next_plot) for part, section_id in identified),
    ]
    plotly, style = _plotly(), _asset("page.css")
    script = '(() => {"use strict";\n' + "\n".join(map(_asset, _SCRIPTS)) + "})();\n"  # in a separate scope
    replay_sources = ""
    if page.replay is not None and page.replay.html:
        # The player has a WebAssembly module with glue code that creates functions from strings.
        replay_sources = (
            f" 'nonce-{nonce}' 'unsafe-eval'; worker-src blob:; connect-src data: blob:; font-src data:; "
            "frame-src 'self' about: blob:"
        )
    policy = (
        f"default-src 'none'; script-src {_hashed(plotly)} {_hashed(script)}{replay_sources}; "
        "style-src 'unsafe-inline'; img-src data: blob:; base-uri 'none'; form-action 'none'"
    )
    return (
        f'{_DOCTYPE}\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        '<meta name="color-scheme" content="light dark">\n<meta name="referrer" content="no-referrer">\n'
        f"<title>{escape(page.title)}</title>\n<style>{style}</style>\n</head>\n<body>\n"
        '<a class="skip" href="#main">To the findings</a>\n'
        f"{_bar(page)}\n{_navigation(page, identified, bool(groups), bool(body[0]))}\n"
        f'<main id="main">\n{_head(page, groups)}\n'
        f"{_findings(groups, page.parts, side)}\n{''.join(body)}\n"
        '<p class="none" id="none" hidden>Nothing here matches the filter.</p>\n</main>\n'
        f'<script type="application/json" id="page">{json_text(page_payload(page))}</script>\n'
        f"<script>{plotly}</script>\n<script>{script}</script>\n</body>\n</html>\n"
    )


def _bar(page: Page) -> str:
    kinds = {mark.kind for mark in page.marks}
    toggles = "".join(
        f'<button type="button" class="toggle" data-marks="{kind}" aria-pressed="{pressed}">{label}</button>'
        for kind, label, pressed in _TOGGLES
        if kind in kinds
    )
    return (
        f'<header class="bar"><strong class="title">{escape(page.title)}</strong>'
        '<output id="now" aria-live="off"></output>'
        f'<span class="tools">{toggles}'
        '<button type="button" id="whole" title="Show the whole time (0)" hidden>Whole time</button>'
        '<input type="search" id="filter" placeholder="Filter" aria-label="Filter findings, facts, tables and plots" '
        'title="Press / to come here">'
        '<button type="button" id="theme" title="Colours: as the system, light, dark">Auto</button></span></header>'
    )


def _navigation(page: Page, identified: list[tuple[PagePart, str]], findings: bool, overview: bool) -> str:
    links = ['<a href="#findings">Findings</a>'] if findings else []
    if overview:
        links.append(f'<a href="#{_OVERVIEW_ID}">Overview</a>')
    if page.signals:
        links.append(f'<a href="#{_PICKER_ID}">Signals</a>')
    label = ""
    for part, section_id in identified:
        if part.label != label:
            label = part.label
            links.append(f'<span class="of">{escape(label)}</span>')
        worst = part.section.worst
        many = sum(finding.severity == worst for finding in part.section.findings)
        name = wording.SEVERITY_NAMES[worst]
        title = plural(many, name)
        dot = f'<span class="dot {name}" title="{title}">{many}</span>' if worst > Severity.OK else ""
        links.append(f'<a href="#{section_id}">{escape(part.section.title)}{dot}</a>')
    return f'<nav aria-label="Sections">{"".join(links)}</nav>'


def _head(page: Page, groups: Sequence[PageGroup]) -> str:
    many = len(groups) + sum(len(group.consequences) for group in groups)
    verdict = wording.verdict([group.worst for group in groups], many)
    worst = max((group.worst for group in groups), default=Severity.OK)
    summary = f'<p class="verdict {wording.SEVERITY_NAMES[worst]}">{escape(verdict)}</p>' if groups else ""
    subtitle = f'<p class="subtitle">{escape(page.subtitle)}</p>' if page.subtitle else ""
    notices = "".join(f'<p class="notice-bar" role="note">{escape(notice)}</p>' for notice in page.notices)
    shown = f'<div class="cards">{card_markup(page.cards)}</div>' if page.cards else ""
    return f'<div class="head"><h1>{escape(page.title)}</h1>{subtitle}{summary}</div>{notices}{shown}'


def _findings(groups: Sequence[PageGroup], parts: Sequence[PagePart], side: str) -> str:
    """Findings with map and replay next to them."""
    side = f'<div class="side">{side}</div>' if side else ""
    if not groups:
        return f'<section id="findings">{side}</section>' if side else ""
    worse = [group for group in groups if group.worst > Severity.OK]
    fine = [group for group in groups if group.worst == Severity.OK]
    listed = f'<ol class="findings">{finding_items(worse, parts)}</ol>' if worse else ""
    if fine:
        listed += (
            f"<details{'' if worse else ' open'}><summary>{len(fine)} checked, and fine</summary>"
            f'<ol class="findings">{finding_items(fine, parts)}</ol></details>'
        )
    laid = ' class="beside"' if side else ""
    return f'<section id="findings"{laid}><h2>Findings</h2><div class="list">{listed}</div>{side}</section>'


def _replay(replay: Replay | None, nonce: str) -> str:
    """Frame of the replay. It is created on demand, because it takes a graphics context and time to unpack."""
    if replay is None:
        return ""
    if not replay.html:
        return f'<p class="replay-lack">{escape(wording.sentence_text(replay.note))}</p>' if replay.note else ""
    # Prepare HTML for a frame of the page, which inherits the page's policy. Each script, and each script that
    # these create, gets the nonce. No text of a log can know it.
    lets_make = (
        f'<script nonce="{nonce}">(() => {{ const make = document.createElement; '
        "document.createElement = function (name, ...rest) { const made = make.call(this, name, ...rest); "
        f'if (String(name).toLowerCase() === "script") made.nonce = "{nonce}"; return made; }}; }})();</script>'
    )
    known = re.sub(r"<script(?=[\s>])", f'<script nonce="{nonce}"', replay.html)
    data = json_text(
        {"html": re.sub(r"<head[^>]*>", lambda head: head[0] + lets_make, known, count=1), "lateS": replay.late_s}
    )
    return (
        f'<figure class="replay" id="replay"><figcaption><h3>Replay in 3D</h3>'
        '<button type="button" id="play" aria-expanded="false">Show</button>'
        f'<span class="note">{len(data) / 1e6:.1f} MB of this page</span></figcaption><div class="stage"></div>'
        f'<script type="application/json" id="replay-page">{data}</script></figure>'
    )


def _overview(page: Page, next_plot: Callable[[], str]) -> str:
    parts = []
    overview = page.overview
    if page.marks:
        kinds = {mark.kind for mark in page.marks}
        title = ", ".join(word for kind, word in _BANDS if kind in kinds).capitalize()
        parts.append(plot_markup(next_plot(), title, "bands", "", json_text({"kind": "bands"})))
    if overview is not None:
        parts += [_plot(plot, TimeLine(), next_plot) for plot in overview.plots]
        parts.append(lacks_markup(overview.lacks))
    return f'<section id="{_OVERVIEW_ID}"><h2>Overview</h2>{"".join(parts)}</section>' if any(parts) else ""


def _picker(page: Page) -> str:
    """Picker of signals and expressions to plot; the page contains their data."""
    if not any(held.tables for held in page.signals):
        return ""
    notes, data = "", ""
    for held in page.signals:
        log = f"of {held.label} " if held.label else ""
        notes += f"<p>The page holds {escape(log + held.sentence)}.</p>"
        data += f'<script type="application/json" class="held">{json_text(signals_payload(held))}</script>'
    return (
        f'<section id="{_PICKER_ID}"><h2>Signals</h2>'
        '<form id="pick" autocomplete="off"><input type="text" id="picking" list="fields" spellcheck="false" '
        'aria-label="Signal or expression" placeholder="ATT.Roll, or wrap180(ATT.DesYaw - ATT.Yaw)">'
        '<datalist id="fields"></datalist><button type="submit">Draw</button>'
        '<select id="messages" aria-label="Message"></select></form>'
        '<div id="columns" class="choices"></div><div id="suggested" class="choices"></div>'
        '<p id="refused" role="alert"></p><div id="chosen" class="choices"></div><ul id="said" class="lacks"></ul>'
        f'<div id="picked"></div><div class="note held-note">{notes}</div>{data}</section>'
    )


def _map_controls(overview: Overview) -> str:
    choices = ["track"]
    if overview.tracks[0].speed_mps is not None:
        choices.insert(0, "speed")
    if overview.modes:
        choices.append("mode")
    options = "".join(f'<option value="{choice}">{choice}</option>' for choice in choices)
    return f'<label class="colour">Colour by <select>{options}</select></label>'


def _part(part: PagePart, section_id: str, next_plot: Callable[[], str]) -> str:
    section = part.section
    label = f" <small>{escape(part.label)}</small>" if part.label else ""
    return (
        f'<section id="{section_id}" class="part"><h2>{escape(section.title)}{label}</h2>'
        + section_findings(section.findings, part.time_line, section_id)
        + facts_markup(section.facts)
        + "".join(_plot(plot, part.time_line, next_plot) for plot in section.plots)
        + "".join(grid_markup(grid) for grid in section.grids)
        + lacks_markup(section.lacks)
        + "</section>"
    )


def _plot(plot: Plot, time_line: TimeLine, next_plot: Callable[[], str]) -> str:
    return plot_markup(next_plot(), plot.title, plot.kind, thinned_note(plot), json_text(plot_payload(plot, time_line)))


def _plotly() -> str:
    """plotly.js from the installed plotly package; the package itself is not imported."""
    package = importlib.util.find_spec("plotly")
    if package is None or package.origin is None:
        raise LogError("a page needs plotly.js, which is not installed; install it with `pip install 'xitl[report]'`")
    file = Path(package.origin).parent / "package_data" / "plotly.min.js"
    try:
        return file.read_text(encoding="utf-8")
    except OSError as error:
        raise LogError(
            f"{file}: the plotly package lacks its script; reinstall it with `pip install --force-reinstall plotly`"
        ) from error


def _asset(name: str) -> str:
    return (resources.files("xitl_cli.logs.report") / "assets" / name).read_text(encoding="utf-8")


def _hashed(script: str) -> str:
    return "'sha256-" + base64.b64encode(hashlib.sha256(script.encode()).digest()).decode("ascii") + "'"
