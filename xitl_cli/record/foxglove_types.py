"""Readers of foxglove's messages, because its own classes only write them."""

from __future__ import annotations

from functools import cache
from typing import Any


@cache
def foxglove_type(name: str) -> Any:
    """Return the class that reads an encoded foxglove message: `foxglove_type("PointCloud").FromString(payload)`."""
    from foxglove import messages
    from google.protobuf import (  # type: ignore[import-untyped]
        descriptor_pb2,
        descriptor_pool,
        message_factory,
    )

    schema = getattr(messages, name).get_schema()
    left = {file.name: file for file in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file}
    pool = descriptor_pool.DescriptorPool()
    while left:
        for file in [file for file in left.values() if not any(needed in left for needed in file.dependency)]:
            pool.Add(left.pop(file.name))
    return message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
