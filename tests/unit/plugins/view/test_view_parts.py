"""The process that draws a run, between a pipe and a page that the test plays, and the functions of `import xitl`."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from foxglove import messages

from xitl_cli.plugins.view import pictures, plugin, process, replay_page
from xitl_cli.plugins.view.messages import ViewEnd, ViewRefusal, ViewUpdate
from xitl_cli.plugins.view.model import BodyInstant, VesselInstant, ViewImage, ViewInstant
from xitl_cli.plugins.view.process import ViewProcess
from xitl_cli.profile import load_profile
from xitl_cli.record.recorder import timestamp

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


class Part:
    """Stands in for a part of the page; keeps its updates."""

    def __init__(self) -> None:
        self.updates: list[Any] = []
        self.refusals: list[str] = []

    def update(self, instant: Any, *rest: Any) -> None:
        self.updates.append(instant)

    draw = update

    def refused(self, text: str) -> None:
        self.refusals.append(text)


class Page:
    """A view process without its server. sent: its messages to the run. batches: what the run sends, in turn."""

    def __init__(self, *batches: list[Any]) -> None:
        self.sent: list[dict[str, Any]] = []
        self.browsers: list[int] = [0]
        self.notes: list[tuple[Any, ...]] = []
        self.waits: list[float] = []
        self.flushed = 0
        self._batches = iter(batches)
        self.view = ViewProcess.__new__(ViewProcess)
        client = SimpleNamespace(add_notification=self._note)
        self.server = SimpleNamespace(
            get_clients=lambda: dict.fromkeys(range(self.browsers[0]), client), flush=self._flush
        )
        state: dict[str, Any] = {
            "_pipe": SimpleNamespace(send=self.sent.append, receive=self._receive),
            "_server": self.server,
            "_meshes": {},
            "_passing": {},
            "_browsers": 0,
            "_joined": set(),
            "_reported": (0, 0),
            "_requested": False,
            "_collected_s": 0.0,
        }
        self.parts = {name: Part() for name in ("drawing", "cameras", "instruments", "readouts", "images", "controls")}
        state |= {f"_{name}": part for name, part in self.parts.items()}
        self.view.__dict__.update(state)

    def _note(self, *given: Any, **keys: Any) -> None:
        self.notes.append((*given, keys))

    def _flush(self) -> None:
        self.flushed += 1

    def _receive(self, wait_s: float) -> list[Any]:
        self.waits.append(wait_s)
        batch = next(self._batches)
        joined = [part for part in batch if isinstance(part, int)]
        for count in joined:  # so many browsers from now on
            self.browsers[0] = count
            self.view._joined.update(range(count))
        return [part for part in batch if not isinstance(part, int)]


@pytest.fixture(autouse=True)
def no_farewell(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    slept: list[float] = []
    monkeypatch.setattr(process, "time", SimpleNamespace(monotonic=lambda: 0.0, sleep=slept.append))
    return slept


def instant(**keys: Any) -> ViewInstant:
    return ViewInstant(2.0, {"a": VesselInstant(np.zeros(3), LEVEL)}, **keys)


def test_an_instant_is_asked_for_while_there_is_a_browser_and_after_each_drawing(no_farewell: list[float]) -> None:
    page = Page([], [2], [], [instant()], [0], [1], [ViewEnd("over")])
    page.view.run([])
    assert page.sent == [
        {"browsers": 2, "joined": 2},
        {"ask": True},
        {"ask": True},
        {"browsers": 0, "joined": 2},
        {"browsers": 1, "joined": 2},
        {"ask": True},
    ]
    assert len(page.parts["drawing"].updates) == 1
    assert set(page.waits) == {process.CHECK_S}
    assert page.notes == [("The run has ended", "over", {"auto_close_seconds": None, "color": "blue"})]
    assert (page.flushed, no_farewell) == (1, [process.FAREWELL_S])


def test_a_page_without_browsers_ends_at_once(no_farewell: list[float]) -> None:
    page = Page()
    page.view.run([ViewEnd("over")])
    assert (page.flushed, no_farewell, page.sent) == (0, [], [])


def test_a_refusal_is_shown_in_every_browser_and_at_the_controls() -> None:
    page = Page([2], [ViewRefusal("no room"), ViewEnd("over")])
    page.view.run([])
    note = ("Refused", "no room", {"auto_close_seconds": 12.0, "color": "red"})
    assert page.notes[:2] == [note, note]
    assert page.parts["controls"].refusals == ["no room"]


def test_garbage_is_collected_at_its_period(monkeypatch: pytest.MonkeyPatch) -> None:
    collected: list[float] = []
    now_s = [0.0]
    monkeypatch.setattr(process, "time", SimpleNamespace(monotonic=lambda: now_s[0]))
    monkeypatch.setattr(process, "gc", SimpleNamespace(collect=lambda: collected.append(now_s[0])))
    page = Page()

    def receive(wait_s: float) -> list[Any]:
        now_s[0] += 10.0
        return [ViewEnd("over")] if now_s[0] > 75.0 else []

    page.view._pipe = cast(Any, SimpleNamespace(receive=receive))
    page.view.run([])
    assert collected == [30.0, 60.0]


def ball(frame: str, name: str, lifetime_s: float) -> messages.SceneEntity:
    pose = messages.Pose(
        position=messages.Vector3(x=1.0, y=0.0, z=0.0), orientation=messages.Quaternion(x=0.0, y=0.0, z=0.0, w=1.0)
    )
    size, colour = messages.Vector3(x=1.0, y=1.0, z=1.0), messages.Color(r=1.0, g=0.0, b=0.0, a=1.0)
    sphere = messages.SpherePrimitive(pose=pose, size=size, color=colour)
    return messages.SceneEntity(
        timestamp=timestamp(1_000_000_000),
        frame_id=frame,
        id=name,
        lifetime=messages.Duration.from_secs(lifetime_s),
        spheres=[sphere],
    )


def test_bodies_and_drawings_keep_the_shapes_that_were_sent_before() -> None:
    update = messages.SceneUpdate(entities=[ball("body_3", "body_3", 0.0), ball("map", "radar", 5.0)]).encode()
    place = BodyInstant(np.array([7.0, 8.0, 9.0]), LEVEL)
    image = ViewImage(2.0, b"")
    seen = ViewInstant(
        2.0,
        {"a": VesselInstant(np.zeros(3), LEVEL, images={"bow": image}), "b": VesselInstant(np.zeros(3), LEVEL)},
        bodies={3: place, 4: place},
    )
    page = Page([ViewUpdate(update), seen, ViewEnd("over")])
    page.view.run([])
    for name in ("drawing", "cameras", "instruments", "readouts", "controls"):
        (drawn,) = page.parts[name].updates
        assert drawn.time_s == 2.0
    (drawn,) = page.parts["drawing"].updates
    assert drawn.bodies[3].position_enu_m.tolist() == [7.0, 8.0, 9.0]
    assert len(drawn.bodies[3].meshes) == 1
    assert drawn.bodies[4].meshes == ()
    assert list(drawn.drawings) == ["radar"]
    assert page.parts["images"].updates == [{("a", "bow"): image}]


def test_a_page_without_controls_draws_and_refuses_too() -> None:
    page = Page([instant(), ViewRefusal("no room"), ViewEnd("over")])
    page.view._controls = None
    page.view.run([])
    assert len(page.parts["drawing"].updates) == 1
    assert page.parts["controls"].updates == []


def test_an_action_of_the_page_is_sent_to_the_run() -> None:
    page = Page()
    page.view.act({"action": "pause"})
    assert page.sent == [{"action": {"action": "pause"}}]


# -- entry points


def test_the_live_outputs_are_those_of_the_profile() -> None:
    profiles = [load_profile("sitl").runnable()]
    assert type(plugin.live_view(profiles)).__name__ == "ViewOutput"
    assert type(plugin.live_foxglove(profiles)).__name__ == "FoxgloveOutput"


def test_a_report_gets_its_replay(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay_page, "report_replay", lambda report, vessel: (report, vessel))
    assert plugin.replay(cast(Any, "report"), "ego") == cast(Any, ("report", "ego"))


def test_the_public_functions_take_paths_as_text(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[Any] = []

    class Scene:
        def __enter__(self) -> str:
            return "scene"

        def __exit__(self, *_: object) -> None:
            opened.append("closed")

    def open_scene(paths: list[Path], vessel: str | None) -> Scene:
        opened.append((paths, vessel))
        return Scene()

    monkeypatch.setattr("xitl_cli.plugins.view.recording.open_scene", open_scene)
    monkeypatch.setattr(replay_page, "replay_html", lambda scene, **keys: f"{scene} {keys}")
    page = plugin.replay_html("a.bin", tmp_path, vessel="ego", from_s=1.0, to_s=2.0)
    assert page == "scene {'from_s': 1.0, 'to_s': 2.0}"
    assert opened == [([Path("a.bin"), tmp_path], "ego"), "closed"]
    monkeypatch.setattr(pictures, "picture", lambda *given, **keys: (given, keys))
    shot: Any = plugin.picture("a.bin", at_s=3.0, vessel="ego")
    assert shot == (([Path("a.bin")], 3.0), {"size": (1280, 720), "vessel": "ego"})
