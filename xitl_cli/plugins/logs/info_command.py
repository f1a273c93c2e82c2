"""A summary of a log as lines of at most 80 columns. It avoids rich: its import takes longer than reading a log."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator

from xitl_cli.logs.model.table import Column
from xitl_cli.logs.model.text import duration_text, plural, printable
from xitl_cli.logs.report.wording import FORMAT_NAMES, damage_sentences
from xitl_cli.logs.summary import MessageSummary, Summary

_WIDTH = 80
_PLACES = 10
_TIME = {
    "boot": "since the autopilot started",
    "simulation": "since the run began",
    "utc": "since the first row; stamps are UTC",
    "unknown": "since the first row; the zero of the stamps is unknown",
}


def summary_lines(summary: Summary, *, every_field: bool = False) -> Iterator[str]:
    lines: list[tuple[str, str]] = []
    health = summary.health
    lines.append(
        ("format", f"{FORMAT_NAMES[summary.format]}, {_size(health.size_bytes)}, {plural(health.records, 'record')}")
    )
    if summary.span_s is None:
        lines.append(("time", "no row has a time stamp"))
    else:
        begin, end = summary.span_s
        lines.append(("time", f"{begin:.3f} to {end:.3f} s ({duration_text(end - begin)}) {_TIME[summary.base]}"))
    if summary.start_utc is not None:
        lines.append(("start", f"{summary.start_utc} UTC"))
    if vehicle := _vehicle(summary):
        lines.append(("vehicle", vehicle))
    lines.extend(summary.facts.items())
    lines.append(("health", "; ".join(["degraded" if health.degraded else "whole", *damage_sentences(health)])))
    if health.degraded:
        for damage in health.damage[:_PLACES]:
            lines.append(("", f"at byte {damage.place}: {damage.why}, {plural(damage.lost, 'byte')} lost"))
        if health.damaged > _PLACES:
            lines.append(("", f"and {health.damaged - _PLACES} more places; --json lists the first 1000"))
    width = max(len(label) for label, _ in lines) + 2
    yield printable(str(summary.path))
    for label, text in lines:
        yield from textwrap.wrap(
            printable(" ".join(text.split())) or "-",
            _WIDTH,
            initial_indent=f"  {label:<{width}}",
            subsequent_indent=" " * (width + 2),
            break_on_hyphens=False,
        )
    yield ""
    yield from _messages(summary.messages, every_field)


def _vehicle(summary: Summary) -> str:
    """Return for example `Rover, ArduRover V4.6.0 (0123abcd), CubeOrange.`"""
    about = {fact.key: str(fact.value) for fact in summary.about}
    version = about.get("firmware_version", "")
    firmware = about.get("firmware") or ("firmware" if version else "")
    parts = [
        about.get("vehicle_type") or about.get("vehicle", ""),
        firmware if version in firmware else f"{firmware} {version}",
        about.get("board", ""),
    ]
    return ", ".join(part for part in parts if part)


def _messages(messages: tuple[MessageSummary, ...], every_field: bool) -> Iterator[str]:
    if not messages:
        yield "no readable message"
        return
    name_width = max(len("message"), *(len(message.name) for message in messages))
    head = f"{'message':<{name_width}} {'rows':>8} {'Hz':>8} {'inst':>4}  fields"
    yield head.removesuffix("  fields") if every_field else head
    begin = len(head) - len("fields")
    for message in messages:
        rate = (
            "-"
            if message.rate_hz is None
            else (f"{message.rate_hz:.0f}" if message.rate_hz >= 1000 else f"{message.rate_hz:.3g}")
        )
        instances = "-" if message.instances is None else str(message.instances)
        front = f"{printable(message.name):<{name_width}} {message.rows:>8} {rate:>8} {instances:>4}  "
        columns = message.columns or ()
        names = [_field(column, every_field) for column in columns if not column.name.startswith("_")]
        if every_field:
            yield front.rstrip()
            fields = ", ".join(name.replace(" ", "\0") for name in names)  # a unit stays with its field
            indent = " " * 4
            wrapped = textwrap.wrap(
                fields, _WIDTH, initial_indent=indent, subsequent_indent=indent, break_on_hyphens=False
            )
            yield from (line.replace("\0", " ") for line in wrapped)
        else:
            yield (front + (_fitting(names, max(_WIDTH - begin, 16)) if names else "")).rstrip()
    if any(message.columns is None for message in messages):
        yield "fields are not read from a file of this size; --fields reads all of it"


def _field(column: Column, with_unit: bool) -> str:
    if not with_unit:
        return printable(column.name)
    counts = "".join(f"[{'' if count < 0 else count}]" for count in column.shape)
    return printable(f"{column.name}{counts} {column.unit}".strip())


def _fitting(names: list[str], width: int) -> str:
    """Return as many names as fit on a line, and the number of the others."""
    shown = " ".join(names)
    if len(shown) <= width:
        return shown
    while names:
        more = f"+{len(shown.split()) - len(names)}"
        line = " ".join([*names, more]) if more != "+0" else " ".join(names)
        if len(line) <= width:
            return line
        names = names[:-1]
    return f"{len(shown.split())} fields"


def _size(size_bytes: int) -> str:
    for unit, factor in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if size_bytes >= factor:
            return f"{size_bytes / factor:.1f} {unit}"
    return f"{size_bytes} bytes"
