"""An undirected graph of weighted nodes, self-loops allowed, and the measured graph of a run."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from agent.wire import dialect
from sim_core.dataclass import dataclass
from xitl_cli.profile.schema.graph import KIND_WEIGHTS, architecture, is_node_name


@dataclass(frozen=True, slots=True)
class Vertex:
    """One node."""

    name: str
    kind: str
    weight: float
    """1 real, 0.5 virtual, 0 absent."""
    runs_on: str = ""
    does: str = ""
    """Its task."""


@dataclass(frozen=True, slots=True)
class Graph:
    """Vertices in the architecture's order and their symmetric 0/1 adjacency."""

    vertices: tuple[Vertex, ...]
    adjacency: tuple[tuple[int, ...], ...]

    def degrees(self) -> tuple[int, ...]:
        """Links per vertex; a self-loop counts once."""
        return tuple(sum(row) for row in self.adjacency)

    def present(self) -> int:
        """Return the number of vertices with a weight above 0."""
        return sum(vertex.weight > 0 for vertex in self.vertices)

    def link_names(self) -> list[str]:
        """Return every link once, as `PS1-LS`, in the architecture's order."""
        names = [vertex.name for vertex in self.vertices]
        return [
            f"{name}-{other}"
            for row, name in enumerate(names)
            for column, other in enumerate(names)
            if column >= row and self.adjacency[row][column]
        ]

    def weighted_degree(self, n: int) -> float:
        """Return the weighted average degree `sum(w (d - 1)) / n` over `n` vertices (eq 22 of the paper)."""
        if n < 1:
            raise ValueError(f"a weighted degree over n = {n} vertices is undefined; n must be at least 1")
        pairs = zip(self.vertices, self.degrees(), strict=True)
        return sum(vertex.weight * (degree - 1) for vertex, degree in pairs if vertex.weight > 0) / n


def build_graph(vertices: Iterable[Vertex], links: Iterable[tuple[str, str]]) -> Graph:
    """Return the graph of `vertices` joined by `links`, in any direction. Other nodes of the architecture are absent.

    Raises ValueError for a duplicate vertex or a link to an unknown name.
    """
    given: dict[str, Vertex] = {}
    for vertex in vertices:
        if vertex.name in given:
            raise ValueError(f"the node {vertex.name} is given twice")
        given[vertex.name] = vertex
    order = architecture(given)
    if unknown := set(given) - set(order):
        raise ValueError(f"{min(unknown)} is not a node; the nodes are {', '.join(order)}")
    index = {name: position for position, name in enumerate(order)}
    rows = [[0] * len(order) for _ in order]
    for one, other in links:
        if one not in index or other not in index:
            raise ValueError(f"the link {one}-{other} has an end that is not a node; the nodes are {', '.join(order)}")
        rows[index[one]][index[other]] = rows[index[other]][index[one]] = 1
    return Graph(
        vertices=tuple(given.get(name, Vertex(name, "absent", 0.0)) for name in order),
        adjacency=tuple(tuple(row) for row in rows),
    )


def complete_graph(names: Iterable[str]) -> Graph:
    """Return a graph with every vertex real and joined to every vertex, itself included: weighted degree n - 1."""
    names = tuple(names)
    vertices = tuple(Vertex(name, "real", 1.0) for name in names)
    return Graph(vertices, tuple((1,) * len(names) for _ in names))


Edge = tuple[str, str]
"""A link of the graph, by the names of its nodes."""

_LOW = {"S": "LS", "C": "LC", "A": "LA"}
_HIGH = {"S": "HS", "C": "HC", "A": "HA"}


def _ids(*names: str) -> list[int]:
    return [getattr(dialect, f"MAVLINK_MSG_ID_{name}") for name in names]


def _table(rows: Iterable[tuple[list[int], tuple[Edge, ...]]]) -> dict[int, tuple[Edge, ...]]:
    return {message_id: pairs for ids, pairs in rows for message_id in ids}


SENSORS = _ids("XITL_IMU", "XITL_GNSS", "XITL_MAGNETOMETER", "XITL_BAROMETER", "XITL_TRUTH")
ACTUATORS = dialect.MAVLINK_MSG_ID_XITL_ACTUATORS

# S, C and A are sensing, control and actuation of the agent's level. Messages that only maintain the link (run, tick,
# time stamps, status, parameters, mission transfer) are not traffic of the simulated system.
TO_AGENT = _table(
    [
        (SENSORS, (("PS1", "S"),)),
        (
            _ids(
                *("COMMAND_LONG", "COMMAND_INT", "SET_MODE", "MANUAL_CONTROL", "RC_CHANNELS_OVERRIDE"),
                *("SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT", "MISSION_SET_CURRENT"),
            ),
            (("D", "C"),),
        ),
        # Only to a companion: its sensor data, and the autopilot's reports.
        (_ids("XITL_CLOUD", "XITL_PING", "XITL_DETECTION"), (("PS1", "S"),)),
        (_ids("ATTITUDE", "ATTITUDE_QUATERNION", "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT"), (("LS", "C"),)),
        (_ids("MISSION_CURRENT", "MISSION_ITEM_REACHED"), (("LC", "C"),)),
    ]
)
FROM_AGENT = _table(
    [
        # The commands move the vessel, and they are recorded.
        ([ACTUATORS], (("A", "PS1"), ("A", "M"))),
        (_ids("SERVO_OUTPUT_RAW"), (("A", "M"),)),
        (
            _ids(
                *("ATTITUDE", "ATTITUDE_QUATERNION", "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT", "VFR_HUD"),
                *("GPS_RAW_INT", "RAW_IMU", "SCALED_PRESSURE", "EKF_STATUS_REPORT"),
            ),
            (("S", "M"),),
        ),
        (
            _ids(
                *("HEARTBEAT", "SYS_STATUS", "MISSION_CURRENT", "MISSION_ITEM_REACHED", "NAV_CONTROLLER_OUTPUT"),
                *("POSITION_TARGET_LOCAL_NED", "POSITION_TARGET_GLOBAL_INT", "STATUSTEXT"),
            ),
            (("C", "M"),),
        ),
        # Only from a companion: its results, its messages to the autopilot, and its orders.
        (_ids("ODOMETRY", "XITL_CLOUD", "XITL_OBSTACLE"), (("S", "M"),)),
        (_ids("XITL_COMPANION_STATUS"), (("C", "M"),)),
        (_ids("OBSTACLE_DISTANCE", "DISTANCE_SENSOR"), (("S", "LC"),)),
        (
            _ids("COMMAND_LONG", "SET_MODE", "SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT"),
            (("A", "LC"), ("A", "M")),
        ),
    ]
)


@dataclass(frozen=True, slots=True)
class AgentTraffic:
    """Traffic of one agent in a run."""

    nodes: str
    """Announced node kinds, as `LS,LC,LA`."""
    kind: str
    """`real` or `virtual`."""
    machine: str
    to_agent: Mapping[int, int]
    """Frames that the agent received, by message id."""
    from_agent: Mapping[int, int]
    """Frames that the host received, by message id."""
    estimates: int = 0
    """Estimates passed from sensing to control inside the agent."""
    efforts: int = 0
    """Efforts passed from control to actuation inside the agent."""


def measured_graph(agents: Sequence[AgentTraffic], edges: Iterable[Edge]) -> Graph:
    """Return the graph of the observed traffic. edges: links inside this machine that carried traffic, as PS1-M.

    Nodes of the host are virtual and are present when one of their links was used. Nodes of an agent are present when
    it announced them. If two agents run the same node, the larger weight counts.
    """
    links = set(edges)
    vertices: dict[str, Vertex] = {}
    for agent in agents:
        announced = {name for name in agent.nodes.split(",") if is_node_name(name)}
        level = _HIGH if announced and announced <= set(_HIGH.values()) else _LOW
        for counts, table in ((agent.to_agent, TO_AGENT), (agent.from_agent, FROM_AGENT)):
            used = (pair for number, count in counts.items() if count for pair in table.get(number, ()))
            links.update((level.get(one, one), level.get(other, other)) for one, other in used)
        if agent.estimates:
            links.add((level["S"], level["C"]))
        if agent.efforts:
            links.add((level["C"], level["A"]))
        kind = agent.kind if agent.kind in KIND_WEIGHTS else "virtual"
        for name in announced:
            vertex = Vertex(name, kind, KIND_WEIGHTS[kind], runs_on=agent.machine)
            if name not in vertices or vertices[name].weight < vertex.weight:
                vertices[name] = vertex
    for name in {end for link in links for end in link} - set(vertices):
        vertices[name] = Vertex(name, "virtual", KIND_WEIGHTS["virtual"], runs_on="this machine")
    return build_graph(vertices.values(), links)
