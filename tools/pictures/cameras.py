"""Images of the camera of `sitl-camera` in several kinds of light and air, with boxes of truth and detector."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
from mcap.reader import make_reader

from tools.pictures.workplace import Workplace
from xitl_cli.logs import open_log

WIDTH_PX, HEIGHT_PX = 480, 300
SHOWN = 56
"""Number of the image."""
LABELS = ["boom", "buoy", "debris", "vessel"]
BUOYS = """
extends: sitl-camera
mission:
  start: {north_m: 19.8, east_m: 23.6, heading_deg: 36.87}
  waypoints_ned_m: [[263.8, 206.6]]
sensors:
  cameras:
    - {name: front, position_frd_m: [1, 0, -0.9], pitch_deg: -6, lens: {view_deg: 60}, rate_hz: 1, detector: colour}
world:
  debris:
    encounters: {count: 0}
    launches:
      - {kind: plank, pos_ned_m: [34.0, 31.0], heading_deg: 60}
      - {kind: plastic, pos_ned_m: [38.0, 35.5]}
      - {kind: trunk, pos_ned_m: [43.0, 36.0], heading_deg: 120}
"""
CONDITIONS = (
    ("day, with boxes of truth and detector", ""),
    ("glare", "environment.light.sun_elevation_deg=12 environment.light.sun_azimuth_deg=80"),
    ("overcast, rain of 30 mm/h", "environment.light.clouds=1 environment.rain_mmph=30"),
    ("fog, visibility 60 m", "environment.visibility_m=60"),
    ("dusk", "environment.light.sun_elevation_deg=-3 environment.light.sun_azimuth_deg=70"),
    ("segmentation", "sensors.cameras.0.kind=segmentation sensors.cameras.0.detector=null"),
)


def draw(workplace: Workplace, path: Path) -> None:
    """Six images of one instant."""
    tiles = []
    for number, (title, changes) in enumerate(CONDITIONS):
        run = f"runs/camera-{number}"
        sizes = f"sensors.cameras.0.width_px={WIDTH_PX} sensors.cameras.0.height_px={HEIGHT_PX}"
        sets = " ".join(f"--set {change}" for change in f"{sizes} {changes}".split())
        workplace.typed(f"xitl sim sitl-camera --duration 12 {sets} --out {run}")
        image = _image(workplace.folder / run, SHOWN, boxes=number == 0)
        cv2.rectangle(image, (0, HEIGHT_PX - 20), (12 + 8 * len(title), HEIGHT_PX), (35, 30, 25), -1)
        cv2.putText(image, title, (6, HEIGHT_PX - 6), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (255, 255, 255), 1, cv2.LINE_AA)
        tiles.append(image)
    rows = [np.concatenate(tiles[first : first + 3], axis=1) for first in (0, 3)]
    cv2.imwrite(str(path), np.concatenate(rows), [cv2.IMWRITE_JPEG_QUALITY, 88])


def draw_buoys(workplace: Workplace, path: Path) -> None:
    """Buoys, debris and a boat with the boxes of truth and detector, at two instants."""
    workplace.file("buoys.yaml", BUOYS)
    workplace.typed("xitl sim buoys.yaml --duration 12 --out runs/buoys")
    images = [_image(workplace.folder / "runs/buoys", number, boxes=True) for number in (4, 12)]
    cv2.imwrite(str(path), np.concatenate(images, axis=1), [cv2.IMWRITE_JPEG_QUALITY, 82])


def _image(run: Path, shown_number: int, boxes: bool) -> np.ndarray:
    with (run / "run.mcap").open("rb") as file:
        messages = list(make_reader(file).iter_messages(topics=["/cameras/front/image"]))
    data = messages[shown_number - 1][2].data
    begin = max(data.find(mark) for mark in (b"\xff\xd8\xff", b"\x89PNG"))
    image: np.ndarray = cv2.imdecode(np.frombuffer(data[begin:], np.uint8), cv2.IMREAD_COLOR)
    if boxes:
        with open_log(run / "run.mcap", "") as log:
            for topic, colour in (("/cameras/truth", (255, 255, 255)), ("/cameras/detections", (60, 230, 250))):
                table = log.tables[topic]
                shown = (table.values("image") == shown_number) & np.isin(table.values("label"), LABELS)
                edges = np.column_stack([table.values(f"{side}_px") for side in ("left", "top", "right", "bottom")])
                for left, top, right, bottom in edges[shown].round().astype(int).tolist():
                    cv2.rectangle(image, (left, top), (right, bottom), colour, 1)
    return image
