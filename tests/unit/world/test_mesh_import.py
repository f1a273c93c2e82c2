"""Meshes that trimesh wrote, read again; and files that hold no mesh."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from sim_core.world.geometry import ROCK, WorldError, import_mesh
from sim_core.world.spec import MeshFileSpec
from tests.golden import Golden


def wedge() -> trimesh.Trimesh:
    """2 m to the east, 4 m to the north, 1 m high, no symmetry: a box with a corner pulled out to the north-east."""
    mesh = trimesh.creation.box((2.0, 4.0, 1.0))
    mesh.apply_translation((1.0, 2.0, 0.5))
    mesh.vertices[np.argmax(mesh.vertices.sum(axis=1))] += (0.5, 1.0, 2.0)
    return mesh


@pytest.mark.parametrize("kind", ["stl", "obj", "ply", "glb", "gltf", "dae"])
def test_every_format_gives_the_same_solid(kind: str, tmp_path: Path) -> None:
    path = tmp_path / f"wedge.{kind}"
    if kind == "gltf":
        for name, data in trimesh.exchange.gltf.export_gltf(trimesh.Scene(wedge())).items():
            (tmp_path / name.replace("model.gltf", "wedge.gltf")).write_bytes(data)
    else:
        wedge().export(path)
    mesh, warning = import_mesh(MeshFileSpec(str(path), (100.0, 200.0, -1.0), material="rock"))
    assert warning is None
    assert mesh.material is ROCK
    read = trimesh.Trimesh(mesh.vertices_m, mesh.faces)
    assert read.volume == pytest.approx(wedge().volume)
    # x east, y north, z up; formats carry single precision.
    low, high = wedge().bounds
    np.testing.assert_allclose(mesh.vertices_m.min(axis=0), [100 + low[1], 200 + low[0], -1 - high[2]], atol=1e-5)
    np.testing.assert_allclose(mesh.vertices_m.max(axis=0), [100 + high[1], 200 + high[0], -1 - low[2]], atol=1e-5)


def test_a_heading_turns_clockwise_and_the_scale_is_metres_to_the_unit(tmp_path: Path) -> None:
    path = tmp_path / "pole.stl"
    trimesh.creation.box((10.0, 40.0, 10.0)).apply_translation((0.0, 20.0, 0.0)).export(path)
    mesh, _ = import_mesh(MeshFileSpec(str(path), heading_deg=90.0, scale=0.1))
    np.testing.assert_allclose(mesh.vertices_m.min(axis=0), [-0.5, 0.0, -0.5], atol=1e-6)
    np.testing.assert_allclose(mesh.vertices_m.max(axis=0), [0.5, 4.0, 0.5], atol=1e-6)
    assert trimesh.Trimesh(mesh.vertices_m, mesh.faces).volume == pytest.approx(4.0)


def test_y_up_is_turned_upright(tmp_path: Path) -> None:
    path = tmp_path / "mast.glb"
    trimesh.creation.box((1.0, 8.0, 2.0)).apply_translation((0.0, 4.0, -3.0)).export(path)
    mesh, _ = import_mesh(MeshFileSpec(str(path), up="y"))
    # 8 m high; what was 3 m along -z is 3 m to the north.
    np.testing.assert_allclose(mesh.vertices_m.min(axis=0), [2.0, -0.5, -8.0], atol=1e-6)
    np.testing.assert_allclose(mesh.vertices_m.max(axis=0), [4.0, 0.5, 0.0], atol=1e-6)


def test_what_looks_like_millimetres_is_warned_of(tmp_path: Path, golden: Golden) -> None:
    path = tmp_path / "gate.stl"
    trimesh.creation.box((12_000.0, 500.0, 8_000.0)).export(path)
    mesh, warning = import_mesh(MeshFileSpec(str(path)))
    golden("warning", warning, "12000 m", "0.001", path=path)
    assert np.ptp(mesh.vertices_m[:, 1]) == pytest.approx(12_000.0)
    assert import_mesh(MeshFileSpec(str(path), scale=0.001))[1] is None


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("empty.stl", b"solid empty\nendsolid empty\n", "has no triangles|cannot be read as stl"),
        ("empty.obj", b"# nothing\n", "has no triangles|cannot be read as obj"),
        ("points.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "has no triangles|cannot be read as obj"),
        ("none.ply", b"", "cannot be read as ply"),
        ("noise.glb", bytes(range(256)), "cannot be read as glb"),
        ("noise.dae", b"<COLLADA>", "cannot be read as dae"),
        ("short.stl", b"\0" * 80 + b"\xff\xff\0\0" + b"\1" * 500, "cannot be read as stl|has no triangles"),
        ("nan.obj", b"v 0 0 0\nv nan 0 0\nv 0 1 0\nf 1 2 3\n", "has vertices that are not numbers"),
        ("wild.obj", b"v 0 0 0\nv 1 0 0\nf 1 2 900\n", "cannot be read as obj|has no triangles"),
        ("model.step", b"", "is not of a known format; use one of stl, dae"),
    ],
)
def test_a_file_without_a_mesh_is_refused_in_a_sentence(
    name: str, content: bytes, sentence: str, tmp_path: Path
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(WorldError, match=sentence) as raised:
        import_mesh(MeshFileSpec(str(tmp_path / name)))
    assert str(raised.value).startswith(str(tmp_path / name))
    assert "\n" not in str(raised.value)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(WorldError, match=r"dam\.stl does not exist; give the path of a mesh"):
        import_mesh(MeshFileSpec(str(tmp_path / "dam.stl")))


def test_a_file_cut_off_anywhere_raises_nothing_else(tmp_path: Path) -> None:
    for kind in ("glb", "stl", "ply", "dae"):
        whole, path = tmp_path / f"whole.{kind}", tmp_path / f"cut.{kind}"
        wedge().export(whole)
        content = whole.read_bytes()
        for share in np.linspace(0.0, 0.99, 25):
            path.write_bytes(content[: int(share * len(content))])
            try:
                mesh, _ = import_mesh(MeshFileSpec(str(path)))
            except WorldError:
                continue
            assert np.isfinite(mesh.vertices_m).all()
