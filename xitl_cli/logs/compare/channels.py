"""Outputs to motors and servos, and what came from the sticks, of both over their common time."""

from __future__ import annotations

from xitl_cli.logs import signals
from xitl_cli.logs.compare.common_time import Pairing
from xitl_cli.logs.compare.profile_grid import grid, plot, profile_or_why
from xitl_cli.logs.compare.profiles import Profile
from xitl_cli.logs.log import Log
from xitl_cli.logs.sections import Fact, Section
from xitl_cli.logs.signals import Series
from xitl_cli.logs.signals.outputs import pulses

_Channels = dict[int, Series]


def channel_section(a: Log, b: Log, pairing: Pairing) -> Section | None:
    """Channels that neither moves are a fact, not a row. None where neither logs any."""
    found: list[Profile] = []
    facts: list[Fact] = []
    lacks: list[str] = []
    for words, in_a, in_b in (
        ("output", *_outputs(a, b)),
        ("RC input", signals.rc_inputs(a), signals.rc_inputs(b)),
    ):
        if not in_a and not in_b:
            continue
        if not in_a or not in_b:
            lacks.append(f"{'B' if in_a else 'A'} logs no {words}s.")
            continue
        still = []
        for channel in sorted(set(in_a) & set(in_b)):
            both = profile_or_why(f"{words} {channel}", in_a[channel], in_b[channel], pairing)
            if isinstance(both, str):
                lacks.append(both)
            elif both.constant and both.most == 0.0:
                still.append(channel)
            else:
                found.append(both)
        if still:
            key = f"same_{words.lower().replace(' ', '_')}s"
            facts.append(Fact(key, f"{words[:1].upper()}{words[1:]}s equal, never moved", _listed(still)))
        for name, alone in (("A", set(in_a) - set(in_b)), ("B", set(in_b) - set(in_a))):
            if alone:
                many = "s" if len(alone) > 1 else ""
                lacks.append(
                    f"{words[:1].upper()}{words[1:]}{many} {_listed(sorted(alone))} {'are' if many else 'is'} "
                    f"in {name} alone."
                )
    if not found and not facts and not lacks:
        return None
    plots = tuple(plot("channels", each) for each in found)
    return Section("channels", "Channels", tuple(facts), grids=grid("channels", found), plots=plots, lacks=tuple(lacks))


def _outputs(a: Log, b: Log) -> tuple[_Channels, _Channels]:
    """In one unit where both have it: commands, else pulse widths."""
    in_a, in_b = signals.outputs(a), signals.outputs(b)
    units = {each.unit for found in (in_a, in_b) for each in found.values()}
    if len(units) < 2:
        return in_a, in_b
    wide_a, wide_b = pulses(a), pulses(b)
    return (wide_a, wide_b) if wide_a and wide_b else (in_a, in_b)


def _listed(channels: list[int]) -> str:
    """1 to 4, 17, 18."""
    parts: list[list[int]] = []
    for channel in channels:
        if parts and channel == parts[-1][-1] + 1:
            parts[-1].append(channel)
        else:
            parts.append([channel])
    return ", ".join(f"{part[0]} to {part[-1]}" if len(part) > 2 else ", ".join(map(str, part)) for part in parts)
