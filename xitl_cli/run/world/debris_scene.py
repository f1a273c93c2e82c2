"""Bodies adrift drawn for Foxglove and Lichtblick: each one's mesh, once, in a frame of its own that moves with it."""

from __future__ import annotations

from collections.abc import Sequence

from foxglove import messages

from sim_core import frames
from sim_core.world.debris import Body, BodyKind
from xitl_cli.record.topics import body_frame

_COLORS = {
    BodyKind.TRUNK: messages.Color(r=0.4, g=0.26, b=0.13, a=1.0),
    BodyKind.BRANCH: messages.Color(r=0.5, g=0.36, b=0.2, a=1.0),
    BodyKind.PLANTS: messages.Color(r=0.25, g=0.6, b=0.2, a=1.0),
    BodyKind.ANIMAL: messages.Color(r=0.55, g=0.42, b=0.35, a=1.0),
}


def debris_scene(bodies: Sequence[Body], first: int) -> messages.SceneUpdate:
    """Bodies by number from `first` on."""
    entities = []
    for number, body in enumerate(bodies[first:], start=first):
        corners = frames.frd_to_flu(body.mesh.vertices_m[body.mesh.faces].reshape(-1, 3)).tolist()
        triangles = messages.TriangleListPrimitive(
            pose=messages.Pose(
                position=messages.Vector3(x=0.0, y=0.0, z=0.0),
                orientation=messages.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0),
            ),
            points=[messages.Point3(x=x, y=y, z=z) for x, y, z in corners],
            color=_COLORS[body.kind],
        )
        frame = body_frame(number)
        entities.append(messages.SceneEntity(frame_id=frame, id=frame, frame_locked=True, triangles=[triangles]))
    return messages.SceneUpdate(entities=entities)
