"""The graph that a run had beside the one its profile claims."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from xitl_cli.graph.graph import Graph
from xitl_cli.graph.measured import AgentSeen, Pair, link_names, measured_graph
from xitl_cli.graph.of_profile import wdri_of, wdri_of_graph
from xitl_cli.graph.wdri import Vertices, Wdri
from xitl_cli.profile.schema import RunProfile
from xitl_cli.run.pilot import LinkReport, NodeReport, Traffic


def graph_section(
    profile: RunProfile,
    duration_s: float,
    moored_s: float,
    links: Sequence[LinkReport],
    nodes: Sequence[NodeReport],
    traffic: Traffic,
) -> dict[str, Any]:
    """`graph` of summary.json: claimed, measured, and where they differ. docs/recording.md explains the keys."""
    claimed = wdri_of(profile)
    graph = measured_graph(list(_agents(links, nodes, traffic)), _inside_host(profile, duration_s, moored_s))
    measured = _measured_wdri(graph, profile)
    claimed_links, measured_links = link_names(claimed.graph), link_names(graph)
    return {
        "reference": claimed.reference,
        "claimed": {"wdri": claimed.wdri, "links": claimed_links},
        "measured": {
            "wdri": None if measured is None else measured.wdri,
            "d_w_sim": None if measured is None else measured.d_w_sim,
            "d_w_ref": claimed.d_w_ref,
            "n": None if measured is None else measured.n,
            "n_ref": claimed.n_ref,
            "links": measured_links,
            "nodes": [
                {"name": vertex.name, "kind": vertex.kind, "runs_on": vertex.runs_on, "weight": vertex.weight}
                for vertex in graph.vertices
                if vertex.kind != "absent"
            ],
        },
        "missing": [link for link in claimed_links if link not in measured_links],
        "unclaimed": [link for link in measured_links if link not in claimed_links],
    }


def _measured_wdri(graph: Graph, profile: RunProfile) -> Wdri | None:
    """None where nothing was there to be measured: a run that failed before it began."""
    present = graph.present()
    if present == 0:
        return None
    vertices: Vertices = profile.graph.vertices
    if isinstance(vertices, int):
        vertices = max(vertices, present)
    return wdri_of_graph(graph, profile.graph.reference, vertices, f"{profile.name} as it ran")


def _agents(links: Sequence[LinkReport], nodes: Sequence[NodeReport], traffic: Traffic) -> Iterator[AgentSeen]:
    received = {link.name: link.received for link in links}
    for node in nodes:
        ways: Mapping[str, Mapping[int, int]] = traffic.get(node.link, {})
        sensors = "sensors" if node.link == "agent" else f"{node.link} sensors"
        yield AgentSeen(
            nodes=node.nodes,
            kind=node.kind,
            machine=node.machine,
            to_agent={} if received.get(sensors) == 0 else ways.get("tx", {}),
            from_agent=ways.get("rx", {}),
            estimates=node.estimates,
            efforts=node.efforts,
        )


def _inside_host(profile: RunProfile, duration_s: float, moored_s: float) -> Iterator[Pair]:
    """The truth goes to the recording. Without an autopilot so do the commands of who steers, and to the vessel."""
    if duration_s <= 0:
        return
    yield "PS1", "M"
    if profile.autopilot.kind == "none":
        if profile.driver.kind != "none":
            yield "D", "PS1"
            yield "D", "M"
    elif profile.driver.kind == "ground-station" and moored_s < duration_s:
        yield "D", "LC"  # it let the vessel go by arming it, past this machine's link
