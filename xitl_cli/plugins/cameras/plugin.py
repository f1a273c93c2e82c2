"""Entry point of the plug-in `cameras`, for `pyproject.toml`."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from agent.board.doctor import OK, DoctorFinding
from sim_core.sensors.camera_spec import CameraSpec
from xitl_cli.errors import UserError
from xitl_cli.extras import CAMERA
from xitl_cli.plugin import NodeContext, NodeKind
from xitl_cli.plugins.cameras.images import DETECTIONS, FRAMES, TRUTH
from xitl_cli.run.core.node import RunNode


def _make(keys: Sequence[CameraSpec], context: NodeContext) -> RunNode:
    from xitl_cli.plugins.cameras.node import CameraNode

    return CameraNode(keys, context)


def doctor_checks() -> Iterable[DoctorFinding]:
    """Check what draws the images of cameras on this machine."""
    if CAMERA.missing:
        return []  # the check of the extras says so
    from xitl_cli.plugins.cameras.renderer import make_context

    try:
        context = make_context()
    except UserError as error:
        text, _, advice = str(error).partition("; ")
        return [DoctorFinding("cameras", OK, f"{text} (only for sensors.cameras)", advice)]
    device = str(context.info["GL_RENDERER"])
    context.release()
    return [DoctorFinding("cameras", OK, f"drawn by {device}")]


KIND = NodeKind(CameraSpec, _make, (FRAMES, TRUTH, DETECTIONS))
