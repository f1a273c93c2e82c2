"""Training sets from recordings, by the documented fields of COCO and YOLO."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from PIL import Image
from recorded_images import record
from synthetic_images import make_image

from sim_core.sensors.camera_spec import CameraSpec
from xitl_cli.errors import UserError
from xitl_cli.logs import open_log
from xitl_cli.logs.export.exporting import ExportResult, ExportSelection
from xitl_cli.plugins.cameras.dataset_export import export_dataset
from xitl_cli.plugins.cameras.images import CameraImage, ObjectClass

FRONT = CameraSpec(width_px=96, height_px=64)
CLASSES = CameraSpec(name="classes", kind="segmentation", width_px=96, height_px=64)
DEPTH = CameraSpec(name="depth", kind="depth", width_px=96, height_px=64)
IMAGES = [make_image(spec, number) for number in range(1, 11) for spec in (FRONT, CLASSES, DEPTH)]


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    return record(tmp_path / "run.mcap", IMAGES)


def export(
    path: Path,
    out: Path,
    kind: str = "coco",
    names: tuple[str, ...] = (),
    between_ns: tuple[int | None, int | None] = (None, None),
    overwrite: bool = False,
) -> ExportResult:
    with open_log(path) as log:
        return export_dataset(log, ExportSelection((), *between_ns), names, kind, out, overwrite)


def test_coco_has_each_image_and_the_pixels_of_each_box(recording: Path, tmp_path: Path) -> None:
    done = export(recording, tmp_path / "set")
    document = json.loads((tmp_path / "set/annotations.json").read_text(encoding="utf-8"))
    assert done.files == (str(tmp_path / "set/annotations.json"),)
    assert done.rows == len(document["images"]) == 20, "a depth image has no file"
    assert {category["id"]: category["name"] for category in document["categories"]} == {
        int(kind): kind.label for kind in ObjectClass if kind is not ObjectClass.SKY
    }
    by_name = {image["file_name"]: image for image in document["images"]}
    own = by_name["classes_000003.png"]
    assert (own["width"], own["height"], own["time_s"]) == (96, 64, 0.3)
    classes = np.asarray(Image.open(tmp_path / "set/images/classes_000003.png"))
    vessel, buoy = (note for note in document["annotations"] if note["image_id"] == own["id"])
    left, top, width, height = map(int, vessel["bbox"])
    box = classes[top : top + height, left : left + width]
    assert (box == vessel["category_id"]).all(), "the box has the vessel alone"
    assert vessel["area"] == box.size == np.count_nonzero(classes == ObjectClass.VESSEL)
    assert (buoy["category_id"], buoy["bbox"], buoy["object"]) == (int(ObjectClass.BUOY), [60, 30, 4, 6], "body 3")
    assert len({note["id"] for note in document["annotations"]}) == 40
    assert (tmp_path / "set/images/front_000003.jpg").read_bytes() == make_image(FRONT, 3).encoded


def test_yolo_has_shares_of_the_image_and_validates_with_the_last_ones(recording: Path, tmp_path: Path) -> None:
    export(recording, tmp_path / "set", "yolo", ("front",))
    data = yaml.safe_load((tmp_path / "set/data.yaml").read_text(encoding="utf-8"))
    assert data["names"] == {int(kind): kind.label for kind in ObjectClass}
    assert sorted(path.stem for path in (tmp_path / "set" / data["val"]).iterdir()) == ["front_000009", "front_000010"]
    images = sorted((tmp_path / "set" / data["train"]).iterdir())
    assert len(images) == 8
    for image in images:
        text = (tmp_path / "set/labels/train" / image.name).with_suffix(".txt").read_text(encoding="utf-8")
        vessel, buoy = (list(map(float, line.split())) for line in text.splitlines())
        assert vessel == pytest.approx([8, 30 / 96, 30 / 64, 40 / 96, 20 / 64], abs=1e-6)
        assert buoy == pytest.approx([10, 62 / 96, 33 / 64, 4 / 96, 6 / 64], abs=1e-6)


def test_cameras_and_times_are_chosen(recording: Path, tmp_path: Path) -> None:
    export(recording, tmp_path / "set", "coco", ("/cameras/front/image",), (300_000_000, 500_000_000))
    names = sorted(path.name for path in (tmp_path / "set/images").iterdir())
    assert names == ["front_000003.jpg", "front_000004.jpg", "front_000005.jpg"]


def test_vessels_of_a_fleet_have_separate_files(tmp_path: Path) -> None:
    path = record(tmp_path / "run.mcap", [make_image(FRONT, 1)], vessel="alpha")
    export(path, tmp_path / "set")
    assert [path.name for path in (tmp_path / "set/images").iterdir()] == ["alpha_front_000001.jpg"]


def test_an_earlier_set_is_replaced_as_a_whole_and_nothing_else_is(recording: Path, tmp_path: Path) -> None:
    out = tmp_path / "set"
    export(recording, out)
    with pytest.raises(UserError, match="already exists; choose another path with --out, or add --overwrite"):
        export(recording, out)
    export(recording, out, "yolo", overwrite=True)
    assert not (out / "annotations.json").exists()
    other = tmp_path / "other"
    other.mkdir()
    (other / "thesis.tex").touch()
    with pytest.raises(UserError, match="is no training set, so it is not replaced"):
        export(recording, other, overwrite=True)
    assert (other / "thesis.tex").exists()
    assert not list(tmp_path.glob(".*")), "no temporary directory remains"


@pytest.mark.parametrize(
    ("images", "truth", "names", "between_ns", "sentence"),
    [
        ([], True, (), (None, None), r"no camera is recorded; add sensors\.cameras to the profile"),
        (
            IMAGES,
            False,
            (),
            (None, None),
            r"no object is marked in an image of .*; set sensors\.cameras\.N\.truth: true",
        ),
        (
            IMAGES,
            True,
            ("rear",),
            (None, None),
            r"no camera of the recording is named rear; choose from classes, depth, front",
        ),
        (IMAGES, True, (), (10**12, None), r"has no images of cameras in this time"),
        (IMAGES, True, ("depth",), (None, None), r"has no images of depth in this time"),
    ],
)
def test_what_is_missing_is_one_sentence(
    tmp_path: Path,
    images: list[CameraImage],
    truth: bool,
    names: tuple[str, ...],
    between_ns: tuple[int | None, int | None],
    sentence: str,
) -> None:
    path = record(tmp_path / "run.mcap", images, truth=truth)
    with pytest.raises(UserError, match=sentence):
        export(path, tmp_path / "set", names=names, between_ns=between_ns)
    assert not (tmp_path / "set").exists()
