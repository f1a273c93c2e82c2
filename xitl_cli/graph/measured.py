"""The graph that a run had: the nodes that were there, and the links that carried something."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from agent.wire import dialect
from xitl_cli.graph.graph import Graph, Vertex, build_graph
from xitl_cli.profile.schema.graph import KIND_WEIGHTS, is_node_name

Pair = tuple[str, str]

_LOW = {"S": "LS", "C": "LC", "A": "LA"}
_HIGH = {"S": "HS", "C": "HC", "A": "HA"}


def _ids(*names: str) -> list[int]:
    return [getattr(dialect, f"MAVLINK_MSG_ID_{name}") for name in names]


def _table(rows: Iterable[tuple[list[int], tuple[Pair, ...]]]) -> dict[int, tuple[Pair, ...]]:
    return {message_id: pairs for ids, pairs in rows for message_id in ids}


SENSORS = _ids("XITL_IMU", "XITL_GNSS", "XITL_MAGNETOMETER", "XITL_BAROMETER", "XITL_TRUTH")
ACTUATORS = dialect.MAVLINK_MSG_ID_XITL_ACTUATORS

# S, C and A are sensing, control and actuation of the level that the agent runs. What only keeps the link going (run,
# tick, time stamps, status, parameters, the transfer of a mission) is no traffic of the simulated system.
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
        # To a companion alone: what it sees, and what the autopilot says of itself.
        (_ids("XITL_CLOUD", "XITL_PING"), (("PS1", "S"),)),
        (_ids("ATTITUDE", "ATTITUDE_QUATERNION", "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT"), (("LS", "C"),)),
        (_ids("MISSION_CURRENT", "MISSION_ITEM_REACHED"), (("LC", "C"),)),
    ]
)
FROM_AGENT = _table(
    [
        # The commands move the vessel, and the recording keeps them.
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
        # Of a companion alone: what it found, what the autopilot is told of it, and its orders.
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
    """What was seen of one agent in a run.

    nodes: the kinds it announced, as `LS,LC,LA`; kind: `real` or `virtual`. to_agent, from_agent: frames received at
    their end, by message id. estimates, efforts: what went inside it from sensing to control and on to actuation.
    """

    nodes: str
    kind: str
    machine: str
    to_agent: Mapping[int, int]
    from_agent: Mapping[int, int]
    estimates: int = 0
    efforts: int = 0


def measured_graph(agents: Sequence[AgentTraffic], host: Iterable[Pair]) -> Graph:
    """The graph of what was seen. `host`: links inside this machine that carried something, as PS1-M.

    Nodes of the host are virtual and there when one of their links was used; those of an agent are there when it
    announced them. Of two agents that run the same node, the one that weighs more counts.
    """
    links = set(host)
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
