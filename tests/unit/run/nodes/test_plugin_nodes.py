"""Nodes of other packages: keys in the profile, topics in the recording, and failures that name the plug-in."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tests.golden import Golden
from tests.installed_packages import Install
from xitl_cli.errors import UserError
from xitl_cli.logs import open_log
from xitl_cli.profile import ProfileError, load_profile, resolved_yaml
from xitl_cli.profile.load import recorded_profiles
from xitl_cli.record.recorder import Recorder
from xitl_cli.record.topics import Topic
from xitl_cli.run import session
from xitl_cli.run.nodes.display import NoDisplay

DEPTH = '''
from dataclasses import dataclass
from typing import Annotated
from sim_core.keys import NonNegative, Positive, Specification, SpecificationError
from xitl_cli.plugin import NodeKind
from xitl_cli.record.cdr import Float64
from xitl_cli.record.topics import Topic
from xitl_cli.run.core.node import RunNode

@dataclass(frozen=True, slots=True, kw_only=True)
class DepthKeys(Specification):
    """An echo sounder."""
    rate_hz: Annotated[Positive, "pings per second"] = 10.0
    noise_m: NonNegative = 0.1
    limit_m: Positive | None = None
    def check(self):
        if self.limit_m is not None and self.limit_m < self.noise_m:
            raise SpecificationError(("limit_m",), "is below noise_m; use a larger value")

@dataclass(frozen=True, slots=True)
class Depth:
    depth_m: Float64

class DepthNode(RunNode):
    def __init__(self, keys, context):
        self.keys, self.context, self.pings = keys, context, 0
        self.every = round(context.profile.clock.physics_rate_hz / keys.rate_hz)
    def begin(self, run):
        self.recorder = run.recorder
    def record(self, step):
        if step.number % self.every == 0:
            self.pings += 1
            bed = self.context.scenery.bed.bed_down_m(step.motion.pos_ned_m[:, :2])[0]
            self.recorder.write(step.now_ns, Depth(bed + self.keys.noise_m * self.context.rng.standard_normal()))
    def report(self):
        return {"pings": self.pings}

TOPIC = Topic("/depth", "depth_msgs/msg/Depth", "`plugins.depth.rate_hz`", "depth", Depth)
KIND = NodeKind(DepthKeys, DepthNode, (TOPIC,))
'''
FLEET = "extends: sitl\nvessels:\n  alpha: {}\n  beta: {mission: {start: {north_m: -20}}, plugins: {depth: null}}\n"


@pytest.fixture
def depth(install: Install, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    install("xitl-depth", DEPTH, nodes="depth = xitl_depth:KIND")


def write(text: str) -> str:
    Path("boat.yaml").write_text(text, encoding="utf-8")
    return "boat.yaml"


def run(text: str, out: str = "run") -> session.Result:
    return session.run(load_profile(write(text)), Path(out), False, NoDisplay, timed=True)


def failing(install: Install, method: str, line: str = "raise ZeroDivisionError('two\\nlines')") -> None:
    """A plug-in whose node raises in one method."""
    call = f"\nclass Broken(DepthNode):\n    def {method}(self, *arguments):\n        {line}\n"
    install(
        "xitl-broken",
        DEPTH + call + "KIND = NodeKind(DepthKeys, Broken, (TOPIC,))\n",
        nodes="broken = xitl_broken:KIND",
    )


@pytest.mark.medium
@pytest.mark.usefixtures("depth")
def test_the_keys_of_a_plug_in_are_checked_and_kept() -> None:
    profile = load_profile(write("extends: sitl\nplugins:\n  depth:\n    rate_hz: 5\n"))
    assert profile.plugins is not None
    assert (profile.plugins["depth"].rate_hz, profile.plugins["depth"].noise_m) == (5.0, 0.1)
    resolved = resolved_yaml(profile)
    assert "plugins:\n  depth:\n    rate_hz: 5.0\n    noise_m: 0.1\n    limit_m: null\n" in resolved
    Path("again.yaml").write_text(resolved, encoding="utf-8")
    assert load_profile("again.yaml") == profile
    assert load_profile("boat.yaml", ["plugins.depth.noise_m=0.5"]).plugins["depth"].noise_m == 0.5  # type: ignore[index]
    assert load_profile("boat.yaml", ["plugins.depth=null"]).plugins == {}


@pytest.mark.usefixtures("depth")
@pytest.mark.parametrize(
    "text",
    [
        "depth:\n    rat_hz: 5",
        "depth: {rate_hz: 0}",
        "depth: {noise_m: a}",
        "depth: {limit_m: 0.01}",
        "depth: 3",
        "sounder: {}",
    ],
)
def test_an_error_in_the_keys_has_file_line_key_and_fix(text: str, golden: Golden) -> None:
    with pytest.raises(ProfileError) as caught:
        load_profile(write(f"extends: sitl\nplugins:\n  {text}\n"))
    golden("problem", list(map(str, caught.value.problems)))


@pytest.mark.parametrize(
    ("code", "problem"),
    [
        ("import no_such_module", "cannot be loaded (ModuleNotFoundError: No module named 'no_such_module')"),
        ("KIND = 3", "registers int in xitl.nodes, which is not xitl_cli.plugin.NodeKind"),
        ("from xitl_cli.plugin import NodeKind\nKIND = NodeKind(int, int)", "whose keys are not a dataclass"),
    ],
)
def test_a_plug_in_that_cannot_be_used_is_one_problem_of_the_profile(
    install: Install, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: str, problem: str
) -> None:
    monkeypatch.chdir(tmp_path)
    install("xitl-depth", code, nodes="depth = xitl_depth:KIND")
    with pytest.raises(ProfileError) as caught:
        load_profile(write("extends: sitl\nplugins:\n  depth: {}\n"))
    (found,) = caught.value.problems
    assert str(found).startswith("boat.yaml:3: plugins.depth: the plug-in of xitl-depth 1.2 ")
    assert problem in str(found)


@pytest.mark.medium
@pytest.mark.usefixtures("depth")
def test_a_run_records_the_topic_of_a_plug_in_and_a_seed_repeats_it() -> None:
    text = "extends: sitl\nclock: {duration_s: 3}\nplugins: {depth: {rate_hz: 5}}\n"
    result = run(text)
    assert result.exit_code == 0
    assert result.summary["plugins"] == {"depth": {"pings": 15}}
    assert "plugins:\n  depth:\n    rate_hz: 5.0\n" in (result.directory / "profile.yaml").read_text()
    with result.open_log() as log:
        depth_m = log.tables["/depth"].values("depth_m")
    bed_m = load_profile("sitl").environment.water.depth_m  # type: ignore[union-attr]
    assert len(depth_m) == 15
    assert np.all(np.abs(depth_m - bed_m) < 6 * 0.1)
    assert np.std(depth_m) > 0.02
    with run(text, "again").open_log() as log:
        assert log.tables["/depth"].values("depth_m").tolist() == depth_m.tolist()


@pytest.mark.medium
@pytest.mark.usefixtures("depth")
def test_a_vessel_of_a_fleet_has_its_own_plug_ins() -> None:
    result = run(FLEET + "clock: {duration_s: 1}\nplugins: {depth: {}}\n")
    assert result.summary["vessels"]["alpha"]["plugins"] == {"depth": {"pings": 10}}
    assert "plugins" not in result.summary["vessels"]["beta"]
    with open_log(result.recording, None) as log:
        assert [name for name in log.tables if name.endswith("/depth")] == ["/alpha/depth"]
    again = load_profile(str(result.directory / "profile.yaml")).run_profiles()
    assert [list(profile.plugins) for profile in again] == [["depth"], []]


@pytest.mark.parametrize("fleet", [False, True])
def test_a_recorded_profile_is_read_without_the_plug_in(
    install: Install, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fleet: bool
) -> None:
    monkeypatch.chdir(tmp_path)
    install("xitl-depth", DEPTH, nodes="depth = xitl_depth:KIND")
    text = (FLEET if fleet else "extends: sitl\n") + "plugins: {depth: {}}\n"
    kept = resolved_yaml(load_profile(write(text))).replace("depth:\n", "gone:\n")
    assert "gone:" in kept
    names = [profile.vessel for profile in recorded_profiles(kept.encode())]
    assert names == (["alpha", "beta"] if fleet else [""])


@pytest.mark.medium
@pytest.mark.parametrize(
    ("method", "when"),
    [
        ("begin", "at the start"),
        ("sense", "at 0.00 s"),
        ("exchange", "at 0.02 s"),
        ("record", "at 0.0"),
        ("end", "at the end"),
    ],
)
def test_a_node_that_raises_ends_the_run_with_its_name_and_traceback(
    install: Install, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, method: str, when: str
) -> None:
    monkeypatch.chdir(tmp_path)
    failing(install, method)
    result = run("extends: sitl\nclock: {duration_s: 1}\nplugins: {broken: {}}\n")
    assert result.exit_code == session.USER_ERROR
    error = result.summary["error"]
    assert error.startswith(f"plugins.broken (xitl-broken 1.2) failed {when}")
    assert "(ZeroDivisionError: two lines, xitl_broken.py:" in error
    assert "\n" not in error
    assert result.summary["plugins"] == {"broken": None}
    with result.open_log() as log:
        messages = log.tables["/log"].values("message").tolist()
    if method != "end":  # after the loop the error is known to the summary alone
        assert messages[-1] == error
    (trace,) = [text for text in messages if text.startswith("Traceback")]
    assert f"in {method}" in trace
    assert trace.rstrip().endswith("ZeroDivisionError: two\nlines")


@pytest.mark.medium
def test_a_node_that_raises_ends_the_run_of_a_fleet_that_drifts_on(
    install: Install, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    failing(install, "exchange")
    text = "extends: sitl\nvessels:\n  alpha: {plugins: {broken: {}}}\n  beta: {mission: {start: {north_m: -20}}}\n"
    result = run(text + "clock: {duration_s: 1, on_loss: drift}\n")
    assert result.exit_code == session.USER_ERROR
    assert result.summary["error"].startswith("alpha: plugins.broken (xitl-broken 1.2) failed at 0.02 s")


@pytest.mark.medium
@pytest.mark.parametrize(
    ("method", "line", "when"),
    [
        ("close", "raise OSError('gone')", "when it was closed"),
        ("save", "raise OSError('gone')", "when it saved its files"),
        ("report", "raise OSError('gone')", "in its report"),
        ("report", "return {1: {2}}", "in its report"),
    ],
)
def test_a_failure_after_the_run_is_a_warning(
    install: Install, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, method: str, line: str, when: str
) -> None:
    monkeypatch.chdir(tmp_path)
    failing(install, method, line)
    result = run("extends: sitl\nclock: {duration_s: 0.1}\nplugins: {broken: {}}\n")
    assert result.exit_code == 0
    (warning,) = [text for text in result.summary["warnings"] if "plugins.broken" in text]
    assert when in warning
    assert json.loads((result.directory / "summary.json").read_text())["plugins"].keys() == {"broken"}


@pytest.mark.medium
@pytest.mark.parametrize(
    ("code", "error"),
    [
        ("KIND = NodeKind(DepthKeys, lambda keys, context: 1 / 0)", "failed when it was made \\(ZeroDivisionError"),
        ("KIND = NodeKind(DepthKeys, lambda keys, context: 3)", "returned int, which is not a RunNode"),
        (
            "KIND = NodeKind(DepthKeys, DepthNode, (Topic('/tasks', 'a_msgs/msg/A', '', '', Depth),))",
            "plugins.depth \\(xitl-depth 1.2\\): /tasks: xitl records a topic with this name",
        ),
        ("KIND = NodeKind(DepthKeys, DepthNode, (TOPIC, TOPIC))", "/depth: another plug-in records"),
    ],
)
def test_a_node_that_cannot_be_made_leaves_nothing_behind(
    install: Install, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: str, error: str
) -> None:
    monkeypatch.chdir(tmp_path)
    install("xitl-depth", f"{DEPTH}\n{code}\n", nodes="depth = xitl_depth:KIND")
    with pytest.raises(UserError, match=error):
        run("extends: sitl\nplugins: {depth: {}}\n")
    assert not Path("run").exists()


@pytest.mark.parametrize(
    ("topic", "error"),
    [
        (Topic("/truth/state", "a_msgs/msg/A", "", ""), "xitl records a topic with this name"),
        (Topic("/link/agent/tx", "a_msgs/msg/A", "", ""), "xitl records a topic with this name"),
        (Topic("radar", "foxglove.Log", "", ""), "is not the name of a topic"),
        (Topic("/radar", "foxglove.Nothing", "", ""), "foxglove.Nothing is no message of foxglove"),
        (Topic("/radar", "a_msgs/msg/A", "", "", Path), "its fields are not a dataclass"),
        (Topic("/radar", "a_msgs/msg/A", "", "", Topic), "Topic.name has no type of ROS 2"),
    ],
)
def test_the_recorder_refuses_a_topic_that_it_cannot_write(tmp_path: Path, topic: Topic, error: str) -> None:
    recorder = Recorder(tmp_path / "run.mcap", "none")
    with pytest.raises(UserError, match=error):
        recorder.add_topic(topic)
    recorder.close()


WATCH = """
from dataclasses import dataclass
from sim_core.keys import Specification
from xitl_cli.plugin import NodeKind
from xitl_cli.run.composition.parts import Place
from xitl_cli.run.core.node import RunNode
from xitl_cli.run.nodes.autopilot import AutopilotNode

@dataclass(frozen=True, slots=True, kw_only=True)
class Keys(Specification):
    pass

class Watch(RunNode):
    def __init__(self, keys, context):
        self.autopilot, self.heard_at_s = context.parts[AutopilotNode], None
    def exchange(self, step):
        if self.heard_at_s is None and self.autopilot.view.heard:
            self.heard_at_s = step.now_ns * 1e-9
    def report(self):
        return {"heard_at_s": self.heard_at_s}

KIND = NodeKind(Keys, Watch, needs=(AutopilotNode,), place=Place.AUTOPILOT_EVENTS)
"""


@pytest.mark.medium
def test_a_node_finds_another_node_that_it_needs(install: Install, depth: None) -> None:
    install("xitl-watch", WATCH, nodes="watch = xitl_watch:KIND")
    report = run("extends: sitl\nclock: {duration_s: 3}\nplugins: {watch: {}}\n").summary["plugins"]["watch"]
    assert 0.0 < report["heard_at_s"] < 3.0


@pytest.mark.medium
def test_a_run_without_the_node_that_a_plug_in_needs_is_refused(install: Install, depth: None) -> None:
    install("xitl-watch", WATCH, nodes="watch = xitl_watch:KIND")
    with pytest.raises(UserError, match=r"^plugins\.watch needs AutopilotNode, which no node of this run provides$"):
        run("extends: mitl\nclock: {duration_s: 1}\nplugins: {watch: {}}\n")


@pytest.mark.medium
def test_the_edges_of_a_plug_in_are_in_the_graph_of_the_run(install: Install, depth: None) -> None:
    install("xitl-watch", WATCH.replace("place=", 'edges=[("D", "M")], place='), nodes="watch = xitl_watch:KIND")
    graph = run("extends: sitl\nclock: {duration_s: 1}\nplugins: {watch: {}}\n").summary["graph"]
    assert "D-M" in graph["measured"]["links"]
    assert "D-M" in graph["unclaimed"]


@pytest.mark.medium
def test_an_edge_of_an_unknown_node_is_refused(install: Install, depth: None) -> None:
    install("xitl-watch", WATCH.replace("place=", 'edges=[("D", "GPS")], place='), nodes="watch = xitl_watch:KIND")
    with pytest.raises(UserError, match=r"^plugins\.watch \(xitl-watch .*\): its edges name GPS, which is not a node"):
        run("extends: sitl\nclock: {duration_s: 1}\nplugins: {watch: {}}\n")
