"""Bridges of other packages: a name of `autopilot.bridge.sensors`, and failures that name the package."""

from __future__ import annotations

import json
import re
import socket
import threading
import tomllib
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from agent.assembly import REFUSALS, assemble
from agent.bridges import kinds
from agent.options import Options
from agent.wire.memory import memory_pair
from tests.installed_packages import Install
from xitl_cli.errors import UserError
from xitl_cli.logs import open_log
from xitl_cli.profile import ProfileError, load_profile
from xitl_cli.run import session
from xitl_cli.run.nodes.display import NoDisplay

ROOT = Path(__file__).parents[4]
GUIDE = (ROOT / "docs/plugins.md").read_text(encoding="utf-8")
(LINES,) = (block for block in re.findall(r"```python\n(.*?)```", GUIDE, re.DOTALL) if "BridgeKind" in block)
(PROFILE,) = (block for block in re.findall(r"```yaml\n(.*?)```", GUIDE, re.DOTALL) if "sensors: lines" in block)
ENTRY = "lines = xitl_lines:KIND"


class TextAutopilot:
    """The autopilot of the guide: turns to starboard at half thrust."""

    def __init__(self) -> None:
        self.heard: list[bytes] = []
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self.port = self._socket.getsockname()[1]
        self._thread = threading.Thread(target=self._answer)
        self._thread.start()

    def _answer(self) -> None:
        while line := self._socket.recvfrom(200):
            data, sender = line
            if not data:
                return
            self.heard.append(data)
            self._socket.sendto(data.split()[0] + b" 0.5 0.0", sender)

    def close(self) -> None:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end:
            end.sendto(b"", ("127.0.0.1", self.port))
        self._thread.join()
        self._socket.close()


@pytest.fixture
def autopilot() -> Iterator[TextAutopilot]:
    double = TextAutopilot()
    yield double
    double.close()


@pytest.fixture
def boat(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, autopilot: TextAutopilot) -> Path:
    monkeypatch.chdir(tmp_path)
    path = Path("boat.yaml")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as silent:
        silent.bind(("127.0.0.1", 0))
        port = silent.getsockname()[1]
    path.write_text(PROFILE.replace(":9100", f":{autopilot.port}").replace(":14580", f":{port}"), encoding="utf-8")
    return path


def run(*overrides: str) -> session.Result:
    return session.run(load_profile("boat.yaml", list(overrides)), Path("run"), True, NoDisplay, timed=True)


@pytest.mark.medium
def test_the_bridge_of_the_guide_steers_the_vessel_and_is_counted(
    install: Install, boat: Path, autopilot: TextAutopilot
) -> None:
    install("xitl-lines", LINES, bridges=ENTRY)
    result = run("clock.duration_s=10.0")
    assert result.exit_code == 0, result.summary
    counts = result.summary["autopilot"]["bridge"]
    assert result.summary["autopilot"]["kind"] == "other"
    assert counts["imu_out"] > 0
    assert counts["imu_out"] <= len(autopilot.heard)
    assert counts["outputs_in"] > 0
    with result.open_log() as log:
        assert log.tables["/bridge"].values("imu_out")[-1] == counts["imu_out"]
        assert log.tables["/actuators"].values("command")[-1][0] == 0.5


@pytest.mark.medium
def test_an_autopilot_that_was_never_heard_is_not_in_the_graph_of_the_run(
    install: Install, boat: Path, autopilot: TextAutopilot
) -> None:
    install("xitl-lines", LINES, bridges=ENTRY)  # the text autopilot sends no heartbeat
    measured = run("clock.duration_s=3.0").summary["graph"]["measured"]
    assert [node["name"] for node in measured["nodes"]] == ["PS1", "M"]


@pytest.mark.medium
@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("self.counts.imu_out += 1", "self.counts.imu_out += 1; 1 / (now_ns < 10**9)"),
        ("return self.outputs", "return 1 / 0"),
        ("self.socket.settimeout(0.2)", "self.socket.settimeout(0.2); self.late = 0"),
    ],
)
def test_a_bridge_that_raises_ends_the_run_with_its_name_and_the_traceback(
    install: Install, boat: Path, before: str, after: str
) -> None:
    code = LINES.replace(before, after)
    if "late" in after:  # fails at the start of a run, not when the agent is assembled
        code = code.replace("self.sent_ns = self", "self.late += 1; 1 / (self.late < 2); self.sent_ns = self")
    install("xitl-lines", code, bridges=ENTRY)
    result = run("clock.duration_s=5.0")
    assert result.exit_code == session.USER_ERROR
    assert "autopilot.bridge.sensors: lines (xitl-lines 1.2) failed at " in result.summary["error"]
    assert "ZeroDivisionError: division by zero, xitl_lines.py:" in result.summary["error"]
    with open_log(Path("run/run.mcap")) as log:
        assert any("Traceback" in text for text in log.tables["/log"].values("message"))


def test_a_tap_that_raises_is_a_failure_of_the_bridge(install: Install) -> None:
    install("xitl-lines", LINES.replace("self.socket.settimeout(0.2)", "vehicle.add_tap(lambda m: 1 / 0)"))
    seen: list[str] = []

    class Vehicle:
        def add_tap(self, tap: object) -> None:
            self.tap = tap

    import xitl_lines  # type: ignore[import-not-found]

    from agent.bridges.guard import GuardedInjector
    from agent.timing.clock import MonotonicClock

    vehicle = Vehicle()
    guarded = GuardedInjector(xitl_lines.KIND, "lines", "xitl-lines 1.2", "udp://127.0.0.1:9", vehicle)  # type: ignore[arg-type]
    guarded.reset(MonotonicClock(), False, lambda severity, text: seen.append(text))
    vehicle.tap(None)  # type: ignore[operator]
    assert "Traceback" in seen[0]
    assert seen[1].startswith("the bridge of a package, lines (xitl-lines 1.2) failed at ")
    assert list(guarded.commands() or ()) == []
    guarded.close()


def test_a_bridge_that_cannot_be_closed_is_a_problem_with_its_innermost_line(
    install: Install, monkeypatch: pytest.MonkeyPatch
) -> None:
    install("xitl-lines", LINES)
    import xitl_lines

    from agent.bridges.guard import GuardedInjector

    guarded = GuardedInjector(xitl_lines.KIND, "lines", "xitl-lines 1.2", "udp://127.0.0.1:9", None)  # type: ignore[arg-type]
    (kind,) = {type(value) for value in vars(guarded).values() if type(value).__module__ == "xitl_lines"}
    close = kind.close
    monkeypatch.setattr(kind, "close", lambda self: (close(self), json.loads("[")))
    guarded.close()
    assert guarded.problem.startswith("lines (xitl-lines 1.2) failed when it was closed (JSONDecodeError: ")
    assert "decoder.py:" in guarded.problem


@pytest.mark.parametrize(
    ("code", "entry", "sentence"),
    [
        ("import no_such_module", ENTRY, r"xitl-lines 1\.2 cannot be loaded"),
        (LINES + "XITL_INTERFACE = 2\n", ENTRY, r"xitl-lines 1\.2 is made for interface 2"),
        (LINES, "lines = xitl_lines", r"registers module in xitl\.bridges, which is not agent\.bridges\.kinds\.Bridge"),
        (LINES, "lines = xitl_lines:OTHER", r"has no attribute 'OTHER'"),
    ],
)
def test_a_broken_bridge_is_one_sentence_of_the_profile(
    install: Install, boat: Path, code: str, entry: str, sentence: str
) -> None:
    install("xitl-lines", code, bridges=entry)
    with pytest.raises(
        ProfileError, match=rf"boat\.yaml:5: autopilot\.bridge\.sensors: lines: the plug-in of .*{sentence}"
    ):
        load_profile("boat.yaml")
    assert load_profile("sitl").name == "sitl"


def test_a_profile_needs_the_package_of_its_bridge(install: Install, boat: Path) -> None:
    with pytest.raises(ProfileError, match=r"sensors = 'lines' is not one of the choices; .*install the package that"):
        load_profile("boat.yaml")
    agent_end, _ = memory_pair("agent")
    options = Options(role="bridge", autopilot="udp://127.0.0.1:9", sensors="lines")
    with ExitStack() as opened, pytest.raises(REFUSALS, match=r"sensors: lines: no installed package registers it in"):
        assemble(agent_end, options, opened)


def test_two_packages_with_one_bridge(install: Install, boat: Path) -> None:
    install("xitl-b", "raise RuntimeError", bridges="lines = xitl_b:KIND")
    install("xitl-a", LINES, bridges="lines = xitl_a:KIND")
    load_profile("boat.yaml")
    assert kinds.package_of_bridge("lines") == "xitl-a 1.2"
    install("xitl-c", "raise RuntimeError", bridges="px4 = xitl_c:KIND")
    assert kinds.bridge_kind("px4") is kinds.PX4


@pytest.mark.medium
def test_a_bridge_that_cannot_be_opened_is_refused_before_the_run(install: Install, boat: Path) -> None:
    install("xitl-lines", LINES.replace("self.socket = ", "1 / 0; self.socket = "), bridges=ENTRY)
    with pytest.raises(UserError, match=r"lines \(xitl-lines 1\.2\) failed when it was opened \(ZeroDivisionError"):
        run("clock.duration_s=1.0")


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ("autopilot.kind=ardupilot", "does not work with autopilot.kind = ardupilot; use it with other"),
        ("autopilot.bridge.sensor_link=null", "autopilot.bridge.sensor_link is missing: lines needs a separate line"),
        ("autopilot.bridge.world=udp://127.0.0.1:9002", "lines sets the autopilot's time itself; remove it"),
        ("autopilot.firmware=find", "xitl starts ArduPilot and PX4 only; start this autopilot elsewhere"),
    ],
)
def test_keys_that_do_not_fit_the_bridge(install: Install, boat: Path, change: str, sentence: str) -> None:
    install("xitl-lines", LINES, bridges=ENTRY)
    with pytest.raises(ProfileError, match=re.escape(sentence)):
        load_profile("boat.yaml", [change])


def test_xitl_registers_its_own_bridges_in_the_same_group() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    entries = project["entry-points"][kinds.GROUP]
    objects = {name: getattr(kinds, target.removeprefix("agent.bridges.kinds:")) for name, target in entries.items()}
    assert objects == kinds.OWN_SENSORS
