"""Odometry and map rebuilt from a recording, measured against the truth and the run's own, and written to files.

PLY: Turk, The PLY Polygon File Format, 1994. PCD: "The PCD (Point Cloud Data) file format", Point Cloud Library,
version 0.7. TUM: the trajectory format of the RGB-D benchmark of TU Munich, as evo reads it.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from agent.companion.autopilot_state import AutopilotState
from agent.companion.clouds import CloudReassembler, PointCloud, cloud_messages
from agent.companion.mapping import LIDAR, SONAR, CloudMap
from agent.companion.odometry import LidarOdometry, OdometryError, RegisteredCloud
from agent.companion.odometry_filters import AutopilotMotionSource
from agent.companion.perception import PATIENCE_NS
from agent.companion.pose_history import AHEAD_NS
from agent.companion.settings import CompanionParameters, checked_parameter
from agent.companion.sonar import SonarPing, echo_points
from agent.wire.codec import Message
from sim_core import frames
from xitl_cli.errors import UserError
from xitl_cli.logs.compare.trajectories import Trajectory, tum_text
from xitl_cli.logs.export.files import make_directory, part_of
from xitl_cli.logs.model.log import Log
from xitl_cli.mapping.accuracy import apart, perception_sections
from xitl_cli.mapping.clouds import SeenPoints, clouds, map_points, online, pings, read_autopilot_messages, truth
from xitl_cli.profile.files.catalogue import PROFILE
from xitl_cli.profile.load import recorded_profiles
from xitl_cli.profile.schema import RunProfile

MapFormat = Literal["ply", "pcd"]

POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "u1"), ("source", "u1")])
"""source: 0 lidar, 1 sonar."""

_FLU = np.array([1.0, -1.0, -1.0], dtype=np.float32)
_PLY_TYPES = {"f": "float", "u": "uchar"}


def points_of(
    points_frd_m: NDArray[np.float32], intensity: NDArray[np.uint8], source: NDArray[np.uint8]
) -> NDArray[Any]:
    """(n,) POINT in axes forward, left, up, of points (n, 3) forward, right, down."""
    packed = np.zeros(len(points_frd_m), dtype=POINT)
    for axis, name in enumerate("xyz"):
        packed[name] = points_frd_m[:, axis] * _FLU[axis]
    packed["intensity"], packed["source"] = intensity, source
    return packed


def map_bytes(packed: NDArray[Any], kind: MapFormat) -> bytes:
    """The whole file, binary."""
    header = _ply_header(packed) if kind == "ply" else _pcd_header(packed)
    return header.encode("ascii") + packed.tobytes()


def write_map(path: Path, packed: NDArray[Any], kind: MapFormat) -> None:
    """Replaces an earlier one. Raises UserError when the place takes no file."""
    _write(path, map_bytes(packed, kind))


def write_tum(path: Path, trajectory: Trajectory) -> None:
    """Replaces an earlier one. Raises UserError when the place takes no file."""
    _write(path, tum_text(trajectory).encode("ascii"))


def write_text(path: Path, text: str) -> None:
    """Replaces an earlier one. Raises UserError when the place takes no file."""
    _write(path, text.encode())


def _write(path: Path, data: bytes) -> None:
    with part_of(path, overwrite=True) as part:
        part.write_bytes(data)


def _kinds(packed: NDArray[Any]) -> list[tuple[str, np.dtype[Any]]]:
    fields = packed.dtype.fields
    assert fields is not None
    return [(name, kind[0]) for name, kind in fields.items()]


def _ply_header(packed: NDArray[Any]) -> str:
    properties = "".join(f"property {_PLY_TYPES[kind.kind]} {name}\n" for name, kind in _kinds(packed))
    return (
        "ply\nformat binary_little_endian 1.0\ncomment metres; x forward, y left, z up where the odometry began\n"
        f"element vertex {len(packed)}\n{properties}end_header\n"
    )


def _pcd_header(packed: NDArray[Any]) -> str:
    kinds = _kinds(packed)
    rows = {
        "VERSION": "0.7",
        "FIELDS": " ".join(name for name, _ in kinds),
        "SIZE": " ".join(str(kind.itemsize) for _, kind in kinds),
        "TYPE": " ".join(kind.kind.upper() for _, kind in kinds),
        "COUNT": " ".join("1" for _ in kinds),
        "WIDTH": str(len(packed)),
        "HEIGHT": "1",
        "VIEWPOINT": "0 0 0 1 0 0 0",
        "POINTS": str(len(packed)),
        "DATA": "binary",
    }
    return "".join(f"{name} {value}\n" for name, value in rows.items())


@dataclass(frozen=True, slots=True, eq=False)
class Rebuilt:
    """The odometry (FRD where it began), the map (n, 3) in its frame, and what could not be used.

    source (n,): 0 lidar, 1 sonar. seen_ns (m,): stamps of the clouds of the points by lidar.
    """

    trajectory: Trajectory
    points_odom_m: NDArray[np.float32]
    intensity: NDArray[np.uint8]
    source: NDArray[np.uint8]
    seen_ns: NDArray[np.int64]
    clouds: int
    pings: int
    poses_refused: int
    points_refused: int


def rebuild(log: Log, profile: RunProfile | None) -> Rebuilt:
    """From /lidar/points and /sonar/ping, with the settings of the run's companion.

    Clouds go through the coding of the wire first, so that the odometry is given what it was given in the run, as it is
    what the autopilot said of its motion. Raises UserError without clouds and without KISS-ICP.
    """
    settings = _settings(profile)
    autopilot = _Autopilot(read_autopilot_messages(log) if settings["ODO_AIDED"] else iter(()), profile)
    try:
        odometry = LidarOdometry(settings["ODO_RANGE"], settings["ODO_VOXEL"], motion=autopilot.motions.motion_between)
    except OdometryError as error:
        raise UserError(f"{log.path}: {error}") from error
    cloud_map = CloudMap(settings["MAP_CELL"], settings["MAP_RANGE"])
    wire, placed, count = CloudReassembler(), list[RegisteredCloud](), 0
    seen = list[NDArray[np.int64]]()
    echoes = pings(log)
    heard = 0
    for cloud in clouds(log):
        count += 1
        autopilot.hear(cloud.end_ns)
        for sent in _over_the_wire(wire, cloud):
            found = odometry.register(sent.stamp_ns, sent.points_m, sent.offset_s)
            if found is not None:
                placed.append(found)
                added = cloud_map.add(found.pose_odom, found.points_frd_m, sent.intensity[found.kept], LIDAR)
                seen.append(np.full(len(added.intensity), sent.stamp_ns))
        while heard < len(echoes) and echoes[heard].stamp_ns <= cloud.end_ns:
            _hear(cloud_map, odometry, echoes[heard])
            heard += 1
    parts = [cloud_map.points_by(source) for source in (LIDAR, SONAR)]
    return Rebuilt(
        trajectory_of(placed),
        np.concatenate([part.points_odom_m for part in parts]),
        np.concatenate([part.intensity for part in parts]),
        np.repeat(np.array([LIDAR, SONAR], dtype=np.uint8), [len(part.intensity) for part in parts]),
        np.concatenate([np.empty(0, np.int64), *seen]),
        count,
        heard,
        odometry.poses_refused,
        odometry.points_refused,
    )


class _Autopilot:
    """What it said in the run, heard again as the companion heard it.

    That begins to listen with its first cloud. In lockstep its clock still shows the exchange before when it hears.
    """

    def __init__(self, said: Iterator[tuple[int, Message]], profile: RunProfile | None) -> None:
        self._view = AutopilotState()
        self.motions = AutopilotMotionSource(self._view.history, lambda stamp_ns: stamp_ns)
        self._told = said
        self._next = next(said, None)
        self._begun = False
        lockstep = profile is not None and profile.clock.mode == "lockstep"
        self._behind_ns = round(1e9 / profile.clock.exchange_rate_hz) if profile is not None and lockstep else 0

    def hear(self, end_ns: int) -> None:
        """Until it has told of this instant, as long as a companion waits for it."""
        history = self._view.history
        while self._next is not None and self._next[0] <= end_ns + PATIENCE_NS:
            late_ns = 0 if history.newest_ns is None else end_ns - history.newest_ns
            if self._next[0] > end_ns and history.newest_ns is not None and not 0 < late_ns <= AHEAD_NS:
                return
            stamp_ns, message = self._next
            if self._begun or stamp_ns > end_ns:
                self._begun = True
                self._view.handle(message, stamp_ns - self._behind_ns)
            self._next = next(self._told, None)


def trajectory_of(placed: list[RegisteredCloud]) -> Trajectory:
    """Poses by their instants."""
    if not placed:
        return Trajectory(np.empty(0, dtype=np.int64), np.empty((0, 3)), np.empty((0, 4)))
    poses = np.array([one.pose_odom for one in placed])
    stamps = np.array([one.stamp_ns for one in placed], dtype=np.int64)
    return Trajectory(stamps, poses[:, :3, 3], frames.matrix_to_quat(poses[:, :3, :3]))


def profile_of(log: Log) -> RunProfile | None:
    """The profile kept in the recording; None where there is none that this version understands."""
    return next((one for one in recorded_profiles(log.attachment(PROFILE)) if one.vessel == log.vessel), None)


def _settings(profile: RunProfile | None) -> dict[str, float]:
    defaults = CompanionParameters()
    values = {name: defaults[name] for name in defaults}
    companion = None if profile is None else profile.companion
    if companion is not None:
        values |= {name: checked_parameter(name, value) for name, value in companion.parameters.items()}
    return values


def _over_the_wire(wire: CloudReassembler, cloud: PointCloud) -> list[PointCloud]:
    return [whole for message in cloud_messages(cloud) for whole in wire.handle(message)]


def _hear(cloud_map: CloudMap, odometry: LidarOdometry, ping: SonarPing) -> None:
    pose = odometry.pose_at(ping.stamp_ns)
    if pose is not None:
        points_frd_m, intensity = echo_points(ping)
        cloud_map.add(pose, points_frd_m, intensity, SONAR)


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """report: for JSON. truth: body FRD to NED; online: as the companion said it in the run."""

    report: dict[str, Any]
    rebuilt: Rebuilt
    truth: Trajectory | None
    online: Trajectory | None


def measure(log: Log) -> Measured:
    """Raises UserError without clouds and without KISS-ICP."""
    from xitl_cli.scenery import Scenery

    profile = profile_of(log)
    boom = None if profile is None else Scenery(profile).boom
    rebuilt = rebuild(log, profile)
    true, said = truth(log), online(log)
    by_lidar = SeenPoints(rebuilt.points_odom_m[rebuilt.source == LIDAR], rebuilt.seen_ns)
    offline = perception_sections(true, rebuilt.trajectory, by_lidar, boom)
    report: dict[str, Any] = {
        "recording": str(log.path),
        "clouds": rebuilt.clouds,
        "pings": rebuilt.pings,
        "poses_refused": rebuilt.poses_refused,
        "points_refused": rebuilt.points_refused,
        "offline": {"odometry": offline.odometry, "mapping": offline.mapping},
        "online": None,
        "difference": None,
    }
    if said is not None:
        points = map_points(log)
        then = perception_sections(true, said, points["lidar"], boom)
        report["online"] = {"odometry": then.odometry, "mapping": then.mapping}
        whole = np.concatenate([part.points_odom_m for part in points.values()])
        report["difference"] = {**apart(rebuilt.trajectory, said), **_maps_apart(rebuilt.points_odom_m, whole)}
    return Measured(report, rebuilt, true, said)


def written(found: Measured, directory: Path, kind: MapFormat) -> list[Path]:
    """The files; earlier ones are replaced. Raises UserError when the place takes none."""
    make_directory(directory)
    rebuilt = found.rebuilt
    packed = points_of(rebuilt.points_odom_m, rebuilt.intensity, rebuilt.source)
    files = [directory / f"map.{kind}"]
    write_map(files[0], packed, kind)
    trajectories = {"trajectory": rebuilt.trajectory, "truth": found.truth, "online": found.online}
    for name, trajectory in trajectories.items():
        if trajectory is not None:
            files.append(directory / f"{name}.tum")
            write_tum(files[-1], trajectory)
    files.append(directory / "map.json")
    write_text(files[-1], json.dumps(found.report, indent=2, allow_nan=False) + "\n")
    return files


def _maps_apart(one: NDArray[np.float32], other: NDArray[np.float32]) -> dict[str, Any]:
    """Root mean square, over the points of one map, of the distance to the nearest of the other."""
    if not len(one) or not len(other):
        return {"map_rms_m": None}
    from scipy.spatial import KDTree  # type: ignore[import-untyped]

    off_m, _ = KDTree(other).query(one)
    return {"map_rms_m": round(float(np.sqrt(np.mean(off_m**2))), 4)}
