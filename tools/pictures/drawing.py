"""Boxes, arrows and words as an SVG on a card of its own, legible on light and dark pages."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from html import escape
from itertools import pairwise
from pathlib import Path

_STYLE = """
:root{--card:#fbfcfd;--ink:#1c2733;--soft:#5b6b7b;--rule:#c9d3dc;--blue:#d9e8fb;--blue-rule:#2f6fc4;--green:#dcf2e3;\
--green-rule:#23834a;--amber:#fdeecf;--amber-rule:#b97a10;--grey:#eceff3;--grey-rule:#8a97a5;--red:#fbdedd;--red-rule:#c23b33}
@media (prefers-color-scheme:dark){:root{--card:#151b22;--ink:#e6edf4;--soft:#9fb0c0;--rule:#37444f;--blue:#17304f;\
--blue-rule:#6aa7f0;--green:#14372a;--green-rule:#54c487;--amber:#3f3016;--amber-rule:#e5b04c;--grey:#232c35;\
--grey-rule:#7f8f9e;--red:#452120;--red-rule:#ef7d75}}
text{font-family:system-ui,-apple-system,"Segoe UI",Roboto,"DejaVu Sans",sans-serif;fill:var(--ink)}
.mono{font-family:ui-monospace,SFMono-Regular,Menlo,Consolas,"DejaVu Sans Mono",monospace}
.soft{fill:var(--soft)}
"""
TONES = ("blue", "green", "amber", "grey", "red")


@dataclass(frozen=True, slots=True)
class Box:
    """Of pixels; x, y: its upper left corner."""

    x: float
    y: float
    width: float
    height: float

    def at(self, across: float, down: float) -> tuple[float, float]:
        """A point of it: (0, 0) upper left, (1, 1) lower right."""
        return self.x + across * self.width, self.y + down * self.height

    @property
    def left(self) -> tuple[float, float]:
        return self.at(0, 0.5)

    @property
    def right(self) -> tuple[float, float]:
        return self.at(1, 0.5)

    @property
    def top(self) -> tuple[float, float]:
        return self.at(0.5, 0)

    @property
    def bottom(self) -> tuple[float, float]:
        return self.at(0.5, 1)


@dataclass(slots=True)
class Drawing:
    """title: what a reader who cannot see it is told."""

    width: float
    height: float
    title: str
    _parts: list[str] = field(default_factory=list)

    def box(
        self, x: float, y: float, width: float, height: float, heading: str = "", *lines: str,
        tone: str = "grey", dashed: bool = False, mono: bool = False,
    ) -> Box:  # fmt: skip
        """heading bold, lines below it, all in the middle."""
        dash = ' stroke-dasharray="5 4"' if dashed else ""
        self._parts.append(
            f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="8" fill="var(--{tone})" '
            f'stroke="var(--{tone}-rule)" stroke-width="1.5"{dash}/>'
        )
        rows = ([(heading, True)] if heading else []) + [(line, False) for line in lines]
        first = y + height / 2 - 9 * (len(rows) - 1) + 5
        for row, (text, bold) in enumerate(rows):
            self.text(x + width / 2, first + 18 * row, text, bold=bold, soft=not bold, mono=mono and not bold)
        return Box(x, y, width, height)

    def frame(self, x: float, y: float, width: float, height: float, heading: str, tone: str = "grey") -> Box:
        """An outline with its heading inside, at the upper left."""
        self._parts.append(
            f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" rx="10" fill="none" '
            f'stroke="var(--{tone}-rule)" stroke-width="1.5"/>'
        )
        self.text(x + 14, y + 24, heading, bold=True, anchor="start")
        return Box(x, y, width, height)

    def text(
        self, x: float, y: float, text: str, *, bold: bool = False, soft: bool = False, mono: bool = False,
        anchor: str = "middle", size: float = 14,
    ) -> None:  # fmt: skip
        """y: of the base line."""
        names = " ".join(name for name, on in (("soft", soft), ("mono", mono)) if on)
        kind = f' class="{names}"' if names else ""
        weight = ' font-weight="600"' if bold else ""
        smaller = size - 1.5 if soft or mono else size
        self._parts.append(
            f'<text x="{x:g}" y="{y:g}" font-size="{smaller:g}" text-anchor="{anchor}"{weight}{kind}>'
            f"{escape(text)}</text>"
        )

    def arrow(
        self, *points: tuple[float, float], label: str = "", tone: str = "grey", both: bool = False,
        head: bool = True, above: float = 8, dashed: bool = False,
    ) -> None:  # fmt: skip
        """Through points. label: over the middle of its longest part; above: how far."""
        way = " ".join(f"{'ML'[place > 0]}{x:g} {y:g}" for place, (x, y) in enumerate(points))
        dash = ' stroke-dasharray="5 4"' if dashed else ""
        self._parts.append(f'<path d="{way}" fill="none" stroke="var(--{tone}-rule)" stroke-width="1.8"{dash}/>')
        if head:
            self._head(points[-2], points[-1], tone)
        if both:
            self._head(points[1], points[0], tone)
        if label:
            a, b = max(pairwise(points), key=lambda pair: math.dist(*pair))
            self.text((a[0] + b[0]) / 2, (a[1] + b[1]) / 2 - above, label, soft=True)

    def _head(self, start: tuple[float, float], end: tuple[float, float], tone: str) -> None:
        angle = math.atan2(end[1] - start[1], end[0] - start[0])
        sides = [(end[0] - 10 * math.cos(angle + turn), end[1] - 10 * math.sin(angle + turn)) for turn in (-0.4, 0.4)]
        corners = " ".join(f"{x:.1f},{y:.1f}" for x, y in (end, *sides))
        self._parts.append(f'<polygon points="{corners}" fill="var(--{tone}-rule)"/>')

    def circle(self, x: float, y: float, radius: float, text: str = "", tone: str = "grey") -> Box:
        self._parts.append(
            f'<circle cx="{x:g}" cy="{y:g}" r="{radius:g}" fill="var(--{tone})" '
            f'stroke="var(--{tone}-rule)" stroke-width="1.5"/>'
        )
        if text:
            self.text(x, y + 5, text, bold=True)
        return Box(x - radius, y - radius, 2 * radius, 2 * radius)

    def line(
        self, start: tuple[float, float], end: tuple[float, float], tone: str = "grey", width: float = 1.2
    ) -> None:
        (x1, y1), (x2, y2) = start, end
        self._parts.append(
            f'<line x1="{x1:g}" y1="{y1:g}" x2="{x2:g}" y2="{y2:g}" '
            f'stroke="var(--{tone}-rule)" stroke-width="{width:g}"/>'
        )

    def path(self, way: str, tone: str = "grey", filled: bool = False, width: float = 1.5) -> None:
        """way: as `d` of an SVG path has it."""
        fill = f"var(--{tone})" if filled else "none"
        self._parts.append(f'<path d="{way}" fill="{fill}" stroke="var(--{tone}-rule)" stroke-width="{width:g}"/>')

    def save(self, path: Path) -> None:
        """As a file that needs no other."""
        path.write_text(
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {self.width:g} {self.height:g}" '
            f'width="{self.width:g}" height="{self.height:g}" role="img"><title>{escape(self.title)}</title>'
            f"<style>{_STYLE.strip()}</style>"
            f'<rect width="{self.width:g}" height="{self.height:g}" rx="12" fill="var(--card)"/>\n'
            + "\n".join(self._parts)
            + "\n</svg>\n",
            encoding="utf-8",
        )
