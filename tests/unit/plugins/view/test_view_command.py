"""`xitl view`: the files that it writes, what it refuses, and the page that it serves."""

from __future__ import annotations

import signal
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from eastward_run import run_file
from typer.testing import CliRunner

from tests.command_line import xitl_app
from xitl_cli.errors import UserError
from xitl_cli.plugins.view import pictures, replay_page, server, timeline
from xitl_cli.plugins.view.command import _megabytes, _refuse_other, _size, _write_whole

pytest.importorskip("viser")


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run_file(tmp_path_factory.mktemp("run") / "run.mcap")


class Drawn:
    """Stands in for the browser and the page. calls: the name of what was drawn, with its keys."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.calls: list[tuple[str, tuple[Any, ...], dict[str, Any]]] = []
        monkeypatch.setattr(pictures, "picture", self._draws("png", b"\x89PNG picture"))
        monkeypatch.setattr(pictures, "moving_picture", self._draws("film", b"GIF89a film"))
        monkeypatch.setattr(replay_page, "replay_html", self._draws("page", "<!doctype html>ö"))

    def _draws(self, name: str, content: Any) -> Any:
        return lambda scene, *given, **keys: (self.calls.append((name, given, keys)), content)[1]


def view(*words: str | Path) -> tuple[int, str]:
    """Exit status and output."""
    arguments: Sequence[str] = ["view", *map(str, words)]
    result = CliRunner().invoke(xitl_app(arguments), arguments)
    if isinstance(result.exception, UserError):
        raise result.exception
    return result.exit_code, result.output


@pytest.mark.medium
def test_files_are_written_with_the_options_of_each(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = Drawn(monkeypatch)
    page, picture, film = (tmp_path / name for name in ("a.html", "a.png", "a.gif"))
    options = ("--from", "4", "--until", "0:09", "--camera", "above", "--of", "boat", "--dark", "--speed", "0.5")
    status, output = view(run, "--html", page, "--png", picture, "--gif", film, *options)
    assert status == 0
    assert drawn.calls == [
        ("page", (), {"from_s": 4.0, "to_s": 9.0, "view": "above", "at_s": None, "dark": True}),
        ("png", (6.5,), {"size": (1280, 720), "camera": "above", "vessel": "boat", "dark": True}),
        (
            "film",
            (4.0, 9.0),
            {"size": (640, 360), "speed": 0.5, "kind": "gif", "camera": "above", "vessel": "boat", "dark": True},
        ),
    ]
    assert page.read_text(encoding="utf-8") == "<!doctype html>ö"
    assert (picture.read_bytes(), film.read_bytes()) == (b"\x89PNG picture", b"GIF89a film")
    lines = output.splitlines()
    assert f"{page}: 0 kB, 5.0 s; opens in any browser" in lines
    assert f"{picture}: 0 kB, at 6.50 s" in lines
    assert f"{film}: 0 kB, 5.0 s at 0.5 ×" in lines
    assert any(line.startswith("note: ") and "has no scene" in line for line in lines)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.gif", "a.html", "a.png"]


@pytest.mark.medium
def test_a_picture_has_the_named_instant_and_size_and_a_webp_its_kind(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = Drawn(monkeypatch)
    status, _ = view(run, "--png", tmp_path / "a.png", "--gif", tmp_path / "a.WEBP", "--at", "1.5", "--size", "320x200")
    assert status == 0
    (_, at, png), (_, span, film) = drawn.calls
    assert (at, png["size"], png["vessel"], png["dark"], png["camera"]) == ((1.5,), (320, 200), None, False, "behind")
    assert (span, film["size"], film["kind"], film["speed"]) == ((None, None), (320, 200), "webp", 4.0)


@pytest.mark.parametrize("speed", ["0", "-1", "inf", "nan"])
def test_a_speed_is_above_zero(run: Path, speed: str) -> None:
    with pytest.raises(UserError, match=f"--speed {speed}: is not a speed"):
        view(run, f"--speed={speed}")


def test_the_older_option_of_the_end_is_still_read(run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = Drawn(monkeypatch)
    view(run, "--html", tmp_path / "a.html", "--to", "7")
    assert drawn.calls[0][2]["to_s"] == 7.0


@pytest.mark.parametrize(
    ("text", "size"), [(None, None), ("1280x720", (1280, 720)), (" 64X4096 ", (64, 4096)), ("1×99999", (1, 99999))]
)
def test_a_size_is_two_numbers(text: str | None, size: tuple[int, int] | None) -> None:
    assert _size(text) == size


@pytest.mark.parametrize("text", ["", "1280", "1280x", "x720", "1280x720x3", "123456x1", "1x123456", "-1x2", "a 1x2"])
def test_another_text_is_no_size(text: str) -> None:
    with pytest.raises(UserError, match=r"--size .*: is not a size; write it like 1280x720"):
        _size(text)


def test_a_file_of_another_kind_is_never_overwritten(tmp_path: Path) -> None:
    log = tmp_path / "run.mcap"
    log.write_bytes(b"\x89MCAP0")
    with pytest.raises(UserError, match="already exists and is another kind of file; choose another name"):
        _refuse_other(log, b"\x89PNG")
    for content in (b"", b"\x89PNG...", b"\x89png"):
        log.write_bytes(content)
        _refuse_other(log, b"\x89PNG")
    page = tmp_path / "a.html"
    page.write_bytes(b"<!DOCTYPE html>")
    _refuse_other(page, b"<!doctype")
    with pytest.raises(UserError, match="is a directory; name a file in it"):
        _refuse_other(tmp_path, b"GIF8")
    _refuse_other(tmp_path / "new.gif", b"GIF8")
    with pytest.raises(UserError, match="its folder does not exist"):
        _refuse_other(tmp_path / "none" / "new.gif", b"GIF8")
    with pytest.raises(UserError, match=r"cannot be written \(.+\); choose another place"):
        _refuse_other(tmp_path / ("x" * 300), b"GIF8")


def test_options_refuse_files_of_the_other_kinds_before_anything_is_drawn(
    run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = Drawn(monkeypatch)
    begins = {"--html": b"<!doctype html>", "--png": b"\x89PNG", "--gif": b"GIF89a"}
    for option in begins:
        for other in begins:
            file = tmp_path / "kept.gif"
            file.write_bytes(begins[other])
            if other != option:
                with pytest.raises(UserError, match="another kind of file"):
                    view(run, option, file)
                assert file.read_bytes() == begins[other]
    film = tmp_path / "kept.webp"
    film.write_bytes(b"GIF89a")
    with pytest.raises(UserError, match="another kind of file"):
        view(run, "--gif", film)
    assert drawn.calls == []


def test_a_file_is_written_completely_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    file = tmp_path / "a.png"
    file.write_bytes(b"before")
    replace = Path.replace

    def fail(path: Path, target: Path) -> Path:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "replace", fail)
    with pytest.raises(UserError, match=r"a.png: cannot be written \(No space left on device\); free space"):
        _write_whole(file, b"after")
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"]
    assert file.read_bytes() == b"before"
    monkeypatch.setattr(Path, "replace", replace)
    _write_whole(file, b"after")
    assert file.read_bytes() == b"after"


@pytest.mark.parametrize(("size", "text"), [(0, "0 kB"), (99_499, "99 kB"), (100_000, "0.1 MB"), (2_340_000, "2.3 MB")])
def test_sizes_of_files_are_decimal(tmp_path: Path, size: int, text: str) -> None:
    file = tmp_path / "file"
    file.write_bytes(bytes(size))
    assert _megabytes(file) == text


class Page:
    """Stands in for the served page; the user ends it after `found` is set."""

    made: Page

    def __init__(self, recording: Any, listener: Any, address: Any, **keys: Any) -> None:
        Page.made = self
        self.listener, self.address, self.keys = listener, address, keys
        self.found, self.closed = threading.Event(), False

    def find(self) -> None:
        self.found.set()
        raise RuntimeError("an analysis that fails does not end the page")

    def serve(self, ended: threading.Event) -> None:
        assert self.found.wait(10.0)
        assert not ended.is_set()
        signal.raise_signal(signal.SIGINT)
        assert ended.is_set()

    def close(self) -> None:
        self.closed = True
        self.listener.close()


@pytest.mark.parametrize(("words", "opens"), [((), True), (("--no-open", "--at", "3"), False)])
@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_recording_is_served_until_the_user_ends_it(
    run: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], opens: bool
) -> None:
    opened: list[str] = []
    monkeypatch.setattr(timeline, "RecordingPage", Page)
    monkeypatch.setattr(server, "has_desktop", lambda: True)
    monkeypatch.setattr(server, "open_browser", opened.append)
    status, output = view(run, *words)
    page = Page.made
    assert (status, page.closed) == (0, True)
    assert f"run.mcap: {page.address.url} (end with Ctrl+C)" in output
    assert opened == ([page.address.url] if opens else [])
    assert page.keys == {"at_s": 3.0 if words else None, "dark": False}


def test_no_browser_is_opened_without_a_desktop(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []
    monkeypatch.setattr(timeline, "RecordingPage", Page)
    monkeypatch.setattr(server, "has_desktop", lambda: False)
    monkeypatch.setattr(server, "open_browser", opened.append)
    assert view(run)[0] == 0
    assert opened == []


def test_a_missing_extra_is_told_before_a_log_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse() -> None:
        raise UserError("needs viser")

    monkeypatch.setattr(server, "check_view_extra", refuse)
    with pytest.raises(UserError, match="needs viser"):
        view(tmp_path / "none.mcap")
