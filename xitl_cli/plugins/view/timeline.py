"""Time line of a served recording: playback, speed, slider, event marks, and jumps to findings."""

from __future__ import annotations

import math
import socket
import threading
import time
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from xitl_cli.logs.model.sections import Severity
from xitl_cli.logs.model.text import clock_text
from xitl_cli.plugins.view.recording import LogScene, SceneFinding, SceneMark
from xitl_cli.plugins.view.replay import ReplayDrawing, silent_viser

if TYPE_CHECKING:
    import viser

    from xitl_cli.plugins.view.server import ViewAddress

SPEEDS = ("0.1 ×", "0.25 ×", "0.5 ×", "1 ×", "2 ×", "5 ×", "10 ×", "30 ×")
FRAMES_HZ = 20.0
IDLE_S = 0.1
SLIDER_S = 0.2
"""Update period of the slider during playback."""
STEP_S = 0.05
MOST_SLIDER_MARKS, MOST_LISTED, MOST_FINDINGS = 60, 400, 40
BEFORE_FINDING_S = 1.0
"""Lead time of a jump to a finding, so that the user sees its start."""
NO_EVENT = "–"
_COLOURS = {Severity.CRITICAL: "red", Severity.WARNING: "orange", Severity.NOTICE: "blue"}


class PlayClock:
    """Playback time of a recording. It is thread-safe, because callbacks of buttons run in separate threads."""

    def __init__(self, span_s: tuple[float, float], at_s: float | None = None, speed: float = 1.0) -> None:
        self._lock = threading.Lock()
        self.begin_s, self.end_s = span_s
        self._time_s = self.begin_s if at_s is None else min(max(at_s, self.begin_s), self.end_s)
        self._speed = speed
        self._playing = at_s is None

    @property
    def time_s(self) -> float:
        return self._time_s

    @property
    def playing(self) -> bool:
        return self._playing

    def advance(self, elapsed_s: float) -> float:
        """Advance by elapsed wall clock time, at most to the end. Return the time to show."""
        with self._lock:
            if self._playing:
                self._time_s = min(self._time_s + elapsed_s * self._speed, self.end_s)
                self._playing = self._time_s < self.end_s
            return self._time_s

    def play(self, wanted: bool) -> None:
        """Play or pause. At the end, playback restarts from the beginning."""
        with self._lock:
            if wanted and self._time_s >= self.end_s:
                self._time_s = self.begin_s
            self._playing = wanted

    def jump(self, time_s: float) -> None:
        """Pause at an instant."""
        with self._lock:
            self._time_s = min(max(time_s, self.begin_s), self.end_s)
            self._playing = False

    def run_at(self, speed: float) -> None:
        """Set the speed as a multiple of the recorded speed."""
        with self._lock:
            self._speed = speed


class TimelinePanel:
    """Controls of a PlayClock on a server's page."""

    def __init__(self, server: viser.ViserServer, clock: PlayClock, marks: Sequence[SceneMark]) -> None:
        self._clock = clock
        self._marks = marks[:MOST_LISTED]
        self._times = [mark.time_s for mark in self._marks]
        self._slid_s = -math.inf
        self._gui = gui = server.gui
        self._folder = gui.add_folder("Time", order=0.0)
        with self._folder:
            self._play = gui.add_button("Pause" if clock.playing else "Play", order=0.0)
            self._slider = gui.add_slider(
                "Time (s)",
                round(clock.begin_s, 2),
                round(max(clock.end_s, clock.begin_s + STEP_S), 2),
                STEP_S,
                round(clock.time_s, 2),
                marks=slider_marks(marks),
                order=0.1,
            )
            self._speed = gui.add_dropdown("Speed", SPEEDS, initial_value="1 ×", order=0.2)
            self._event: Any = None
            if self._marks:
                self._labels = event_labels(self._marks)
                self._event = gui.add_dropdown("Event", (NO_EVENT, *self._labels), initial_value=NO_EVENT, order=0.3)
                self._event.on_update(self._choose_event)
                steps = gui.add_button_group("Go to", ("◀ event", "event ▶"), order=0.4)
                steps.on_click(lambda event: self._step_event(forward=steps.value == "event ▶"))
        self._play.on_click(lambda event: clock.play(not clock.playing))
        self._slider.on_update(self._slide)
        self._speed.on_update(lambda event: clock.run_at(float(str(self._speed.value).split()[0])))

    def show_findings(self, findings: Sequence[SceneFinding]) -> None:
        """Add a button for each finding. It jumps to the finding's time."""
        gui = self._gui
        with gui.add_folder(f"Findings ({len(findings)})", order=0.5, expand_by_default=bool(findings)):
            if not findings:
                gui.add_markdown("The log analysis has no findings.")
            for finding in findings[:MOST_FINDINGS]:
                at = "" if finding.time_s is None else f"{clock_text(finding.time_s)} "
                button = gui.add_button(
                    at + shortened(finding.sentence),
                    color=_COLOURS.get(finding.severity, "gray"),
                    disabled=finding.time_s is None,
                    hint=f"{finding.sentence}. {finding.next_step}",
                )
                button.on_click(self._jump_to(finding.time_s))

    def update(self, now_s: float) -> None:
        """Update the controls to the clock, a few times per second."""
        playing, time_s = self._clock.playing, self._clock.time_s
        label = "Pause" if playing else "Play"
        if self._play.label != label:
            self._play.label = label
        if now_s - self._slid_s >= SLIDER_S and abs(float(self._slider.value) - time_s) > 0.5 * STEP_S:
            self._slid_s = now_s
            self._slider.value = round(time_s, 2)

    def _slide(self, event: Any) -> None:
        if event.client is not None:  # not when it follows the clock
            self._clock.jump(float(self._slider.value))

    def _choose_event(self, event: Any) -> None:
        if event.client is not None and self._event.value != NO_EVENT:
            self._clock.jump(self._times[self._labels.index(self._event.value)])

    def _step_event(self, forward: bool) -> None:
        at_s = self._clock.time_s
        number = bisect_right(self._times, at_s + 0.01) if forward else bisect_left(self._times, at_s - 0.01) - 1
        if 0 <= number < len(self._times):
            self._clock.jump(self._times[number])
            self._event.value = self._labels[number]

    def _jump_to(self, time_s: float | None) -> Callable[[Any], None]:
        return lambda event: None if time_s is None else self._clock.jump(time_s - BEFORE_FINDING_S)


def slider_marks(marks: Sequence[SceneMark]) -> tuple[float, ...]:
    """Return the times of the marks on the slider. Too many events are thinned."""
    every = max(-(-len(marks) // MOST_SLIDER_MARKS), 1)
    return tuple(round(mark.time_s, 2) for mark in marks[::every])


def event_labels(marks: Sequence[SceneMark]) -> list[str]:
    """Return one label per mark, without duplicates."""
    labels: list[str] = []
    taken: set[str] = set()
    for mark in marks:
        label = f"{clock_text(mark.time_s)} {shortened(mark.text, 60)}"
        while label in taken:
            label += " "
        taken.add(label)
        labels.append(label)
    return labels


def shortened(text: str, most: int = 90) -> str:
    """Return a text of at most `most` characters. A cut text ends in an ellipsis."""
    return text if len(text) <= most else text[: most - 1].rstrip() + "…"


class RecordingPage:
    """Page of a recording at an address. at_s: initial time of the paused page; None starts playback."""

    def __init__(
        self,
        recording: LogScene,
        listener: socket.socket,
        address: ViewAddress,
        *,
        at_s: float | None = None,
        dark: bool = False,
    ) -> None:
        from xitl_cli.plugins.view.camera import Cameras
        from xitl_cli.plugins.view.camera_images import ImagePanel
        from xitl_cli.plugins.view.drawing import add_drawing_options
        from xitl_cli.plugins.view.instruments import InstrumentPanel
        from xitl_cli.plugins.view.readouts import Readouts
        from xitl_cli.plugins.view.server import make_server

        self._recording = recording
        self.clock = PlayClock(recording.span_s, at_s)
        with silent_viser():
            self._server = server = make_server(listener, address, recording.scene.title)
        server.gui.configure_theme(dark_mode=dark, show_logo=False, show_share_button=False)
        self._drawing = ReplayDrawing(server, recording, dark=dark)
        self.panel = TimelinePanel(server, self.clock, recording.marks)
        self._readouts = Readouts(server, recording.scene)
        self._instruments = InstrumentPanel(server, recording.scene, self._drawing.track_colours)
        self._cameras = Cameras(server, recording.scene)
        self._images = ImagePanel(server)
        add_drawing_options(server, self._drawing.drawing, self._draw_again)
        self._shown_s: float | None = None
        self._draw(self.clock.time_s, time.monotonic())

    def _draw_again(self) -> None:
        self._shown_s = None

    def find(self) -> None:
        """Add the findings of the log analysis. It takes seconds: call it in a separate thread."""
        self.panel.show_findings(self._recording.findings())

    def serve(self, ended: threading.Event) -> None:
        """Draw until `ended` is set. The time does not advance without a browser."""
        last_s = time.monotonic()
        while not ended.is_set():
            began_s = time.monotonic()
            watched = bool(self._server.get_clients())
            time_s = self.clock.advance(began_s - last_s if watched else 0.0)
            last_s = began_s
            if watched:
                self._draw(time_s, began_s)
            spent_s = time.monotonic() - began_s
            ended.wait(max(1.0 / FRAMES_HZ - spent_s, 0.005) if watched else IDLE_S)

    def _draw(self, time_s: float, now_s: float) -> None:
        if time_s != self._shown_s:
            shown_s, self._shown_s = self._shown_s, time_s
            since_s = shown_s if shown_s is not None and 0.0 < time_s - shown_s < 60.0 else None
            self._instant = self._recording.instant(time_s, since_s)
            self._drawing.draw(self._instant)
            self._instruments.update(self._instant)
        self._readouts.update(self._instant, now_s)
        self._images.update(self._recording.images(time_s))
        self._cameras.update(self._instant)
        self.panel.update(now_s)

    def close(self) -> None:
        """Stop the server."""
        with silent_viser():
            self._server.stop()
