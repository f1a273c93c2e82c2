"""What goes between autopilot and companion: the host stands for the network that joins them on the vessel."""

from __future__ import annotations

from agent.wire import dialect


def _ids(*names: str) -> frozenset[int]:
    return frozenset(getattr(dialect, f"MAVLINK_MSG_ID_{name}") for name in names)


TO_COMPANION = _ids(
    *("HEARTBEAT", "ATTITUDE", "ATTITUDE_QUATERNION", "LOCAL_POSITION_NED", "GLOBAL_POSITION_INT"),
    *("GPS_GLOBAL_ORIGIN", "HOME_POSITION", "COMMAND_ACK", "POSITION_TARGET_LOCAL_NED", "POSITION_TARGET_GLOBAL_INT"),
    *("MISSION_CURRENT", "MISSION_ITEM_REACHED", "MISSION_COUNT", "MISSION_ITEM_INT", "MISSION_ACK"),
)
TO_AUTOPILOT = _ids(
    *("COMMAND_LONG", "COMMAND_INT", "SET_MODE", "SET_POSITION_TARGET_LOCAL_NED", "SET_POSITION_TARGET_GLOBAL_INT"),
    *("MISSION_REQUEST_LIST", "MISSION_REQUEST_INT", "MISSION_REQUEST", "OBSTACLE_DISTANCE", "DISTANCE_SENSOR"),
)
KEPT_ELSEWHERE = _ids("XITL_CLOUD", "XITL_PING")
"""Not kept as frames: a recording has them as /lidar/points, /sonar/ping and /companion/map."""
