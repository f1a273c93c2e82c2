"""A network in the format ONNX that marks the pixels of two colours, so that its result is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import onnx

SIDE, BOX = 32, 9
"""Size of the input in pixels, and of each box of the output."""


def write_network(file: Path, shape: tuple[int, ...] = (1, 3, SIDE, SIDE), transposed: bool = False) -> str:
    """Write a network with the classes red and green: a box about each pixel, with the mean of the colour in it."""
    helper, of, float_ = onnx.helper, onnx.numpy_helper.from_array, onnx.TensorProto.FLOAT
    row, column = np.divmod(np.arange(SIDE * SIDE), SIDE)
    size = np.full(SIDE * SIDE, BOX)
    boxes = np.stack([column + 0.5, row + 0.5, size, size]).astype(np.float32)[None]
    weights = 3.0 * np.array([[1.0, -1.0, -1.0], [-1.0, 1.0, -1.0]], np.float32).reshape(2, 3, 1, 1)
    nodes = [
        helper.make_node("Conv", ["images", "weights"], ["colour"]),
        helper.make_node("Clip", ["colour", "zero", "one"], ["clipped"]),
        helper.make_node("AveragePool", ["clipped"], ["mean"], kernel_shape=[BOX, BOX], pads=[BOX // 2] * 4),
        helper.make_node("Reshape", ["mean", "flat"], ["scores"]),
        helper.make_node("Concat", ["boxes", "scores"], ["joined"], axis=1),
        helper.make_node("Transpose", ["joined"], ["output0"], perm=[0, 2, 1] if transposed else [0, 1, 2]),
    ]
    graph = helper.make_graph(
        nodes,
        "colours",
        [helper.make_tensor_value_info("images", float_, shape)],
        [helper.make_tensor_value_info("output0", float_, ("batch", "rows", "columns"))],
        [
            of(weights.astype(np.float32), "weights"),
            of(np.float32(0.0), "zero"),
            of(np.float32(1.0), "one"),
            of(np.array([1, 2, SIDE * SIDE]), "flat"),
            of(boxes, "boxes"),
        ],
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=9)
    onnx.checker.check_model(model)
    onnx.save(model, str(file))
    return str(file)
