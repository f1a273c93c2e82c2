"""Live outputs of other packages: a name of `live.outputs` or `--live`, keys below `plugins`, and failures by name."""

from __future__ import annotations

import re
import socket
from pathlib import Path

import pytest

from tests.installed_packages import Install
from xitl_cli.commands.sim import live_options
from xitl_cli.errors import UserError
from xitl_cli.logs import open_log
from xitl_cli.profile import ProfileError, load_profile
from xitl_cli.run import session
from xitl_cli.run.nodes.display import NoDisplay

GUIDE = (Path(__file__).parents[4] / "docs/plugins.md").read_text(encoding="utf-8")
(BEACON,) = (block for block in re.findall(r"```python\n(.*?)```", GUIDE, re.DOTALL) if "LiveOutputKind" in block)
(PROFILE,) = (block for block in re.findall(r"```yaml\n(.*?)```", GUIDE, re.DOTALL) if "beacon" in block)
ENTRY = "beacon = xitl_beacon:KIND"
MIRROR = """
class Mirror:
    def open_channel(self, topic, *described):
        SHOW
class Watch(RunNode):
    def mirror(self):
        return Mirror()
class MirrorOutput(LiveOutput):
    def world_nodes(self, run):
        return [Watch()]
def bare(profiles):
    return MirrorOutput()
"""


@pytest.fixture
def boat(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("boat.yaml").write_text("extends: mitl\n" + PROFILE, encoding="utf-8")
    return Path("boat.yaml")


def run(*overrides: str) -> session.Result:
    return session.run(load_profile("boat.yaml", list(overrides)), Path("run"), True, NoDisplay, timed=True)


@pytest.mark.medium
def test_the_output_of_the_guide_reports_positions(install: Install, boat: Path) -> None:
    install("xitl-beacon", BEACON, live_outputs=ENTRY)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.settimeout(5.0)
        result = run("clock.duration_s=1", f"plugins.beacon.port={listener.getsockname()[1]}")
        name, north_m, east_m = listener.recv(100).split()
    assert result.exit_code == 0
    assert name == b"boat"
    assert float(north_m) < 1000 > float(east_m)
    assert result.summary["plugins"]["beacon"] == {"sent": 50}


@pytest.mark.medium
def test_a_plain_function_without_keys_is_an_output_too(install: Install, boat: Path) -> None:
    code = BEACON + MIRROR.replace("SHOW", "return None")
    install("xitl-beacon", code, live_outputs="beacon = xitl_beacon:bare")
    boat.write_text("extends: mitl\nlive: {outputs: [beacon]}\n", encoding="utf-8")
    profile = load_profile("boat.yaml").runnable()
    assert not profile.live.streams_foxglove
    assert run("clock.duration_s=1").exit_code == 0
    with pytest.raises(ProfileError, match=r"plugins\.beacon: the live output of xitl-beacon 1\.2 has no keys"):
        load_profile("boat.yaml", ["plugins.beacon.port=1"])


@pytest.mark.medium
@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("self.sent += 1", "1 / 0"),
        ("        self.socket = socket", "        1 / 0; self.socket = socket"),
        ("self.keys = keys", "1 / 0"),
    ],
)
def test_an_output_that_raises_ends_the_run_with_its_name(
    install: Install, boat: Path, before: str, after: str
) -> None:
    install("xitl-beacon", BEACON.replace(before, after), live_outputs=ENTRY)
    if before == "self.sent += 1":
        result = run("clock.duration_s=1")
        assert result.exit_code == session.USER_ERROR
        error = result.summary["error"]
        with open_log(Path("run/run.mcap")) as log:
            assert any("Traceback" in text for text in log.tables["/log"].values("message"))
    else:
        with pytest.raises(UserError) as caught:
            run("clock.duration_s=1")
        error = str(caught.value)
    assert re.search(r"live\.outputs beacon \(xitl-beacon 1\.2\) failed .*ZeroDivisionError", error)


@pytest.mark.medium
@pytest.mark.parametrize("show", ["1 / 0", "return lambda payload, stamp_ns: 1 / 0"])
def test_a_mirror_that_raises_ends_the_run_and_leaves_the_recording_whole(
    install: Install, boat: Path, show: str
) -> None:
    code = BEACON + MIRROR.replace("SHOW", show)
    install("xitl-beacon", code, live_outputs="beacon = xitl_beacon:bare")
    boat.write_text("extends: mitl\nlive: {outputs: [beacon]}\n", encoding="utf-8")
    result = run("clock.duration_s=1")
    assert result.exit_code == session.USER_ERROR
    assert "live.outputs beacon (xitl-beacon 1.2) failed at 0.0" in result.summary["error"]
    with open_log(Path("run/run.mcap")) as log:
        assert not log.health.degraded
        assert any("Traceback" in text for text in log.tables["/log"].values("message"))


@pytest.mark.medium
def test_a_profile_needs_the_package_of_its_output(install: Install, boat: Path) -> None:
    boat.write_text("extends: mitl\nlive: {outputs: [beacon]}\n", encoding="utf-8")
    with pytest.raises(ProfileError, match=r"live\.outputs\.0 = 'beacon' is not one of the choices; .*install the"):
        load_profile("boat.yaml")
    with pytest.raises(ProfileError, match=r"live\.outputs\.0 = 'ros' is not one of the choices"):
        load_profile("mitl", ["live.outputs=[ros]"])
    install("xitl-beacon", "import no_such_module", live_outputs=ENTRY)
    with pytest.raises(UserError, match=r"beacon: the plug-in of xitl-beacon 1\.2 cannot be loaded"):
        run("clock.duration_s=1")
    assert not Path("run").exists()


def test_options_of_the_command(install: Install) -> None:
    install("xitl-beacon", BEACON, live_outputs=ENTRY)
    assert live_options(None, None, False) == {}
    assert live_options(["foxglove"], 9000, False) == {
        "live.foxglove": True, "live.port": 9000, "live.commands": None,
    }  # fmt: skip
    assert live_options(["beacon"], None, False) == {"live.outputs": "[beacon]"}
    both = load_profile("mitl", [f"{key}={value}" for key, value in live_options(["beacon"], None, False).items()])
    assert both.live is not None
    assert both.live.outputs == ("beacon",)
    assert live_options(["beacon", "foxglove"], None, True) == {
        "live.outputs": "[beacon]", "live.foxglove": True, "live.port": None, "live.commands": True,
    }  # fmt: skip
    for unknown in ("view", "lighthouse"):
        with pytest.raises(UserError, match=f"--live {unknown} is unknown; use --live foxglove, or --view"):
            live_options([unknown], None, False)


def test_the_group_alone_streams_to_foxglove() -> None:
    group = load_profile("mitl", ["live.port=9000"]).live
    assert group is not None
    assert group.streams_foxglove
