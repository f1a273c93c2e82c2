"""Pictures of recordings for papers and docs: an instant as PNG, a span as GIF or WebP, from a headless browser.

The module uses an installed Chromium, Chrome or Edge. The browser opens a page of this machine and renders one picture
after the other. It fetches nothing from elsewhere.
"""

from __future__ import annotations

import io
import math
import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError
from xitl_cli.plugins.view.camera import FOLLOW, usual_pose
from xitl_cli.plugins.view.model import Array, ViewInstant
from xitl_cli.plugins.view.recording import LogScene, scene_of
from xitl_cli.plugins.view.replay import ReplayDrawing, unseen_server
from xitl_cli.plugins.view.replay_page import View, checked_span

if TYPE_CHECKING:
    import viser
    from PIL import Image

BROWSER_VARIABLE = "XITL_BROWSER"
BROWSERS = (
    *("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "microsoft-edge"),
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
    "/Applications/Chromium.app/Contents/MacOS/Chromium",
)
SOFTWARE = ("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
"""Flags of a browser that draws WebGL without a graphics card."""
_FLAGS = (
    "--headless=new",
    *SOFTWARE,
    "--no-first-run",
    "--no-default-browser-check",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-extensions",
    "--disable-sync",
    "--hide-scrollbars",
    "--remote-debugging-port=0",  # a headless browser without it exits immediately
)
START_S, RENDER_S, LOOK_S = 60.0, 120.0, 20.0
FOV_RAD = math.radians(50.0)
LEAST_PIXELS, MOST_PIXELS = 64, 4096
MOST_FRAMES = 1500
GIF_COLOURS, WEBP_QUALITY = 128, 70


@dataclass(frozen=True, slots=True)
class Camera:
    """A camera position and its look-at point, in the map."""

    position_enu_m: tuple[float, float, float]
    look_at_enu_m: tuple[float, float, float]

    def attitude_wxyz(self) -> Array:
        """Return the rotation (4,) from the camera's axes (right, down, ahead) to the map."""
        from sim_core.frames import matrix_to_quat

        ahead = np.subtract(self.look_at_enu_m, self.position_enu_m)
        ahead = ahead / np.linalg.norm(ahead)
        right = np.cross(ahead, (0.0, 0.0, 1.0))
        if np.linalg.norm(right) < 1e-6:
            right = np.array([1.0, 0.0, 0.0])
        right = right / np.linalg.norm(right)
        attitude: Array = matrix_to_quat(np.column_stack([right, np.cross(ahead, right), ahead]))
        return attitude


def picture(
    recording: LogScene | Sequence[Path],
    at_s: float,
    *,
    size: tuple[int, int] = (1280, 720),
    camera: View | Camera = "behind",
    vessel: str | None = None,
    dark: bool = False,
) -> bytes:
    """Return an instant of the recording as PNG.

    size: width and height in pixels. vessel: vessel that the camera looks at; None for the first.

    Raises UserError without the extra `view`, without a browser, and for an instant outside of the recording. Raises
    UserError for a size or a vessel that is not valid.
    """
    with scene_of(recording) as scene:
        begin_s, end_s = scene.span_s
        if not begin_s <= at_s <= end_s:
            raise UserError(f"no picture at {at_s:g} s: the recording is from {begin_s:.2f} s to {end_s:.2f} s")
        out = io.BytesIO()
        with _photographer(scene, size, camera, vessel, dark) as photograph:
            photograph(at_s).save(out, "PNG", optimize=True)
        return out.getvalue()


def moving_picture(
    recording: LogScene | Sequence[Path],
    from_s: float | None = None,
    to_s: float | None = None,
    *,
    size: tuple[int, int] = (640, 360),
    camera: View | Camera = "behind",
    vessel: str | None = None,
    speed: float = 4.0,
    rate_hz: float = 10.0,
    dark: bool = False,
    kind: Literal["gif", "webp"] = "gif",
) -> bytes:
    """Return a span of the recording as an endlessly repeated picture, the complete recording by default.

    speed: playback speed as a multiple of the recorded speed. rate_hz: frames per second of playback. kind: WebP has
    all colours and needs a third of the bytes of a GIF. The other parameters and errors are those of `picture`. Raises
    UserError also for more than `MOST_FRAMES` frames.
    """
    with scene_of(recording) as scene:
        span = checked_span(scene, from_s, to_s)
        frames = max(round(span.length_s / speed * rate_hz), 1)
        if frames > MOST_FRAMES:
            raise UserError(
                f"{span.length_s:.0f} s at {speed:g} × are {frames} pictures, more than {MOST_FRAMES}; choose a "
                "shorter span (--from, --until) or a higher --speed"
            )
        with _photographer(scene, size, camera, vessel, dark) as photograph:
            pictures = [photograph(span.from_s + span.length_s * number / frames) for number in range(frames)]
    out, duration_ms = io.BytesIO(), round(1000.0 / rate_hz)
    if kind == "webp":
        options = {"quality": WEBP_QUALITY, "method": 4}
    else:
        pictures, options = _with_one_palette(pictures), {"optimize": False}
    first, *rest = pictures
    first.save(out, kind, save_all=True, append_images=rest, duration=duration_ms, loop=0, **options)
    return out.getvalue()


def _with_one_palette(pictures: Sequence[Image.Image]) -> list[Image.Image]:
    """Return the pictures with one palette, made of some of them, so that nothing flickers."""
    from PIL import Image

    some = pictures[:: max(len(pictures) // 8, 1)]
    width, height = pictures[0].size
    sheet = Image.new("RGB", (width, height * len(some)))
    for number, image in enumerate(some):
        sheet.paste(image, (0, number * height))
    palette = palette_of(sheet, GIF_COLOURS)
    return [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in pictures]


def find_browser() -> str:
    """Return the path of a browser that renders without a window. Raises UserError if there is none."""
    named = os.environ.get(BROWSER_VARIABLE)
    if named:
        if path := shutil.which(named):
            return path
        raise UserError(f"{BROWSER_VARIABLE}={named} is not a program; name Chromium or Chrome, or unset it")
    for name in BROWSERS:
        if path := shutil.which(name):
            return path
    raise UserError(
        "a picture needs Chromium, Chrome or Edge, and this machine has none; install chromium, or name one in "
        f"{BROWSER_VARIABLE} (--html needs no browser)"
    )


@contextmanager
def _photographer(
    recording: LogScene, size: tuple[int, int], camera: View | Camera, vessel: str | None, dark: bool
) -> Iterator[Any]:
    """Yield a function that renders an instant, at_s, to an image."""
    width, height = size
    if not all(LEAST_PIXELS <= side <= MOST_PIXELS for side in size):
        raise UserError(f"{width}x{height}: each side of a picture must have {LEAST_PIXELS} to {MOST_PIXELS} pixels")
    if vessel is not None and vessel not in recording.names:
        names = ", ".join(recording.names) or "a single vessel without a name"
        raise UserError(f"the recording has no vessel {vessel!r}; it has {names}")
    browser = find_browser()
    with unseen_server() as server:
        drawing = ReplayDrawing(server, recording, dark=dark)
        drawing.draw(recording.instant(recording.span_s[0]))
        with _browser_at(browser, server, size) as client:
            _await_look(client)

            def photograph(at_s: float) -> Image.Image:
                instant = recording.instant(at_s)
                drawing.draw(instant)
                view = camera if isinstance(camera, Camera) else camera_view(camera, recording, instant, vessel)
                return _render(client, view, size, dark)

            yield photograph


def camera_view(view: View, recording: LogScene, instant: ViewInstant, vessel: str | None = None) -> Camera:
    """Return the camera of a view, with the same geometry as the buttons of a replay page."""
    from sim_core.frames import quat_to_matrix

    name = recording.names[0] if vessel is None else vessel
    if view == "all":
        places = np.concatenate([recording.track(known).pose.position_enu_m[:, :2] for known in recording.names])
        east, north = ((places.min(axis=0) + places.max(axis=0)) / 2.0).tolist()
        extent = max(math.dist(places.min(axis=0), places.max(axis=0)), 20.0)
        return Camera((east, north - 0.5 * extent, 1.0 * extent), (east, north, 0.0))
    here = instant.vessels[name]
    east, north, up = here.position_enu_m.tolist()
    ahead_e, ahead_n = quat_to_matrix(here.attitude_wxyz)[:2, 0].tolist()
    length_m = recording.scene.vessels[name].length_m
    far = max(4.0 * length_m, 4.0)
    if view == "above":
        return Camera((east, north - 0.01, up + 6.0 * far), (east, north, up))
    heading_rad = math.atan2(ahead_n, ahead_e)
    if view == "beside":
        across_e, across_n = far * math.sin(heading_rad), -far * math.cos(heading_rad)
        return Camera((east + across_e, north + across_n, up + 0.25 * far), (east, north, up))
    offset_e, offset_n, offset_up = usual_pose(FOLLOW, length_m).offset_m(heading_rad).tolist()
    return Camera((east + offset_e, north + offset_n, up + offset_up), (east, north, up))


@contextmanager
def _browser_at(browser: str, server: viser.ViserServer, size: tuple[int, int]) -> Iterator[Any]:
    """Yield the viser client of a headless browser after it opened the server's page.

    Raises UserError if the browser ends early or does not open the page within `START_S`.
    """
    with tempfile.TemporaryDirectory(prefix="xitl-view-", ignore_cleanup_errors=True) as home:
        sandbox = ("--no-sandbox",) if hasattr(os, "geteuid") and os.geteuid() == 0 else ()
        url = f"http://127.0.0.1:{server.get_port()}/?look=full"
        window = f"--window-size={size[0]},{size[1] + 100}"
        output = Path(home) / "output"
        with output.open("wb") as file:
            process = subprocess.Popen(
                [browser, *_FLAGS, *sandbox, f"--user-data-dir={home}/profile", window, url],
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=file,
                start_new_session=True,
            )
        try:
            until = time.monotonic() + START_S
            while not server.get_clients():
                if process.poll() is not None or time.monotonic() > until:
                    lines = output.read_text(errors="replace").strip().splitlines()
                    why = f"; its last output: {lines[-1][:200]}" if lines else ""
                    state = "ended" if process.poll() is not None else f"did not open the page within {START_S:.0f} s"
                    raise UserError(f"{browser} {state}{why}; try another one, named in {BROWSER_VARIABLE}")
                time.sleep(0.05)
            yield next(iter(server.get_clients().values()))
        finally:
            _end_session(process)


def _end_session(process: subprocess.Popen[bytes]) -> None:
    """End a process and its child processes, which form a separate session; on Windows, the process alone."""
    if not hasattr(os, "killpg"):
        process.kill()
        process.wait()
        return
    for number in (signal.SIGTERM, signal.SIGKILL):
        with suppress(ProcessLookupError):
            os.killpg(process.pid, number)
        with suppress(subprocess.TimeoutExpired):
            process.wait(5.0)
            break


def _await_look(client: Any) -> None:
    """Wait until look.js has drawn its sky, which has no transparent pixel. Without it, pictures have plain colours."""
    until = time.monotonic() + LOOK_S
    while time.monotonic() < until:
        with suppress(RuntimeError, TimeoutError):
            sky = client.get_render(
                16, 16, wxyz=(0.7, 0.7, 0.0, 0.0), position=(0.0, 0.0, 50.0), fov=FOV_RAD, transport_format="png"
            )
            if sky[0, 0, 3] == 255:
                return


def _render(client: Any, camera: Camera, size: tuple[int, int], dark: bool) -> Image.Image:
    """Return a picture. The browser renders only the objects in front of the sky, so the sky is added behind them."""
    from PIL import Image

    from xitl_cli.plugins.view.look import DAY, NIGHT, sky_rows

    width, height = size
    try:
        pixels = client.get_render(
            height,
            width,
            wxyz=camera.attitude_wxyz(),
            position=np.asarray(camera.position_enu_m),
            fov=FOV_RAD,
            transport_format="png",
            timeout=RENDER_S,
        )
    except (RuntimeError, TimeoutError) as error:
        raise UserError(
            f"the browser returned no picture ({error}); try a smaller --size, or another {BROWSER_VARIABLE}"
        ) from error
    front = Image.fromarray(np.ascontiguousarray(pixels)).convert("RGBA")
    sky = Image.fromarray(sky_rows(NIGHT if dark else DAY)[:, None]).resize(front.size, Image.Resampling.BILINEAR)
    return Image.alpha_composite(sky.convert("RGBA"), front).convert("RGB")


def palette_of(image: Image.Image, colours: int) -> Image.Image:
    """Return a palette with this number of colours for an image, for its method `quantize`.

    Half of the colours are for large areas, which would otherwise show bands. The other half covers all hues, so that a
    thin line or a small mark keeps its colour.
    """
    from PIL import Image

    half = colours // 2
    halves = [image.quantize(half, method) for method in (Image.Quantize.MEDIANCUT, Image.Quantize.FASTOCTREE)]
    palette = Image.new("P", (1, 1))
    palette.putpalette([value for part in halves for value in (part.getpalette() or [])[: 3 * half]])
    return palette
