"""Entry point of the plug-in `cameras`, for `pyproject.toml`."""

from __future__ import annotations

from collections.abc import Sequence

from sim_core.sensors.camera_spec import CameraSpec
from xitl_cli.plugin import NodeContext, NodeKind
from xitl_cli.plugins.cameras.images import DETECTIONS, FRAMES, TRUTH
from xitl_cli.run.core.node import RunNode


def _make(keys: Sequence[CameraSpec], context: NodeContext) -> RunNode:
    from xitl_cli.plugins.cameras.node import CameraNode

    return CameraNode(keys, context)


KIND = NodeKind(CameraSpec, _make, (FRAMES, TRUTH, DETECTIONS))
