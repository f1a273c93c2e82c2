"""What a companion's findings are worth, for the summary, and as files beside the recording."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from sim_core.world.boom import LogBoom
from xitl_cli.mapping.accuracy import perception_sections
from xitl_cli.mapping.rebuild import points_of, write_map, write_tum
from xitl_cli.record.perception import SOURCES
from xitl_cli.run import directory
from xitl_cli.run.nodes.companion_line import CompanionLine, NoCompanion
from xitl_cli.run.nodes.findings import Findings, NoFindings

NOTHING: dict[str, Any] = {"odometry": None, "mapping": None, "obstacles": None, "companion": None}


def sections(findings: NoFindings, boom: LogBoom | None, companion: NoCompanion | CompanionLine) -> dict[str, Any]:
    """`odometry`, `mapping`, `obstacles` and `companion` of summary.json, null without a companion."""
    if not isinstance(findings, Findings):
        return NOTHING
    points, _ = findings.map_points("lidar")
    accuracy = perception_sections(findings.truth(), findings.odometry(), points.astype(np.float32), boom)
    of_sonar = {"sonar_points": len(findings.map_points("sonar")[0])}
    return {
        "odometry": accuracy.odometry,
        "mapping": {**accuracy.mapping, **of_sonar},
        "obstacles": findings.score.report(),
        "companion": {"gone_s": companion.gone_s, "warnings": list(companion.warnings), **findings.companion()},
    }


def write(findings: NoFindings, folder: Path) -> None:
    """Map and trajectory, where there is one, and the truth with it. Raises UserError when they cannot be written."""
    if not isinstance(findings, Findings):
        return
    odometry = findings.odometry()
    if not len(odometry.stamp_ns):
        return
    parts = [findings.map_points(source) for source in SOURCES]
    packed = points_of(
        np.concatenate([points for points, _ in parts]).astype(np.float32),
        np.concatenate([intensity for _, intensity in parts]),
        np.concatenate([np.full(len(points), number, np.uint8) for number, (points, _) in enumerate(parts)]),
    )
    write_map(folder / directory.MAP, packed, "ply")
    write_tum(folder / directory.TRAJECTORY, odometry)
    write_tum(folder / directory.TRUTH, findings.truth())
