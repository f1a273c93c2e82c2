"""Entry points of the plug-in `ros`, for `pyproject.toml`. Functions import lazily, so that loading is cheap."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from agent.board.doctor import DoctorFinding
    from xitl_cli.logs.export.exporting import BagFormat, ExportResult, ExportSelection
    from xitl_cli.logs.model.log import Log
    from xitl_cli.profile.schema import RunProfile
    from xitl_cli.run.core.live_output import LiveOutput


def live_ros(profiles: Sequence[RunProfile]) -> LiveOutput:
    """Return a run as a ROS node, for `ros.enabled`."""
    from xitl_cli.plugins.ros.live_ros import RosOutput

    return RosOutput(profiles)


def export_bag(
    log: Log,
    wanted: ExportSelection,
    names: Sequence[str],
    bag_format: BagFormat,
    out: Path | None,
    overwrite: bool,
) -> ExportResult:
    """Write a log as a ROS bag: see `bag_export.export_bag`."""
    from xitl_cli.plugins.ros.bag_export import export_bag as write

    return write(log, wanted, names, bag_format, out, overwrite)


def doctor_checks() -> Iterable[DoctorFinding]:
    """Check how `--ros` would connect to ROS 2 on this machine."""
    from xitl_cli.plugins.ros.middleware_choice import check_ros

    return [check_ros()]
