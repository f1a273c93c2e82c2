"""The check of a profile opens the maps, meshes and networks that the profile names."""

from __future__ import annotations

import json
import sqlite3
from pathlib import Path

import pytest

from tests.colour_network import write_network
from xitl_cli.profile import ProfileError, load_profile

pytestmark = pytest.mark.medium

MAP = "extends: {base}\nview:\n  map: {file}\n"
MESH = "extends: sitl\nworld:\n  meshes: [{{file: {file}}}]\n"
NETWORK = (
    "extends: sitl\nsensors:\n  cameras: [{{detector: {{kind: onnx, model: {file}, classes: [boom, buoy, debris]}}}}]\n"
)


def problem(folder: Path, text: str) -> str:
    profile = folder / "boat.yaml"
    profile.write_text(text)
    with pytest.raises(ProfileError) as raised:
        load_profile(str(profile))
    (found,) = raised.value.problems
    return str(found).replace(f"{folder}/", "")


@pytest.mark.parametrize("base", ["sitl", "fleet-convoy"])
@pytest.mark.parametrize(
    ("file", "content", "said"),
    [
        ("gone.geojson", None, "view.map: gone.geojson does not exist; check the path"),
        ("cut.json", '{"type":\n"Poi', "view.map = cut.json: is damaged at line 2 (Unterminated string starting at)"),
        ("text.json", "north", "view.map = text.json: is no chart; give GeoJSON, MBTiles"),
        ("far.json", json.dumps({"type": "Point", "coordinates": [10.0, 50.0]}), "view.map = far.json: is 6349 km"),
        ("text.mbtiles", "north", "view.map = text.mbtiles: is not an MBTiles file (file is not a database); give one"),
    ],
)
def test_a_map_is_opened(base: str, file: str, content: str | None, said: str, tmp_path: Path) -> None:
    if content is not None:
        (tmp_path / file).write_text(content)
    assert problem(tmp_path, MAP.format(base=base, file=file)).startswith(f"boat.yaml:3: {said}")


def test_a_folder_and_a_base_without_tiles(tmp_path: Path) -> None:
    (tmp_path / "tiles").mkdir()
    assert "boat.yaml:3: view.map = tiles: has no tiles" in problem(tmp_path, MAP.format(base="mitl", file="tiles"))
    with sqlite3.connect(tmp_path / "none.mbtiles") as base:
        base.execute("CREATE TABLE metadata (name, value)")
        base.execute("CREATE TABLE tiles (zoom_level, tile_column, tile_row, tile_data)")
    base.close()
    assert "view.map = none.mbtiles: has no tiles" in problem(tmp_path, MAP.format(base="mitl", file="none.mbtiles"))


def test_a_part_of_a_profile_has_no_place_for_a_map(tmp_path: Path) -> None:
    (tmp_path / "part.yaml").write_text("view: {map: far.json}\n")
    (tmp_path / "far.json").write_text('{"type": "Point", "coordinates": [10.0, 50.0]}')
    assert load_profile(str(tmp_path / "part.yaml")).view.map == str(tmp_path / "far.json")  # type: ignore[union-attr]


def test_a_mesh_of_the_world_is_opened(tmp_path: Path) -> None:
    (tmp_path / "pier.stl").write_text("north")
    said = "boat.yaml:3: world.meshes.0.file: pier.stl has no triangles; export it again"
    assert problem(tmp_path, MESH.format(file="pier.stl")).startswith(said)


def test_a_network_and_its_classes_are_checked(tmp_path: Path) -> None:
    (tmp_path / "boats.onnx").write_text("north")
    key = "boat.yaml:3: sensors.cameras.0.detector.model: boats.onnx"
    assert problem(tmp_path, NETWORK.format(file="boats.onnx")).startswith(f"{key} is no network that")
    write_network(tmp_path / "boats.onnx")
    assert "so 2 classes, and detector.classes has 3" in problem(tmp_path, NETWORK.format(file="boats.onnx"))


def test_a_detector_that_no_package_has(tmp_path: Path) -> None:
    text = "extends: sitl\nsensors:\n  cameras:\n    - {detector: colours}\n"
    said = "boat.yaml:4: sensors.cameras.0.detector: colours: no installed package registers it in xitl.detectors"
    assert problem(tmp_path, text).startswith(said)
