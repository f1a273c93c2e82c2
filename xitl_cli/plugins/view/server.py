"""Server of a view's page: its address, its access control, and the start of a browser.

viser has no access control. This module gives viser's server the listening socket and a check of each request.
"""

from __future__ import annotations

import errno
import hmac
import http
import os
import secrets
import socket
import sys
import threading
from collections.abc import Callable
from functools import cache
from typing import TYPE_CHECKING, Any, ClassVar

from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError
from xitl_cli.extras import VIEW
from xitl_cli.http_access import listening_socket, stranger

if TYPE_CHECKING:
    import viser

USUAL_PORT = 8470
PORTS_TRIED = 50
TOKEN_BYTES = 18
SHORT_PX = 480
CLIENTS_KEPT = 64
"""Maximum number of connections that wait for access. Each connection uses a file descriptor."""


@dataclass(frozen=True, slots=True)
class ViewAddress:
    """Address of a view."""

    host: str
    port: int
    token: str = ""
    """Secret in the address. The server refuses requests without it."""
    moved: int | None = None
    """Usual port, if another program uses it and the view has another port."""

    @property
    def url(self) -> str:
        """URL for a browser. If the view listens at all addresses, it contains the name of this machine."""
        host = self.host
        if host in ("0.0.0.0", "::"):
            host = socket.gethostname()
        host = f"[{host}]" if ":" in host else host
        return f"http://{host}:{self.port}/" + (f"{self.token}/" if self.token else "")


def check_view_extra() -> None:
    """Raise UserError if viser is not installed."""
    VIEW.require("the 3D view cannot do without")


def listen(
    host: str,
    port: int | None,
    host_key: str = "view.host",
    port_key: str = "view.port",
    usual: int | None = None,
) -> tuple[socket.socket, ViewAddress]:
    """Return a listening socket and its address. A browser can connect before the page is ready.

    port: None for the usual port, or a free one if it is taken. host_key, port_key: names of host and port in errors.
    usual: the usual port, USUAL_PORT by default.

    Raises UserError for an address that does not belong to this machine, and for a given port that is taken.
    """
    token = secrets.token_urlsafe(TOKEN_BYTES)
    first = (USUAL_PORT if usual is None else usual) if port is None else port
    for candidate in range(first, first + (PORTS_TRIED if port is None else 1)):
        try:
            listener = listening_socket(host, candidate, CLIENTS_KEPT)
        except OSError as error:
            if error.errno in (errno.EADDRINUSE, errno.EACCES) and port is None:
                continue
            if error.errno == errno.EADDRINUSE:
                raise UserError(
                    f"{port_key} = {port}: another program listens there; omit it to use a free port"
                ) from error
            reason = error.strerror or str(error)
            raise UserError(
                f"{host_key} = {host}: cannot listen there at port {candidate} ({reason}); "
                "use an address of this machine, such as 127.0.0.1"
            ) from error
        return listener, ViewAddress(host, candidate, token, first if candidate != first else None)
    raise UserError(
        f"no port from {first} to {first + PORTS_TRIED - 1} is free for the view; choose one with {port_key}"
    )


def has_desktop() -> bool:
    """Return whether a user can see a browser: with a desktop, a terminal, and without continuous integration."""
    desktop = sys.platform in ("darwin", "win32") or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    return bool(desktop) and not os.environ.get("CI") and sys.stderr is not None and sys.stderr.isatty()


def open_browser(url: str) -> bool:
    """Open a browser and return whether that succeeded. Do not wait for browsers that run in the terminal."""
    import webbrowser

    try:
        return webbrowser.open(url)
    except (webbrowser.Error, OSError):
        return False


def make_server(listener: socket.socket, address: ViewAddress, title: str) -> viser.ViserServer:
    """Return a viser server at `listener`. It accepts only requests with the token, and connects to no other machine.

    During its construction, viser accepts connections but cannot serve them. They wait until it is complete.
    """
    import asyncio

    import viser
    import websockets.asyncio.server as asyncio_server
    from viser._messages import ShareUrlDisconnect, ShareUrlRequest

    serve = asyncio_server.serve
    made = threading.Event()

    class BoundedConnection(asyncio_server.ServerConnection):
        """A connection. Above `CLIENTS_KEPT` connections without a complete request, the oldest is closed."""

        waiting: ClassVar[dict[Any, None]] = {}

        def connection_made(self, transport: Any) -> None:
            waiting = type(self).waiting
            if len(waiting) >= CLIENTS_KEPT:
                oldest = next(iter(waiting))
                del waiting[oldest]
                oldest.abort()
            waiting[transport] = None
            super().connection_made(transport)

        def process_event(self, event: Any) -> None:
            type(self).waiting.pop(self.transport, None)
            super().process_event(event)

        def connection_lost(self, error: Exception | None) -> None:
            type(self).waiting.pop(self.transport, None)
            super().connection_lost(error)

    def guarded_serve(handler: Any, host: str, port: int, *, process_request: Any, **options: Any) -> Any:
        checked = Doorkeeper(address, process_request, title)

        async def handle(connection: Any) -> None:
            while not made.is_set():
                await asyncio.sleep(_MADE_S)
            await handler(connection)

        return serve(handle, sock=listener, process_request=checked, create_connection=BoundedConnection, **options)

    with _SERVE_LOCK:
        _have_threads_wake_safely()
        asyncio_server.serve = guarded_serve  # type: ignore[assignment, misc]
        try:
            server = viser.ViserServer(host=address.host, port=address.port, label=title, verbose=False)
        finally:
            asyncio_server.serve = serve  # type: ignore[misc]
    handlers = server._websock_server._incoming_handlers
    for message in (ShareUrlRequest, ShareUrlDisconnect):
        handlers.pop(message, None)
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    server.on_client_connect(_minimise_on_short_screen)
    made.set()
    return server


def _minimise_on_short_screen(client: Any) -> None:
    """Minimise the floating panel on a short screen, such as a phone in landscape orientation."""
    if client.camera.image_height < SHORT_PX:
        client.gui.main_panel.minimize()


@cache
def _have_threads_wake_safely() -> None:
    """Give viser's message buffer an event that any thread may set.

    viser also sets this event outside of its event loop, which asyncio does not allow. It raised RuntimeError in the
    drawing thread about once in 300,000 messages. viser sets the event again inside its loop for each message, and only
    this call wakes the waiting tasks.
    """
    import asyncio

    from viser.infra import _infra

    class AnyThreadsEvent(asyncio.Event):
        def set(self) -> None:
            try:
                asyncio.get_running_loop()
            except RuntimeError:
                self._value = True
                return
            self._value = False  # or nobody would be woken
            super().set()

    class MessageBuffer(_infra.AsyncMessageBuffer):  # type: ignore[misc]
        def __init__(self, *arguments: Any, **keys: Any) -> None:
            super().__init__(*arguments, **keys)
            self.message_event = AnyThreadsEvent()

    _infra.AsyncMessageBuffer = MessageBuffer


_SERVE_LOCK = threading.Lock()
_MADE_S = 0.01
"""Interval of the check whether the server is complete."""


class Doorkeeper:
    """Checks each request before viser answers it. Refuses requests without the token, and from pages of other sites.

    A page of another site can make a browser connect to this machine. The `Origin` header reveals such a page. If the
    site's own name resolves to this machine, the `Host` header reveals it.
    """

    def __init__(self, address: ViewAddress, answer: Callable[[Any, Any], Any], title: str) -> None:
        self._token = address.token
        self._host = address.host
        self._answer = answer
        self._title = title

    def __call__(self, connection: Any, request: Any) -> Any:
        refusal = self._refusal(request)
        if refusal:
            return connection.respond(http.HTTPStatus.FORBIDDEN, f"{refusal}\n")
        if self._token:
            request.path = request.path.removeprefix(f"/{self._token}") or "/"
        answer = self._answer(connection, request)
        if answer is not None and request.path.partition("?")[0] in ("/", "/index.html"):
            _complete(answer, self._title)
        return answer

    def _refusal(self, request: Any) -> str:
        """Return the reason to refuse a request, empty if it is allowed."""
        for name in ("Host", "Origin"):
            if len(request.headers.get_all(name)) > 1:
                return f"it has two headers {name}"
        if refusal := stranger(self._host, request.headers.get("Host", ""), request.headers.get("Origin")):
            return refusal
        if self._token:
            first = request.path.partition("?")[0].lstrip("/").partition("/")[0]
            if not hmac.compare_digest(first.encode(errors="replace"), self._token.encode()):
                return "the token in the address of this view is missing or wrong"
        return ""


_HEAD = """<title>{title}</title>
<script>
addEventListener("DOMContentLoaded", () => {{
  let works = false;
  try {{
    const canvas = document.createElement("canvas");
    works = Boolean(canvas.getContext("webgl2"));
  }} catch (error) {{}}
  if (works) return;
  const note = document.createElement("div");
  note.id = "xitl-no-webgl";
  note.setAttribute("role", "alert");
  note.style.cssText = "position:fixed;left:0;right:0;bottom:0;z-index:99999;padding:14px 18px;background:#b3261e;"
    + "color:#fff;font:15px/1.4 system-ui,sans-serif";
  note.textContent = "This browser has no WebGL 2, which the 3D view needs. Enable hardware acceleration in its "
    + "settings, or use another browser. The run continues without the view.";
  document.documentElement.appendChild(note);
}});
// viser opens its sheet of controls on a narrow screen, over more than half of the picture. It begins closed here.
const sheets = new WeakSet();
new MutationObserver(() => {{
  const sheet = document.querySelector(
    '.mantine-Paper-root[style*="position: fixed"][style*="bottom: 0px"][style*="max-height"]');
  const handle = sheet && sheet.querySelector('[style*="cursor: pointer"][style*="user-select: none"]');
  if (!handle || sheets.has(handle)) return;
  sheets.add(handle);
  handle.id = "xitl-sheet-handle";
  handle.setAttribute("role", "button");
  handle.setAttribute("tabindex", "0");
  handle.setAttribute("aria-label", "Controls");
  handle.setAttribute("aria-expanded", "true");
  handle.addEventListener("click", (event) => {{
    if (event.target.closest("button")) return;
    handle.setAttribute("aria-expanded", String(handle.getAttribute("aria-expanded") !== "true"));
  }});
  handle.addEventListener("keydown", (event) => {{
    if (event.target !== handle || (event.key !== "Enter" && event.key !== " ")) return;
    event.preventDefault();
    handle.click();
  }});
  handle.click();
}}).observe(document, {{ childList: true, subtree: true }});
</script>
<style>
#xitl-sheet-handle[aria-expanded="false"]::after {{ content: "Controls \\25B4"; margin-left: auto; opacity: 0.7; }}
</style>
"""


def _complete(answer: Any, title: str) -> None:
    """Add a title, the look of the scene, the instruments and a message about missing WebGL to the page.

    viser's own message is lost when its page fails.
    """
    import gzip
    import html

    from xitl_cli.plugins.view.instruments import instruments_html
    from xitl_cli.plugins.view.look import look_html

    packed = answer.headers.get("Content-Encoding") == "gzip"
    body = gzip.decompress(answer.body) if packed else answer.body
    before, head, rest = body.partition(b"<head>")
    if not head:
        return
    text = (_HEAD.format(title=html.escape(title)) + look_html() + instruments_html()).encode()
    body = before + head + text + rest.replace(b"<title>Viser</title>", b"", 1)
    answer.body = gzip.compress(body, 1) if packed else body
    headers = {
        "Content-Length": str(len(answer.body)),
        "Cache-Control": "no-store",
        "Referrer-Policy": "no-referrer",  # the address has the token in it
    }
    for name, value in headers.items():
        if name in answer.headers:
            del answer.headers[name]
        answer.headers[name] = value
