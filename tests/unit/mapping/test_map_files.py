"""Maps and trajectories as other tools read them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import trimesh

from xitl_cli.mapping.map_files import points_of, write_map


def some(count: int = 500) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(2)
    points = rng.uniform(-50, 50, (count, 3)).astype(np.float32)
    intensity = rng.integers(0, 255, count).astype(np.uint8)
    return points, points_of(points, intensity, np.ones(count, np.uint8))


def test_a_ply_reads_back_with_trimesh(tmp_path: Path) -> None:
    points, packed = some()
    write_map(tmp_path / "map.ply", packed, "ply")
    cloud = trimesh.load(tmp_path / "map.ply")
    np.testing.assert_allclose(cloud.vertices, points * [1, -1, -1], rtol=1e-7)
    data = cloud.metadata["_ply_raw"]["vertex"]["data"]
    np.testing.assert_array_equal(data["intensity"].ravel(), packed["intensity"])
    assert (data["source"] == 1).all()


def test_a_pcd_is_what_its_specification_says(tmp_path: Path) -> None:
    points, packed = some()
    write_map(tmp_path / "map.pcd", packed, "pcd")
    head, _, body = (tmp_path / "map.pcd").read_bytes().partition(b"DATA binary\n")
    said = dict(line.split(" ", 1) for line in head.decode("ascii").splitlines())
    assert list(said) == ["VERSION", "FIELDS", "SIZE", "TYPE", "COUNT", "WIDTH", "HEIGHT", "VIEWPOINT", "POINTS"]
    assert int(said["POINTS"]) == int(said["WIDTH"]) * int(said["HEIGHT"]) == len(points)
    kinds = [f"<{kind.lower()}{size}" for kind, size in zip(said["TYPE"].split(), said["SIZE"].split(), strict=True)]
    rows = np.frombuffer(body, dtype=list(zip(said["FIELDS"].split(), kinds, strict=True)))
    assert rows.dtype.itemsize * len(points) == len(body)
    np.testing.assert_array_equal(rows["y"], -points[:, 1])
    np.testing.assert_array_equal(rows["intensity"], packed["intensity"])


def test_an_empty_map_is_a_file_too(tmp_path: Path) -> None:
    none = points_of(np.empty((0, 3), np.float32), np.empty(0, np.uint8), np.empty(0, np.uint8))
    write_map(tmp_path / "map.ply", none, "ply")
    assert b"element vertex 0\n" in (tmp_path / "map.ply").read_bytes()
