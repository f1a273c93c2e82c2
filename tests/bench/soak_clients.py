"""Clients of a long run: ground stations by pymavlink, a client of the live view's websocket, and a browser."""

from __future__ import annotations

import random
import socket
import threading
import time
from collections import Counter
from collections.abc import Iterator
from typing import Any

from agent.mavlink import ftp
from agent.mavlink.ftp import FtpPacket
from tests.chromium import launch_chromium

ANSWER_S = 30.0
"""A request that is not answered in full by then has failed."""
STEER_S = 2.0
_ARMED, _AUTO = 128, 10
_ARM, _MISSION_START = 400, 300
VIEWER_CAMERA = {
    "type": "ViewerCameraMessage",
    "wxyz": (1.0, 0.0, 0.0, 0.0),
    "position": (3.0, 3.0, 3.0),
    "fov": 1.0,
    "near": 0.1,
    "far": 1000.0,
    "image_height": 360,
    "image_width": 640,
    "look_at": (0.0, 0.0, 0.0),
    "up_direction": (0.0, 0.0, 1.0),
}
"""Message of a browser that looks at the view."""
BROWSER_WINDOW = {"width": 320, "height": 180}
LOAD_S = 60.0
"""A page that is not complete by then has failed."""
FRAME_PAUSE_S = 2.0
COUNT_FRAMES = """(() => {
  window.framesDrawn = 0;
  let drawn = false;
  const draw = WebGL2RenderingContext.prototype.drawElements;
  WebGL2RenderingContext.prototype.drawElements = function (...all) { drawn = true; return draw.apply(this, all); };
  const request = window.requestAnimationFrame.bind(window);
  window.requestAnimationFrame = (work) => setTimeout(() => request((at) => {
    work(at);
    if (drawn) window.framesDrawn += 1;
    drawn = false;
  }), PAUSE_MS);
})()""".replace("PAUSE_MS", f"{1e3 * FRAME_PAUSE_S:g}")
"""Script of a page that counts its frames, with a pause after each one."""


class Client(threading.Thread):
    """A client in a thread of this process. counts: what it did, by name. failure: the error that ended it."""

    def __init__(self, name: str) -> None:
        super().__init__(name=name, daemon=True)
        self.counts: Counter[str] = Counter()
        self.failure = ""
        self._stopped = threading.Event()

    def run(self) -> None:
        try:
            self.serve()
        except Exception as error:  # noqa: BLE001  the result names it
            self.failure = f"{self.name}: {error!r}"

    def serve(self) -> None:
        """Work until `stopped`."""
        raise NotImplementedError

    @property
    def stopped(self) -> bool:
        return self._stopped.is_set()

    def stop(self) -> None:
        """Ask it to leave; `join` waits for that."""
        self._stopped.set()


class Station(Client):
    """A ground station. It reads all telemetry and counts the frames that its sequence numbers miss.

    url: of pymavlink. steers: it arms, and starts the mission again whenever the vehicle is not in AUTO. requests:
    what it asks for every `pause_s`, by the names of its methods. stay_s: it leaves and returns after this time.
    """

    def __init__(
        self,
        url: str,
        system: int,
        steers: bool = False,
        requests: tuple[str, ...] = (),
        pause_s: float = 15.0,
        stay_s: float = 1e9,
    ) -> None:
        super().__init__(f"station {system}")
        self._url, self._system, self._steers, self._stay_s = url, system, steers, stay_s
        self._requests, self._pause_s = requests, pause_s
        self._link: Any = None
        self._beat_s = self._steered_s = 0.0

    def serve(self) -> None:
        while not self.stopped:
            self._visit()

    def _visit(self) -> None:
        """Connect, ask in turns, leave."""
        from pymavlink import mavutil

        self._link = mavutil.mavlink_connection(self._url, source_system=self._system, dialect="ardupilotmega")
        # The run is over: pymavlink would print that for ever.
        self._link.handle_eof = self._link.handle_disconnect = self.stop
        self.counts["connections"] += 1
        until_s = time.monotonic() + self._stay_s
        try:
            turn = 0
            while not self.stopped and time.monotonic() < until_s:
                self._pass_time(self._pause_s)
                if self._requests and not self.stopped:
                    name = self._requests[turn % len(self._requests)]
                    turn += 1
                    self.counts[f"{name} asked"] += 1
                    self.counts[f"{name} answered"] += getattr(self, f"_{name}")()
        finally:
            self._leave()

    def _pass_time(self, seconds: float) -> None:
        until_s = time.monotonic() + seconds
        while not self.stopped and time.monotonic() < until_s:
            self._receive()

    def _receive(self) -> Any:
        """The next message, None after a moment without one."""
        now_s = time.monotonic()
        if now_s - self._beat_s >= 1.0:
            self._beat_s = now_s
            self._link.mav.heartbeat_send(6, 8, 0, 0, 4)
        message = self._link.recv_match(blocking=True, timeout=0.2)
        if message is not None and message.get_type() == "HEARTBEAT" and self._steers:
            self._steer(message)
        return message

    def _steer(self, beat: Any) -> None:
        if time.monotonic() - self._steered_s < STEER_S:
            return
        self._steered_s = time.monotonic()
        if not beat.base_mode & _ARMED:
            self.counts["arm"] += 1
            self._link.mav.command_long_send(1, 1, _ARM, 0, 1, 0, 0, 0, 0, 0, 0)
        elif beat.custom_mode != _AUTO:
            self.counts["mission start"] += 1
            self._link.mav.mission_set_current_send(1, 1, 1)
            self._link.mav.command_long_send(1, 1, _MISSION_START, 0, 0, 0, 0, 0, 0, 0, 0)

    def _messages(self, kind: str) -> Iterator[Any]:
        """Messages of one kind until the request has failed; None when a second passed without."""
        until_s = time.monotonic() + ANSWER_S
        heard_s = time.monotonic()
        while not self.stopped and time.monotonic() < until_s:
            message = self._receive()
            if message is not None and message.get_type() == kind:
                heard_s = time.monotonic()
                yield message
            elif time.monotonic() - heard_s > 1.0:
                heard_s = time.monotonic()
                yield None

    def _parameters(self) -> bool:
        """Every parameter, by the list and then by number."""
        self._link.mav.param_request_list_send(1, 1)
        missing: set[int] | None = None
        for value in self._messages("PARAM_VALUE"):
            if value is None:
                for index in sorted(missing or ())[:10]:
                    self._link.mav.param_request_read_send(1, 1, b"", index)
                continue
            missing = set(range(value.param_count)) if missing is None else missing
            missing.discard(value.param_index)
            if not missing:
                return True
        return False

    def _mission(self) -> bool:
        """Every item of the mission."""
        self._link.mav.mission_request_list_send(1, 1)
        for count in self._messages("MISSION_COUNT"):
            if count is not None:
                return all(self._item(seq) for seq in range(count.count))
            self._link.mav.mission_request_list_send(1, 1)
        return False

    def _item(self, seq: int) -> bool:
        self._link.mav.mission_request_int_send(1, 1, seq)
        for item in self._messages("MISSION_ITEM_INT"):
            if item is not None and item.seq == seq:
                return True
            self._link.mav.mission_request_int_send(1, 1, seq)
        return False

    def _files(self) -> bool:
        """The listing of the vehicle's folders of system files and logs."""
        return all(self._folder(path) for path in (b"/", b"@SYS", b"/APM"))

    def _folder(self, path: bytes) -> bool:
        sequence = random.randrange(1000) * 2
        offset = 0

        def ask() -> None:
            packet = FtpPacket(sequence, 0, ftp.LIST, len(path), offset=offset, data=path)
            self._link.mav.file_transfer_protocol_send(0, 1, 1, packet.pack())

        ask()
        for message in self._messages("FILE_TRANSFER_PROTOCOL"):
            answer = None if message is None else FtpPacket.from_payload(bytes(message.payload))
            if answer is None or answer.sequence != sequence + 1:
                ask()
            elif answer.operation == ftp.NAK:
                return answer.data[0] == ftp.END_OF_FILE
            else:
                sequence, offset = (sequence + 2) % 65536, offset + answer.data.count(b"\0")
                ask()
        return False

    def _leave(self) -> None:
        """Read what is still on the way, then close."""
        link = self._link
        if hasattr(link, "port") and link.port.type == socket.SOCK_STREAM:
            link.port.settimeout(ANSWER_S)
            try:
                link.port.shutdown(socket.SHUT_WR)
                while received := link.port.recv(65536):
                    link.mav.parse_buffer(received)
            except OSError:  # the run is over
                self.counts["closed by the vehicle"] += 1
        self.counts["frames"] += link.mav.total_packets_received
        self.counts["gaps"] += link.mav_loss
        self.counts["damaged"] += link.mav.total_receive_errors
        link.close()


class Viewer(Client):
    """A browser's end of the live view: it reads all that the page's server sends. address: of the page."""

    def __init__(self, address: str, stay_s: float) -> None:
        super().__init__("view")
        self._address, self._stay_s = address.replace("http", "ws", 1), stay_s

    def serve(self) -> None:
        import msgspec
        import viser
        from websockets.sync.client import connect

        while not self.stopped:
            until_s = time.monotonic() + self._stay_s
            with connect(
                self._address, subprotocols=[f"viser-v{viser.__version__}"], max_size=None, proxy=None
            ) as joined:
                self.counts["connections"] += 1
                joined.send(msgspec.msgpack.encode(VIEWER_CAMERA))
                while not self.stopped and time.monotonic() < until_s:
                    try:
                        self.counts["bytes"] += len(joined.recv(timeout=1.0))
                        self.counts["messages"] += 1
                    except TimeoutError:
                        continue


class Browser(Client):
    """Headless Chromium that looks at the live view, and loads its page again every `stay_s`.

    It draws in software, which takes a whole processor without `FRAME_PAUSE_S`. It fails if the page reports an error,
    crashes, or does not show the instruments or a frame.

    address: of the page.
    """

    def __init__(self, address: str, stay_s: float) -> None:
        super().__init__("browser")
        self._address, self._stay_s = address, stay_s

    def serve(self) -> None:
        from playwright.sync_api import sync_playwright

        with sync_playwright() as driver:
            browser = launch_chromium(driver)
            page = browser.new_page(viewport=BROWSER_WINDOW)
            page.set_default_timeout(LOAD_S * 1e3)
            page.add_init_script(COUNT_FRAMES)
            page.on("console", lambda message: self._fault(message.text) if message.type == "error" else None)
            page.on("pageerror", lambda error: self._fault(str(error)))
            page.on("crash", lambda page: self._fault("the page crashed"))
            while not self.stopped:
                self._visit(page)
            browser.close()

    def _visit(self, page: Any) -> None:
        page.goto(self._address)
        page.locator("td", has_text="waypoint").wait_for()
        self.counts["loads"] += 1
        until_s = time.monotonic() + self._stay_s
        while not self.stopped and time.monotonic() < until_s:
            page.wait_for_timeout(500)
        frames = page.evaluate("framesDrawn")
        self.counts["frames drawn"] += frames
        if not frames:
            self._fault(f"no frame drawn in load {self.counts['loads']}")

    def _fault(self, text: str) -> None:
        """Count an error. The first one is the failure of this client; it goes on."""
        self.counts["errors"] += 1
        self.failure = self.failure or f"{self.name}: {text}"


def leave(clients: list[Client], wait_s: float) -> None:
    """Stop all clients and wait until they have left."""
    for client in clients:
        client.stop()
    until_s = time.monotonic() + wait_s
    for client in clients:
        client.join(max(until_s - time.monotonic(), 0.0))
