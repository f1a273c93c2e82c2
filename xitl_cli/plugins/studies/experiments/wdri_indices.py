"""The paper's eight realism indices (WDRI, eq 22 to 35), from the graphs of the shipped profiles `paper/eq…`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from sim_core.dataclass import dataclass
from xitl_cli.experiment.report import ExperimentReport, PaperFigure, PaperRow
from xitl_cli.experiment.setup import ExperimentSetup
from xitl_cli.graph.graph import Graph, Vertex
from xitl_cli.graph.wdri import Wdri, graph_from_profile, profile_wdri
from xitl_cli.plugins.studies.experiments.figures import GREY, OTHER, OURS, THIRD
from xitl_cli.profile import load_profile
from xitl_cli.profile.schema.graph import COMPLETE, node_meaning

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True)
class PrintedIndex:
    """A row of the paper: its equation, its subject, the profile with its graph, and the printed WDRI."""

    equation: str
    name: str
    profile: str
    wdri: float


PRINTED = (
    PrintedIndex("eq 24", "general use", "paper/eq24-general-use", 0.50),
    PrintedIndex("eq 26", "simple SITL", "paper/eq26-simple-sitl", 0.25),
    PrintedIndex("eq 27–30", "simulated scale vessel", "paper/eq30-scale-vessel", 0.36),
    PrintedIndex("eq 31", "SITL, own sensors", "paper/eq31-sitl-own-sensors", 0.28),
    PrintedIndex("eq 32", "SITL, injected sensors", "paper/eq32-sitl-injected", 0.42),
    PrintedIndex("eq 33", "HITL, injected sensors", "paper/eq33-hitl-injected", 0.58),
    PrintedIndex("eq 34", "full SITL", "paper/eq34-full-sitl", 0.54),
    PrintedIndex("eq 35", "full HITL", "paper/eq35-full-hitl", 0.93),
)
PRINTED_DIGITS = 2


@dataclass(frozen=True, slots=True)
class ComputedIndex:
    """An index of the paper and its computed value."""

    printed: PrintedIndex
    """The paper's index."""
    computed: Wdri
    """Index computed from the profile's graph."""
    reference: Graph | None
    """The graph of the reference."""

    @property
    def alike(self) -> bool:
        """True if both are equal to the printed digits."""
        return round(self.computed.wdri, PRINTED_DIGITS) == self.printed.wdri


def compute_indices() -> list[ComputedIndex]:
    """Return all indices of the paper, in its order."""
    indices = []
    for printed in PRINTED:
        computed = profile_wdri(load_profile(printed.profile))
        reference = None
        if computed.reference != COMPLETE:
            group = load_profile(computed.reference).graph
            reference = None if group is None else graph_from_profile(group)
        indices.append(ComputedIndex(printed, computed, reference))
    return indices


def wdri_report(setup: ExperimentSetup) -> ExperimentReport:
    """Return the table and the eight graphs. It carries out no runs."""
    indices = compute_indices()
    return ExperimentReport(
        section="WDRI",
        title="Realism indices of the eight graphs",
        notes=(
            "The paper's matrices were rebuilt from their legible entries, their symmetry and the printed results; "
            "each is a profile that `xitl wdri` takes.",
        ),
        rows=tuple(
            PaperRow(
                f"{index.printed.equation}, {index.printed.name}",
                index.printed.wdri,
                round(index.computed.wdri, 4),
                "",
                _difference(index),
            )
            for index in indices
        ),
        figures=(
            PaperFigure(
                "wdri-graphs",
                "The eight graphs of the paper's eq 24 to 35: filled vertices are real, pale ones virtual, dotted ones "
                "absent; dotted links are in the reference alone.",
                lambda figure: draw_graphs(figure, indices),
                (7.0, 8.2),
            ),
        ),
        completed=all(index.alike for index in indices),
        details={"indices": [{"profile": index.printed.profile, **index.computed.as_json()} for index in indices]},
    )


def _difference(index: ComputedIndex) -> str:
    computed, printed = index.computed, index.printed
    text = (
        f"Equal to the {PRINTED_DIGITS} digits printed"
        if index.alike
        else f"Off by {computed.wdri - printed.wdri:+.4f}: the graph of {printed.profile} is not the paper's"
    )
    if computed.n != len(computed.graph.vertices):
        whole = profile_wdri(load_profile(printed.profile), vertices="architecture").wdri
        text += (
            f": averaged over the {computed.n} vertices present; over all {len(computed.graph.vertices)}, "
            f"as in every other row, it would be {whole:.2f}"
        )
    weightless = [vertex.name for vertex in computed.graph.vertices if vertex.kind != "absent" and not vertex.weight]
    if weightless:
        text += f": {', '.join(weightless)} weighs 0 and its links still count for its neighbours"
    return f"{text}."


# The drawing. Vertices lie on a circle: the low level below, the high level above, driver and monitor at its sides.
_PLACES_DEG = {"D": 180, "HS": 140, "HC": 100, "HA": 60, "M": 20, "LA": -20, "LC": -60, "LS": -100, "PS1": -140}
_COLOURS = {"D": "#cc79a7", "P": GREY, "L": OURS, "H": THIRD, "M": OTHER}


def draw_graphs(figure: Figure, indices: Sequence[ComputedIndex]) -> None:
    """Draw index panel per graph, and index with the legend."""
    panels = figure.subplots(3, 3).flat
    for index, axes in zip(indices, panels, strict=False):
        graph, at = index.computed.graph, {}
        for vertex in graph.vertices:
            angle = math.radians(_PLACES_DEG[vertex.name])
            at[vertex.name] = (math.cos(angle), math.sin(angle))
        links = graph.link_names()
        referred = [] if index.reference is None else index.reference.link_names()
        _draw_links(axes, at, [link for link in referred if link not in links], color="#c4c4c4", linestyle=":")
        _draw_links(axes, at, links, color="#555555", linestyle="-")
        for vertex in graph.vertices:
            _draw_vertex(axes, vertex, *at[vertex.name], present=vertex.kind != "absent")
        computed = index.computed
        axes.set_title(
            f"{index.printed.equation}: {index.printed.name}\n"
            rf"$\bar{{d}}_w$ {computed.d_w_sim:.4g} of {computed.d_w_ref:.4g}"
            f"\nWDRI {computed.wdri:.4f}, paper {index.printed.wdri:.2f}"
        )
        _bare(axes)
    # The meaning of vertices and fillings
    axes = list(figure.axes)[len(indices)]
    rows = [
        (Vertex("D", "real", 1.0), "real, weight 1"),
        (Vertex("D", "virtual", 0.5), "virtual, weight 0.5"),
        (Vertex("D", "virtual", 0.0), "there, weight 0 (eq 33)"),
        (Vertex("D", "absent", 0.0), "absent"),
    ]
    for number, (vertex, words) in enumerate(rows):
        y = 1.1 - 0.5 * number
        _draw_vertex(axes, vertex, -1.1, y, present=vertex.kind != "absent")
        axes.text(-0.8, y, words, va="center", fontsize=7.5)
    lines = [f"{name}: {node_meaning(name)}" for name in ("D", "PS1", "M")]
    lines += ["L, H: low and high level", "S, C, A: sensing, control,", " actuation"]
    axes.text(-1.3, -0.9, "\n".join(lines), va="top", fontsize=7.5)
    _bare(axes)


def _draw_links(
    axes: Axes, at: dict[str, tuple[float, float]], links: Sequence[str], color: str, linestyle: str
) -> None:
    """Draw the links. A vertex with a link to itself gets a ring next to it."""
    from matplotlib.patches import Circle

    for link in links:
        first, second = link.split("-")
        if first == second:
            x, y = at[first]
            ring = Circle((1.25 * x, 1.25 * y), 0.16, fill=False, edgecolor=color, linestyle=linestyle, linewidth=1.0)
            axes.add_patch(ring)
        else:
            axes.plot(*zip(at[first], at[second], strict=True), color=color, linestyle=linestyle, linewidth=0.9)


def _draw_vertex(axes: Axes, vertex: Vertex, x: float, y: float, present: bool = True) -> None:
    from matplotlib.patches import Circle

    colour = _COLOURS[vertex.name[0]]
    look: dict[str, Any] = {"facecolor": "white", "edgecolor": "#aaaaaa", "linestyle": ":"}
    text = "#999999"
    if present:
        fill = colour if vertex.weight >= 1.0 else _paler(colour) if vertex.weight > 0 else "white"
        look, text = {"facecolor": fill, "edgecolor": colour}, "white" if vertex.weight >= 1.0 else "black"
    axes.add_patch(Circle((x, y), 0.2, linewidth=1.2, zorder=2, **look))
    axes.text(x, y, vertex.name, ha="center", va="center", fontsize=7, color=text, zorder=3)


def _paler(colour: str) -> tuple[float, ...]:
    from matplotlib.colors import to_rgb

    return tuple(0.7 + 0.3 * part for part in to_rgb(colour))


def _bare(axes: Axes) -> None:
    axes.set_xlim(-1.42, 1.42)
    axes.set_ylim(-1.42, 1.42)
    axes.set_aspect("equal")
    axes.axis("off")
