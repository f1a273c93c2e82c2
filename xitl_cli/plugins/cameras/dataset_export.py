"""Export of a recording as a training set for object detection: COCO JSON, or text files of YOLO.

Sources: cocodataset.org, "Data format"; docs.ultralytics.com, "Object Detection Datasets". Both measure boxes from the
upper left corner of the image. In a recording, the centre of the first pixel is at 0, 0, half a pixel from the corner.
"""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import field
from io import BytesIO
from pathlib import Path
from typing import Any

from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError
from xitl_cli.logs.export.exporting import ExportResult, ExportSelection
from xitl_cli.logs.export.files import make_directory
from xitl_cli.logs.model.log import Log
from xitl_cli.logs.model.text import plural
from xitl_cli.plugins.cameras.images import FRAMES, TRUTH, ObjectClass
from xitl_cli.record.foxglove_types import foxglove_type

IMAGES, ANNOTATIONS, DATA_FILE = "images", "annotations.json", "data.yaml"
VALIDATED_SHARE = 0.2
"""Share of the images of a camera, the last ones, that YOLO validates with. Neighbouring images are too similar for a
random share."""
LEFT_OUT = (ObjectClass.GROUND, ObjectClass.OWN_VESSEL)
"""Their boxes are no objects to detect: the ground fills much of an image, and the own vessel is always in it."""
_TOPIC = re.compile(r"(?P<vessel>/[^/]+)?/cameras/(?P<camera>[a-z][a-z0-9_]*)/image")


@dataclass(frozen=True, slots=True)
class BoxedObject:
    """An object in an image."""

    kind: ObjectClass
    name: str
    corner_px: tuple[float, float]
    """Upper left corner of its box, from the upper left corner of the image."""
    size_px: tuple[float, float]
    """Width and height of its box."""
    pixels: int


@dataclass(frozen=True, slots=True)
class BoxedImage:
    """A recorded image and its visible objects."""

    camera: str
    """Name in files: `front`, or `alpha_front` of a vessel in a fleet."""
    number: int
    stamp_ns: int
    data: bytes
    suffix: str
    size_px: tuple[int, int]
    """Width and height."""
    objects: Sequence[BoxedObject]
    last: bool
    """Whether it belongs to the last `VALIDATED_SHARE` of its camera."""

    @property
    def file_name(self) -> str:
        return f"{self.camera}_{self.number:06d}.{self.suffix}"


@dataclass(slots=True)
class CameraTopic:
    """The recorded images of one camera."""

    topic: str
    vessel: str
    """Prefix of its topics, empty for a single vessel."""
    camera: str
    frames: dict[int, int] = field(default_factory=dict)
    """Number by stamp of the wanted images."""
    objects: dict[int, list[BoxedObject]] = field(default_factory=dict)
    """By number of the image."""

    @property
    def name(self) -> str:
        return f"{self.vessel.strip('/')}_{self.camera}".strip("_")


def export_dataset(
    log: Log, wanted: ExportSelection, names: Sequence[str], file_format: str, out: Path | None, overwrite: bool
) -> ExportResult:
    """Write the images of a recording with the boxes of visible objects. names: cameras or their topics; empty for all.

    Raises UserError for a recording without images or ground truth, and for an existing or unwritable place.
    """
    cameras = _cameras(log, wanted, names)
    directory = out or Path(f"{log.path.stem}-{file_format}")
    write = {"coco": _write_coco, "yolo": _write_yolo}[file_format]
    with _directory_in_place(directory, overwrite) as part:
        images, boxes = write(part, _images(log, cameras))
        if not images:
            raise UserError(f"{log.path}: has no images of {', '.join(names) or 'cameras'} in this time")
    file = directory / (ANNOTATIONS if file_format == "coco" else DATA_FILE)
    sentence = f"{file}: {plural(images, 'image')} of {plural(len(cameras), 'camera')} with {plural(boxes, 'object')}"
    return ExportResult((str(file),), images, sentence)


def _cameras(log: Log, wanted: ExportSelection, names: Sequence[str]) -> list[CameraTopic]:
    topics = [found for name in log.tables if (found := _TOPIC.fullmatch(name)) is not None]
    if not topics:
        raise UserError(f"{log.path}: no camera is recorded; add sensors.cameras to the profile and run it again")
    chosen = {name.strip("/") for name in names}
    cameras = []
    for topic in topics:
        vessel, camera = topic["vessel"] or "", topic["camera"]
        if chosen and not chosen & {camera, topic[0].strip("/"), f"{vessel}/{camera}".strip("/")}:
            continue
        cameras.append(CameraTopic(topic[0], vessel, camera))
    if not cameras:
        known = ", ".join(topic["camera"] for topic in topics)
        raise UserError(f"{log.path}: no camera of the recording is named {', '.join(names)}; choose from {known}")
    for camera in cameras:
        _read_frames(log, wanted, camera)
        _read_objects(log, camera)
    if not any(camera.objects for camera in cameras):
        raise UserError(
            f"{log.path}: no object is marked in an image of {', '.join(camera.name for camera in cameras)}; set "
            "sensors.cameras.N.truth: true, and let the camera see vessels, buoys or debris"
        )
    return cameras


def _read_frames(log: Log, wanted: ExportSelection, camera: CameraTopic) -> None:
    table = log.tables.get(f"{camera.vessel}{FRAMES.name}")
    if table is None:
        return
    own = (table["camera"] == camera.camera).tolist()
    for is_own, stamp_ns, number in zip(own, table.stamp_ns.tolist(), table["image"].tolist(), strict=True):
        after = wanted.from_ns is None or stamp_ns >= wanted.from_ns
        if is_own and after and (wanted.until_ns is None or stamp_ns <= wanted.until_ns):
            camera.frames[stamp_ns] = int(number)


def _read_objects(log: Log, camera: CameraTopic) -> None:
    table = log.tables.get(f"{camera.vessel}{TRUTH.name}")
    if table is None:
        return
    kinds = {kind.label: kind for kind in ObjectClass}
    columns = ("camera", "image", "label", "object", "left_px", "top_px", "right_px", "bottom_px", "pixels")
    for name, number, label, of, left, top, right, bottom, pixels in zip(
        *(table[column].tolist() for column in columns), strict=True
    ):
        if name == camera.camera and kinds.get(label) not in LEFT_OUT:
            corner_px, size_px = (left + 0.5, top + 0.5), (right - left, bottom - top)
            boxed = BoxedObject(kinds.get(label, ObjectClass.OTHER), of, corner_px, size_px, int(pixels))
            camera.objects.setdefault(int(number), []).append(boxed)


def _images(log: Log, cameras: Sequence[CameraTopic]) -> Iterator[BoxedImage]:
    """Yield the images of each camera in the order of time. Images without a file, such as depth, are omitted."""
    from PIL import Image

    for camera in cameras:
        trained = len(camera.frames) - int(VALIDATED_SHARE * len(camera.frames))
        written = 0
        if "format" not in log.tables[camera.topic]:  # a RawImage
            continue
        for payload in log.payloads(camera.topic):
            message = foxglove_type("CompressedImage").FromString(payload)
            stamp_ns = message.timestamp.seconds * 1_000_000_000 + message.timestamp.nanos
            number = camera.frames.get(stamp_ns)
            if number is None:
                continue
            with Image.open(BytesIO(message.data)) as picture:
                size_px = picture.size
            suffix = {"jpeg": "jpg"}.get(message.format, message.format)
            objects = camera.objects.get(number, ())
            yield BoxedImage(
                camera.name, number, stamp_ns, message.data, suffix, size_px, objects, last=written >= trained
            )
            written += 1


def _write_coco(directory: Path, images: Iterator[BoxedImage]) -> tuple[int, int]:
    """Write COCO's detection format. Return the number of images and of objects."""
    (directory / IMAGES).mkdir()
    described: list[Mapping[str, Any]] = []
    annotations: list[Mapping[str, Any]] = []
    for number, image in enumerate(images, start=1):
        (directory / IMAGES / image.file_name).write_bytes(image.data)
        described.append(
            {
                "id": number,
                "file_name": image.file_name,
                "width": image.size_px[0],
                "height": image.size_px[1],
                "camera": image.camera,
                "time_s": image.stamp_ns / 1e9,
            }
        )
        for boxed in image.objects:
            annotations.append(
                {
                    "id": len(annotations) + 1,
                    "image_id": number,
                    "category_id": int(boxed.kind),
                    "bbox": [*boxed.corner_px, *boxed.size_px],
                    "area": boxed.pixels,
                    "iscrowd": 0,
                    "object": boxed.name,
                }
            )
    categories = [{"id": int(kind), "name": kind.label, "supercategory": "scene"} for kind in ObjectClass if kind]
    document = {
        "info": {"description": "Simulated images with exact boxes, exported by xitl", "version": "1.0"},
        "licenses": [],
        "images": described,
        "annotations": annotations,
        "categories": categories,
    }
    (directory / ANNOTATIONS).write_text(json.dumps(document, indent=1), encoding="utf-8")
    return len(described), len(annotations)


def _write_yolo(directory: Path, images: Iterator[BoxedImage]) -> tuple[int, int]:
    """Write the detection format of Ultralytics YOLO. Return the number of images and of objects."""
    for kind in (IMAGES, "labels"):
        for split in ("train", "val"):
            (directory / kind / split).mkdir(parents=True)
    written = boxes = 0
    for image in images:
        split = "val" if image.last else "train"
        (directory / IMAGES / split / image.file_name).write_bytes(image.data)
        width_px, height_px = image.size_px
        lines = []
        for boxed in image.objects:
            (left, top), (width, height) = boxed.corner_px, boxed.size_px
            centre = (left + 0.5 * width) / width_px, (top + 0.5 * height) / height_px
            shares = (*centre, width / width_px, height / height_px)
            lines.append(f"{int(boxed.kind)} {' '.join(f'{share:.6f}' for share in shares)}\n")
        label = directory / "labels" / split / image.file_name
        label.with_suffix(".txt").write_text("".join(lines), encoding="utf-8")
        written, boxes = written + 1, boxes + len(lines)
    names = "".join(f"  {int(kind)}: {kind.label}\n" for kind in ObjectClass)
    text = f"train: images/train\nval: images/val\nnames:\n{names}"
    (directory / DATA_FILE).write_text(text, encoding="utf-8")
    return written, boxes


@contextmanager
def _directory_in_place(final: Path, overwrite: bool) -> Iterator[Path]:
    """Yield a temporary directory next to `final`, which it replaces at the end. An error removes it.

    Raises UserError for an existing or unwritable place. Only an earlier training set is replaced.
    """
    if final.exists():
        if not overwrite:
            raise UserError(f"{final}: already exists; choose another path with --out, or add --overwrite")
        is_dataset = (final / ANNOTATIONS).is_file() or (final / DATA_FILE).is_file()
        if not is_dataset and (not final.is_dir() or any(final.iterdir())):
            raise UserError(f"{final}: is no training set, so it is not replaced; choose another path with --out")
    make_directory(final.parent)
    part = final.with_name(f".{final.name}.part")
    try:
        shutil.rmtree(part, ignore_errors=True)
        part.mkdir()
        yield part
        if final.exists():
            shutil.rmtree(final)
        part.rename(final)
    except OSError as error:
        raise UserError(
            f"{final}: cannot be written ({error.strerror or error}); free space or choose another path with --out"
        ) from error
    finally:
        shutil.rmtree(part, ignore_errors=True)
