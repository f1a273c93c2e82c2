"""A recording's odometry and map, offline and online, held against the truth and against each other."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agent.companion.mapping import LIDAR
from xitl_cli.logs.compare.trajectories import Trajectory
from xitl_cli.logs.export.safe_file import make_directory
from xitl_cli.logs.log import Log
from xitl_cli.mapping.accuracy import apart, perception_sections
from xitl_cli.mapping.clouds import map_points, online, truth
from xitl_cli.mapping.files import MapFormat, points_of, write_map, write_text, write_tum
from xitl_cli.mapping.offline import Rebuilt, profile_of, rebuild


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """report: for JSON. truth: body FRD to NED; online: as the companion said it in the run."""

    report: dict[str, Any]
    rebuilt: Rebuilt
    truth: Trajectory | None
    online: Trajectory | None


def measure(log: Log) -> Measured:
    """Raises UserError without clouds and without KISS-ICP."""
    from xitl_cli.run.world.scenery import scenery_of

    profile = profile_of(log)
    boom = None if profile is None else scenery_of(profile).boom
    rebuilt = rebuild(log, profile)
    true, said = truth(log), online(log)
    offline = perception_sections(true, rebuilt.trajectory, rebuilt.points_odom_m[rebuilt.source == LIDAR], boom)
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
        whole = np.concatenate(list(points.values()))
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
