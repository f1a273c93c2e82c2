"""`xitl board …`: what each command does with a board, and what it prints. No emulator runs here."""

from __future__ import annotations

import gzip
import json
import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from typer.testing import CliRunner

from tests.command_line import xitl_app
from xitl_cli.errors import UserError
from xitl_cli.plugins.board import autopilot, command, emulator, four_ways, image, life, plugin, recipe
from xitl_cli.plugins.board.places import NAMESPACE, EmulatedBoard, board_names, the_board, write_record


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XITL_CACHE", str(tmp_path))
    return tmp_path


def make(name: str, port: int = 14700, **keys: Any) -> EmulatedBoard:
    made = EmulatedBoard(name, "bookworm", recipe.recipe_version(), 1, 512, port, **keys)
    made.folder.mkdir(parents=True)
    write_record(made)
    return made


@pytest.fixture
def board() -> EmulatedBoard:
    return make("boat")


def typed(*words: str) -> list[str]:
    """The lines that a command prints."""
    arguments = ["board", *words]
    result = CliRunner().invoke(xitl_app(arguments), arguments, catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return [line.rstrip() for line in result.output.splitlines()]


def test_a_new_board_is_described_and_its_progress_told_once(monkeypatch: pytest.MonkeyPatch) -> None:
    def create(name: str, *given: Any) -> EmulatedBoard:
        *options, tell = given
        assert options == ["bullseye", 2, 768, 15000, "http://a"]
        for text in ("package 1 of 3", "package 2 of 3", "done", "1 s  booting"):
            tell(text)
        return replace(make(name, 15000), suite="bullseye", cores=2, memory_mib=768)

    monkeypatch.setattr(life, "create", create)
    options = ("--suite", "bullseye", "--cores", "2", "--memory", "768", "--port", "15000", "--mirror", "http://a")
    assert typed("create", "raft", *options) == [
        "package 1 of 3",
        "done",
        "raft: Debian bullseye for ARMv7, 2 × Cortex-A15, 768 MiB",
        "start it with: xitl board start raft",
    ]


@pytest.mark.parametrize(("took_s", "said"), [(None, "boat: runs already"), (61.6, "boat: up after 62 s")])
def test_a_started_board_is_told_with_the_commands_that_use_it(
    board: EmulatedBoard, monkeypatch: pytest.MonkeyPatch, took_s: float | None, said: str
) -> None:
    asked: list[tuple[Any, ...]] = []
    monkeypatch.setattr(life, "start", lambda *given: (asked.append(given[:4]), (board, took_s))[1])
    lines = typed("start", "boat", "--network", "forwarded", "--timeout", "9")
    assert asked == [("boat", None, "forwarded", 9.0)]
    assert lines[0] == said
    assert lines[1] == "  address    127.0.0.1, ssh port 14700; 192.168.7.2 in its own network"
    assert lines[2] == "  log in     xitl board ssh boat"
    assert lines[4] == "  sail       xitl sim --profile hitl-virtual-board"
    assert lines[-1] == "  stop       xitl board stop boat"


@pytest.mark.parametrize(
    ("words", "runs", "shuts_down", "said"),
    [
        ((), False, True, "does not run"),
        ((), True, True, "shut down"),
        ((), True, False, "did not shut down by itself, so its power was cut"),
        (("--cut",), True, True, "power cut"),
        (("--cut",), False, True, "does not run"),
    ],
)
def test_a_board_is_stopped_or_its_power_cut(
    board: EmulatedBoard,
    monkeypatch: pytest.MonkeyPatch,
    words: tuple[str, ...],
    runs: bool,
    shuts_down: bool,
    said: str,
) -> None:
    did: list[str] = []
    monkeypatch.setattr(emulator, "running", lambda board: 7 if runs else None)
    monkeypatch.setattr(emulator, "cut_power", lambda board: did.append("cut"))
    monkeypatch.setattr(emulator, "shut_down", lambda board: (did.append("shut down"), shuts_down)[1])
    assert typed("stop", "boat", *words) == [f"boat: {said}"]
    assert did == ([] if not runs else ["cut"] if words else ["shut down"])


def test_an_autopilot_is_put_on_a_running_board(
    board: EmulatedBoard, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    given: list[Any] = []
    monkeypatch.setattr(emulator, "the_running_board", lambda name: board)
    monkeypatch.setattr(autopilot, "put_autopilot", lambda *all_of_it: given.append(all_of_it))
    lines = typed("put", "boat", "ardurover")
    assert given == [(board, Path("ardurover"), "hitl-ardupilot-linux")]
    assert lines[0] == "boat: ardurover.service starts now and at each boot, and waits for the agent"
    assert "xitl agent deploy board:boat --service --config agent.conf" in lines[1]


def test_what_is_sent_to_a_board_goes_over_its_ssh_and_a_failure_is_told(
    board: EmulatedBoard, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran: list[tuple[list[str], bytes]] = []
    answers = iter([(0, b"", b""), (1, b"", b"no \n space"), (1, b"said", b""), (3, b"", b"")])

    def run(words: list[str], **keys: Any) -> Any:
        ran.append((words, keys["input"]))
        code, out, error = next(answers)
        return SimpleNamespace(returncode=code, stdout=out, stderr=error)

    monkeypatch.setattr(autopilot, "subprocess", SimpleNamespace(run=run))
    autopilot._send(board, "cat > /x", b"content")
    assert ran == [(["ssh", "-F", str(board.ssh_config), "boat", "cat > /x"], b"content")]
    for reason in ("no space", "said", "exit code 3"):
        with pytest.raises(UserError, match=f"^boat: {reason}; see: xitl board ssh boat$"):
            autopilot._send(board, "cat > /x", b"")


def test_a_program_that_cannot_be_read_is_told(board: EmulatedBoard, tmp_path: Path) -> None:
    with pytest.raises(UserError, match=r"none: cannot be read \(No such file or directory\); check the path"):
        autopilot.put_autopilot(board, tmp_path / "none", "hitl-ardupilot-linux")


@pytest.mark.parametrize(
    ("verb", "context", "said"),
    [("pause", "stopped", "was stopped for 2.5 s"), ("unplug", "unplugged", "had no network for 2.5 s")],
)
def test_a_board_is_paused_or_unplugged_for_its_seconds(
    board: EmulatedBoard, monkeypatch: pytest.MonkeyPatch, verb: str, context: str, said: str
) -> None:
    did: list[Any] = []

    @contextmanager
    def meanwhile(chosen: EmulatedBoard) -> Iterator[None]:
        did.append(chosen)
        yield
        did.append("over")

    monkeypatch.setattr(emulator, "the_running_board", lambda name: board)
    monkeypatch.setattr(emulator, context, meanwhile)
    monkeypatch.setattr(command, "time", SimpleNamespace(sleep=did.append))
    assert typed(verb, "boat", "--for", "2.5") == [f"boat: {said}"]
    assert did == [board, 2.5, "over"]


def test_all_boards_are_listed_with_state_and_addresses(monkeypatch: pytest.MonkeyPatch) -> None:
    assert typed("list") == ["no board yet; make one: xitl board create virtual"]
    boat, raft = make("boat", 14710), make("raft", network=NAMESPACE)
    boat.disk.write_bytes(os.urandom(3 << 20))
    monkeypatch.setattr(emulator, "running", lambda board: 7 if board.name == "raft" else None)
    lines = [line.split() for line in typed("list")]
    assert lines[-2][:6] == ["boat", "off", "bookworm", "1", "512", "MiB"]
    assert "127.0.0.1:14710–14713" in lines[-2]
    assert lines[-2][-2:] == ["3", "MiB"]
    assert lines[-1][:3] == ["raft", "runs", "bookworm"]
    assert "192.168.7.2," in lines[-1]
    rows = json.loads("\n".join(typed("list", "--json")))["boards"]
    assert rows[0] == {
        "name": "boat",
        "suite": "bookworm",
        "cores": 1,
        "memory_mib": 512,
        "running": False,
        "network": "forwarded",
        "ssh": "127.0.0.1:14710",
        "autopilot": "127.0.0.1:14711",
        "companion": "127.0.0.1:14712",
        "mavlink": "127.0.0.1:14713",
        "serial": str(boat.serial),
        "folder": str(boat.folder),
    }
    assert (rows[1]["running"], rows[1]["mavlink"]) == (True, "192.168.7.2:5762")
    assert rows[1]["folder"] == str(raft.folder)


def test_the_console_of_a_running_board_is_attached(board: EmulatedBoard, monkeypatch: pytest.MonkeyPatch) -> None:
    attached: list[Any] = []
    monkeypatch.setattr(emulator, "the_running_board", lambda name: board)
    monkeypatch.setattr(emulator, "attach", lambda *given: attached.append(given))
    assert typed("console", "boat") == ["console of boat; leave with Ctrl-]"]
    assert attached == [(board.folder / "console.sock", board.console)]


def test_a_removed_board_takes_the_images_that_no_board_uses(board: EmulatedBoard, cache: Path) -> None:
    make("raft", 14710)
    images = image.images_root()
    used, unused = images / f"bookworm-{recipe.recipe_version()}", images / "bullseye-00000000"
    for folder in (used, unused):
        folder.mkdir(parents=True)
    (images / "bookworm.lock").write_text("")
    assert typed("remove", "boat") == [f"removed {board.folder}"]
    assert board_names() == ["raft"]
    assert unused.exists()
    lines = typed("remove", "raft", "--images")
    assert lines == [f"removed {cache / 'boards/raft'}", f"removed {used}", f"removed {unused}"]
    assert [path.name for path in images.iterdir()] == ["bookworm.lock"]


def test_an_image_that_another_board_uses_stays(board: EmulatedBoard) -> None:
    make("raft", 14710)
    used = image.images_root() / f"bookworm-{recipe.recipe_version()}"
    used.mkdir(parents=True)
    assert typed("remove", "boat", "--images") == [f"removed {board.folder}"]
    assert used.exists()


class Compared:
    """Stands in for the runs of the comparison."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *completed: bool) -> None:
        self.setup: Any = None
        self.pages: list[Any] = []
        self._sailed = [
            SimpleNamespace(title=f"way {number}", summary={"mission": {"completed": done}})
            for number, done in enumerate(completed)
        ]
        monkeypatch.setattr(four_ways, "ways", lambda name, real: iter([name, real]))
        monkeypatch.setattr(four_ways, "sail", self._sail)
        monkeypatch.setattr(four_ways, "table", lambda sailed: [["waypoints", *("6 of 6" for _ in sailed)]])
        monkeypatch.setattr(four_ways, "write_page", lambda sailed, path: self.pages.append((sailed, path)))

    def _sail(self, setup: Any, chosen: list[Any]) -> list[Any]:
        self.setup, self.chosen = setup, chosen
        return self._sailed


@pytest.mark.parametrize(("completed", "status"), [((True, True), 0), ((True, False), 1), ((False, True), 1)])
def test_a_comparison_fails_if_a_mission_was_not_completed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, completed: tuple[bool, ...], status: int
) -> None:
    compared = Compared(monkeypatch, *completed)
    arguments = ["board", "compare", "boat", "--board", "udp://x:1", "--seed", "4", "--duration", "20"]
    arguments += ["--out", str(tmp_path / "out")]
    result = CliRunner().invoke(xitl_app(arguments), arguments)
    assert result.exit_code == status
    assert compared.chosen == ["boat", "udp://x:1"]
    assert (compared.setup.seed, compared.setup.duration_s) == (4, 20.0)
    page = tmp_path / "out" / four_ways.PAGE
    assert [path for _, path in compared.pages] == [page]
    lines = result.output.splitlines()
    assert lines[-1] == str(page)
    assert any("way 0" in line and "way 1" in line for line in lines)
    assert any(line.count("6 of 6") == 2 for line in lines)


def test_the_same_mission_is_sailed_in_each_way_and_compared_with_the_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran: list[tuple[Any, ...]] = []
    told: list[str] = []

    def run_profile(*given: Any) -> Any:
        ran.append(given)
        return SimpleNamespace(recording=Path(f"{len(ran)}.mcap"), summary={"number": len(ran)})

    setup: Any = SimpleNamespace(seed=3, duration_s=9.0, tell=told.append, run_profile=run_profile)

    @contextmanager
    def opened(path: Path) -> Iterator[Path]:
        yield path

    facts = [SimpleNamespace(key="path_rms_m", value=0.5), SimpleNamespace(key="path_max_m", value=2.0)]
    compared: list[tuple[Path, Path]] = []

    def compare(a: Path, b: Path, of_a: str, of_b: str) -> Any:
        compared.append((a, b))
        assert (of_a, of_b) == ("truth", "truth")
        if b == Path("3.mcap"):
            raise four_ways.LogError("too short")
        return SimpleNamespace(sections=[SimpleNamespace(facts=facts)])

    monkeypatch.setattr(four_ways, "open_log", opened)
    monkeypatch.setattr(four_ways, "true_path_ne_m", lambda log: f"path of {log}")
    monkeypatch.setattr(four_ways, "compare", compare)
    chosen = [four_ways.Way("in process", "sitl"), four_ways.Way("loopback", "hitl", "a: 1\n"), four_ways.Way("c", "d")]
    sailed = four_ways.sail(setup, chosen)
    assert told == ["in process: sitl", "loopback: hitl", "c: d"]
    assert [given[0] for given in ran] == ["1-in-process", "2-loopback", "3-c"]
    assert ran[1][1] == "# loopback\nextends: hitl\ndescription: The same mission, loopback\na: 1\n"
    assert all(given[2] == {"clock.seed": 3, "clock.duration_s": 9.0} for given in ran)
    assert compared == [(Path("1.mcap"), Path("2.mcap")), (Path("1.mcap"), Path("3.mcap"))]
    assert [way.off_path_m for way in sailed] == [(None, None), (0.5, 2.0), (None, None)]
    assert [way.summary for way in sailed] == [{"number": number} for number in (1, 2, 3)]
    assert sailed[0].path_ne_m == "path of 1.mcap"


# -- making a board


def test_a_new_board_has_its_own_keys_name_and_disk(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = cache / "image"
    folder.mkdir()
    (folder / "early.cpio.gz").write_bytes(gzip.compress(b"early"))
    made_image = image.BoardImage(folder, "bookworm", "1234", "6.1", 9)
    make("boat")
    ran: list[list[str]] = []

    def run(words: list[str], *given: Any) -> str:
        ran.append(words)
        file = Path(words[words.index("-f") + 1])
        file.write_text(f"private {file.name}")
        Path(f"{file}.pub").write_text(f"ssh-ed25519 {file.name} comment")
        return ""

    overlays: list[tuple[Any, ...]] = []
    told: list[str] = []
    monkeypatch.setattr(life, "require", lambda programs: None)
    monkeypatch.setattr(life, "make_image", lambda suite, mirror, progress: made_image)
    monkeypatch.setattr(life, "make_overlay", lambda *given: overlays.append(given))
    monkeypatch.setattr(life, "checked_run", run)
    board = life.create("raft", "bookworm", 2, 768, None, None, told.append)
    assert board == the_board("raft") == EmulatedBoard("raft", "bookworm", "1234", 2, 768, 14710)
    assert told == ["making keys and disk"]
    assert overlays == [(board.disk, made_image.disk, "qcow2")]
    assert stat.S_IMODE(board.folder.stat().st_mode) == 0o700
    assert [words[words.index("-C") + 1] for words in ran] == ["xitl board raft", "raft"]
    assert stat.S_IMODE((board.folder / life.LOGIN_KEY).stat().st_mode) == 0o600
    early = gzip.decompress(board.early.read_bytes())
    assert early.startswith(b"early")
    for text in (b"seed/etc/hostname\0", b"raft\n", b"private ssh_host_ed25519_key", b"ssh-ed25519 id_ed25519 comment"):
        assert text in early
    assert b"private id_ed25519" not in early  # the key that logs in stays on this machine
    life.make_keys(board.folder, "raft")
    assert len(ran) == 2  # both are there
    assert life.create("ship", "bookworm", 1, 512, 15000, None, told.append).port == 15000


def test_ports_end(monkeypatch: pytest.MonkeyPatch) -> None:
    for number, port in enumerate(range(14700, 14991, 10)):
        assert life._free_ports() == port
        make(f"b{number}", port)
    with pytest.raises(UserError, match="all ports for boards are taken"):
        life._free_ports()


def test_the_files_of_a_board_are_readable_as_ssh_wants_them(board: EmulatedBoard) -> None:
    for key in (life.LOGIN_KEY, life.HOST_KEY):
        (board.folder / key).write_text(f"private {key}")
        (board.folder / f"{key}.pub").write_text(f"public {key}")
    assert life.seed_files(board) == {
        "etc/hostname": (0o644, b"boat\n"),
        "etc/hosts": (0o644, b"127.0.0.1 localhost boat\n"),
        "etc/ssh/ssh_host_ed25519_key": (0o600, b"private ssh_host_ed25519_key"),
        "etc/ssh/ssh_host_ed25519_key.pub": (0o644, b"public ssh_host_ed25519_key"),
        "root/.ssh/authorized_keys": (0o600, b"public id_ed25519"),
    }


def test_an_agent_is_deployed_to_a_running_board_over_its_ssh(
    board: EmulatedBoard, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(emulator, "running", lambda board: 7)
    other = tmp_path / "config"
    for file in (board.ssh_config, other):
        file.write_text("")
    reached = plugin.running_board("boat", None, None, None)
    assert (reached.destination, reached.config) == ("boat", board.ssh_config)
    assert plugin.running_board("boat", 22, None, other).config == other


def test_boards_are_refused_on_windows(monkeypatch: pytest.MonkeyPatch) -> None:
    plugin.refuse_windows()
    monkeypatch.setattr(plugin, "os", SimpleNamespace(name="nt"))
    with pytest.raises(UserError, match="an emulated board needs Linux; use WSL"):
        plugin.refuse_windows()
