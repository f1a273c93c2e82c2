"""Campaigns as they are typed: what is killed is survived, what misbehaves is told, and the table stays the same."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from conftest import environment, payloads

from tests.golden import Golden
from tests.patience import wait_until
from xitl_cli.plugins.campaign.results import CAMPAIGN, LINES, NOT_COMPARED, ResultTable
from xitl_cli.plugins.campaign.warden import MARK

distributed = pytest.importorskip("distributed")
pytestmark = pytest.mark.slow

ENOUGH_S = 240.0
SHORT = "extends: mitl\nclock: {duration_s: 0.4}\nrecording: {scene: false}\n"
PLAN = """
base: short.yaml
axes: {environment.wind.mean_mps: [0, 6]}
seeds: 1-2
verdicts: [mission.cross_track_rms_m < 0.2, duration_s > 0.3]
recordings: failures
"""
RUNS = 4
Process = subprocess.Popen[str]


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("short.yaml").write_text(SHORT, encoding="utf-8")
    Path("plan.yaml").write_text(PLAN, encoding="utf-8")
    return tmp_path


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-m", "xitl_cli.main", "campaign", *arguments]


@contextmanager
def begun(words: Sequence[str]) -> Iterator[Process]:
    process = subprocess.Popen(
        words, env=environment(), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def campaign(*arguments: str, code: int = 0) -> str:
    """What it prints on both streams."""
    told = subprocess.run(
        command(*arguments), env=environment(), capture_output=True, text=True, timeout=ENOUGH_S, check=False
    )
    assert told.returncode == code, told.stdout + told.stderr
    assert "Traceback" not in told.stderr
    return told.stdout + told.stderr


def wait_for(condition: Callable[[], Any]) -> Any:
    return wait_until(condition, patience_s=ENOUGH_S)


def rows_in(folder: str) -> int:
    path = Path(folder) / LINES
    return path.read_bytes().count(b"\n") if path.exists() else 0


def compared(folder: str) -> list[dict[str, Any]]:
    rows = ResultTable.read(Path(folder)).rows
    return [{key: value for key, value in row.items() if key not in NOT_COMPARED} for row in rows]


def parent_of(pid: int) -> int:
    try:
        return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])
    except OSError:
        return 0


def below(pid: int, words: str) -> list[int]:
    """Processes whose parent it is and whose command line holds these words."""
    found = []
    for one in map(int, filter(str.isdigit, (one.name for one in Path("/proc").iterdir()))):
        try:
            line = Path(f"/proc/{one}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
        except OSError:
            continue
        if words in line and parent_of(one) == pid:
            found.append(one)
    return found


def workers_of(pid: int) -> list[int]:
    return below(pid, "xitl_cli.plugins.campaign.cluster")


def runs_in(folder: Path) -> list[int]:
    """Runs under way of campaigns in a folder, and all that they have started."""
    found = []
    for one in map(int, filter(str.isdigit, (one.name for one in Path("/proc").iterdir()))):
        try:
            marked = f"{MARK}=".encode() in Path(f"/proc/{one}/environ").read_bytes()
            if marked and Path(f"/proc/{one}/cwd").resolve() == folder:
                found.append(one)
        except OSError:
            continue
    return found


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> list[dict[str, Any]]:
    """The table of the plan by one worker."""
    folder = tmp_path_factory.mktemp("undisturbed")
    (folder / "short.yaml").write_text(SHORT, encoding="utf-8")
    (folder / "plan.yaml").write_text(PLAN, encoding="utf-8")
    words = command("plan.yaml", "--workers", "1", "--out", "out")
    subprocess.run(words, cwd=folder, env=environment(), capture_output=True, timeout=ENOUGH_S, check=False)
    return compared(str(folder / "out"))


def test_a_plan_from_the_command_line(undisturbed: list[dict[str, Any]]) -> None:
    told = campaign("plan.yaml", "--workers", "2", "--out", "out", "--json", code=0)
    document = json.loads(told[: told.rindex("\n}") + 2])
    assert document["complete"] is True
    assert document["runs"] == document["statuses"]["incomplete"] == RUNS
    assert document["verdicts"][-1]["low"] < 1.0 <= document["verdicts"][-1]["high"]
    assert compared("out") == undisturbed
    assert len({row["mission.cross_track_rms_m"] for row in undisturbed}) == RUNS  # seeds and winds do something
    parquet = pytest.importorskip("pyarrow.parquet")
    assert parquet.read_table("out/results.parquet")["number"].to_pylist() == list(range(1, RUNS + 1))
    assert "already contains a campaign" in campaign("plan.yaml", "--out", "out", code=2)
    assert campaign("plan.yaml", "--out", "out", "--resume").count(f"{RUNS} of {RUNS}") >= 1
    assert rows_in("out") == RUNS


@pytest.mark.nightly
def test_a_client_that_is_killed_is_resumed_and_leaves_no_run(
    undisturbed: list[dict[str, Any]], tmp_path: Path
) -> None:
    with begun(command("plan.yaml", "--workers", "2", "--out", "out")) as client:
        wait_for(lambda: rows_in("out") >= 2 and runs_in(tmp_path))
        client.kill()
        wait_for(lambda: not runs_in(tmp_path))
    before = rows_in("out")
    assert 2 <= before < RUNS
    campaign("plan.yaml", "--resume", "--out", "out")
    assert compared("out") == undisturbed
    assert rows_in("out") == RUNS


def killed(process: int) -> bool:
    """Kill a process; False when it has ended by itself."""
    try:
        os.kill(process, signal.SIGKILL)
    except ProcessLookupError:
        return False
    return True


@pytest.mark.nightly
def test_workers_and_runs_that_are_killed_change_nothing(undisturbed: list[dict[str, Any]], tmp_path: Path) -> None:
    with begun(command("plan.yaml", "--workers", "2", "--out", "out")) as client:
        wait_for(lambda: rows_in("out") >= 1 and runs_in(tmp_path))
        first = wait_for(lambda: workers_of(client.pid))[0]
        os.kill(first, signal.SIGKILL)
        wait_for(lambda: len(set(workers_of(client.pid)) - {first}) == 2)  # replaced
        wait_for(lambda: any(killed(run) for run in runs_in(tmp_path)))
        out, errors = client.communicate(timeout=ENOUGH_S)
        assert client.returncode == 0, out + errors
    assert compared("out") == undisturbed
    assert sum(row["attempts"] - 1 for row in ResultTable.read(Path("out")).rows) >= 1


@pytest.mark.nightly
def test_an_interrupted_one_ends_cleanly_and_goes_on(undisturbed: list[dict[str, Any]], tmp_path: Path) -> None:
    with begun(command("plan.yaml", "--workers", "2")) as client:
        folder = str(wait_for(lambda: [path.parent for path in Path("runs").glob(f"plan-*/{CAMPAIGN}")])[0])
        wait_for(lambda: rows_in(folder) >= 2)
        client.send_signal(signal.SIGINT)
        _, errors = client.communicate(timeout=ENOUGH_S)
        assert client.returncode == 130, errors
        assert "Traceback" not in errors
        assert "--resume" in errors
    wait_for(lambda: not runs_in(tmp_path))
    campaign("plan.yaml", "--resume")
    assert compared(folder) == undisturbed


GOOD = "from agent.fcu.control.heading_speed import HeadingSpeedController as Good"
KINDS = {
    "good.py:Good": GOOD,
    "crash.py:X": "import os; os._exit(7)",
    "segv.py:X": "import os, signal; os.kill(os.getpid(), signal.SIGSEGV)",
    "memory.py:X": "import subprocess, sys, time\n"
    "grow = 'x = bytearray(700_000_000)\\nfor at in range(0, len(x), 4096): x[at] = 1\\nimport time; time.sleep(1e4)'\n"
    "subprocess.Popen([sys.executable, '-c', grow], start_new_session=True)\ntime.sleep(1e4)",
    "worker.py:X": "import os, signal, time; os.kill(os.getppid(), signal.SIGKILL); time.sleep(1e4)",
    "good.py:Nothing": "",
}


def controllers(folder: Path) -> dict[str, dict[str, Any]]:
    """Rows by the controller of each."""
    return {row["autopilot.controller"].split("/")[-1]: row for row in ResultTable.read(folder).rows}


@pytest.mark.nightly
def test_what_hangs_is_ended_and_tried_again(tmp_path: Path) -> None:
    """The other is there for the first run, which is tried before. Whether it makes its 4 s is the machine's affair."""
    Path("good.py").write_text(GOOD, encoding="utf-8")
    Path("hang.py").write_text("import time; time.sleep(1e4)", encoding="utf-8")
    Path("sail.yaml").write_text("extends: sitl\nclock: {duration_s: 0.2}\n", encoding="utf-8")
    Path("hang.yaml").write_text(
        "base: sail.yaml\naxes: {autopilot.controller: ['good.py:Good', 'hang.py:X']}\n"
        "limits: {time_s: 4, attempts: 2}\n",
        encoding="utf-8",
    )
    campaign("hang.yaml", "--workers", "2", "--out", "out", code=1)
    row = controllers(Path("out"))["hang.py:X"]
    assert (row["status"], row["attempts"]) == ("timeout", 2)
    assert runs_in(tmp_path) == []


def test_what_misbehaves_is_told_as_what_it_is(tmp_path: Path) -> None:
    for name, text in KINDS.items():
        if text:
            Path(name.partition(":")[0]).write_text(text, encoding="utf-8")
    Path("sail.yaml").write_text("extends: sitl\nclock: {duration_s: 0.2}\n", encoding="utf-8")
    Path("kinds.yaml").write_text(
        f"base: sail.yaml\naxes:\n  autopilot.controller: [{', '.join(KINDS)}]\n"
        "limits: {memory_mb: 500, attempts: 2}\nrecordings: all\n",
        encoding="utf-8",
    )
    told = campaign("kinds.yaml", "--workers", "2", "--out", "out", code=1)
    rows = controllers(Path("out"))
    assert {name: (rows[name]["status"], rows[name]["attempts"]) for name in KINDS} == {
        "good.py:Good": ("incomplete", 1),
        "crash.py:X": ("crashed", 2),
        "segv.py:X": ("crashed", 2),
        "memory.py:X": ("memory", 2),
        "worker.py:X": ("killed", 2),
        "good.py:Nothing": ("failed", 1),
    }
    assert "has no Nothing" in rows["good.py:Nothing"]["error"]
    assert rows["good.py:Good"]["error"] == "duration reached, 0 of 6 waypoints"
    assert (Path(rows["good.py:Good"]["directory"]) / "run.mcap").exists()
    assert "xitl sim sail.yaml --set autopilot.controller=" in told
    assert runs_in(tmp_path) == []


@pytest.mark.nightly
def test_runs_of_one_worker_are_those_of_fresh_processes(tmp_path: Path) -> None:
    """Different profiles and seeds after one another, some of them again: nothing remains from one run to the next."""
    plan = (
        "base: sitl\naxes: {extends.profile: [sitl, fleet-crossing, mitl], clock.duration_s: [0.4]}\n"
        "seeds: 1-2\nrecordings: all\n"
    )
    Path("plan.yaml").write_text(plan, encoding="utf-8")
    campaign("plan.yaml", "--workers", "1", "--out", "out", code=1)
    rows = ResultTable.read(Path("out")).rows
    assert len(rows) == 6
    for row in rows:
        assert row["status"] in ("completed", "incomplete"), row
        fresh = tmp_path / "fresh"
        words = [sys.executable, "-m", "xitl_cli.main", *row["command"].split()[1:], "--out", str(fresh), "--overwrite"]
        subprocess.run(words, env=environment(), capture_output=True, timeout=ENOUGH_S, check=False)
        of_worker = payloads(Path(row["directory"]) / "run.mcap")
        assert of_worker
        assert of_worker == payloads(fresh / "run.mcap")


@contextmanager
def scheduler(
    *before: str, host: str = "127.0.0.1", port: int = 0, tls: Sequence[str] = ()
) -> Iterator[tuple[Process, str]]:
    """A scheduler and a worker, each a process of its own, and its address. tls: options for both."""
    dask = [*before, sys.executable, "-m", "dask"]
    told = Path(f"scheduler-{time.monotonic_ns()}.json")
    words = [*dask, "scheduler", "--host", host, "--port", str(port), "--no-dashboard", "--scheduler-file", str(told)]
    words += [*tls, "--protocol", "tls"] if tls else []
    with begun(words) as process:
        address = wait_for(lambda: told.exists() and told.read_text() and json.loads(told.read_text())["address"])
        with begun([*dask, "worker", address, "--nthreads", "1", "--no-nanny", "--no-dashboard", *tls]):
            yield process, address


@pytest.mark.nightly
def test_a_scheduler_that_is_killed_is_survived(undisturbed: list[dict[str, Any]]) -> None:
    with scheduler() as (process, address):
        with begun(command("plan.yaml", "--on", address, "--out", "out")) as client:
            wait_for(lambda: rows_in("out") >= 1)
            process.kill()
            _, errors = client.communicate(timeout=ENOUGH_S)
            assert client.returncode == 2, errors
            sentence = "the scheduler does not respond; completed runs are kept; continue with --resume"
            assert sentence in " ".join(errors.split())
            assert "Traceback" not in errors
        away = campaign("plan.yaml", "--on", address, "--out", "out", "--resume", code=2)
        assert f"--on {address}: does not answer" in " ".join(away.split())
    assert 1 <= rows_in("out") < RUNS
    with scheduler() as (_, address):
        campaign("plan.yaml", "--on", address, "--out", "out", "--resume")
    assert compared("out") == undisturbed


@pytest.mark.nightly
def test_a_cluster_with_tls_runs_a_plan(undisturbed: list[dict[str, Any]]) -> None:
    security = distributed.Security.temporary()
    Path("cert.pem").write_text(security.tls_client_cert)
    Path("key.pem").write_text(security.tls_client_key)
    files = ["--tls-ca-file", "cert.pem", "--tls-cert", "cert.pem", "--tls-key", "key.pem"]
    with scheduler(tls=files) as (_, address):
        assert address.startswith("tls://")
        campaign("plan.yaml", "--on", address, *files, "--out", "out")
    assert compared("out") == undisturbed


def test_files_of_tls_without_a_scheduler_are_refused() -> None:
    told = campaign("plan.yaml", "--tls-ca-file", "cert.pem", code=2)
    assert "--tls-ca-file, --tls-cert and --tls-key apply to --on only" in " ".join(told.split())


@pytest.mark.nightly
@pytest.mark.skipif(
    os.geteuid() != 0 or shutil.which("ip") is None, reason="network namespaces are made by root with ip"
)
def test_a_scheduler_in_another_network_namespace(undisturbed: list[dict[str, Any]]) -> None:
    name, link = f"xitl-{os.getpid()}", f"xv{os.getpid()}"
    network = f"10.213.{os.getpid() % 256}"  # of other tests on this machine there may be others
    here, there = f"{network}.1", f"{network}.2"
    made = subprocess.run(["ip", "netns", "add", name], capture_output=True, text=True, check=False)
    if made.returncode:
        pytest.skip(f"no network namespace can be made here: {made.stderr.strip()}")
    inside = ["ip", "netns", "exec", name]
    try:
        for line in (
            f"ip link add {link} type veth peer name {link}p netns {name}",
            f"ip address add {here}/30 dev {link}",
            f"ip link set {link} up",
            f"ip -n {name} address add {there}/30 dev {link}p",
            f"ip -n {name} link set {link}p up",
            f"ip -n {name} link set lo up",
        ):
            done = subprocess.run(line.split(), capture_output=True, text=True, check=False)
            if done.returncode:
                pytest.skip(f"no link into a network namespace can be made here: {done.stderr.strip()}")
        with scheduler(*inside, host=there, port=8786) as (_, address):
            assert address == f"tcp://{there}:8786"
            Path("plan.yaml").write_text(PLAN.replace("seeds: 1-2", "seeds: 1"), encoding="utf-8")
            campaign("plan.yaml", "--on", address, "--out", "out")
    finally:
        subprocess.run(["ip", "netns", "delete", name], check=False)
    first = [row for row in undisturbed if row["seed"] == 1]
    assert [row | {"number": 0} for row in compared("out")] == [row | {"number": 0} for row in first]


def test_a_million_runs_by_accident_are_refused(golden: Golden) -> None:
    text = PLAN.replace("[0, 6]", "{from: 0, to: 20, count: 1000}").replace("seeds: 1-2", "seeds: 1-1000")
    Path("plan.yaml").write_text(text, encoding="utf-8")
    told = " ".join(campaign("plan.yaml", "--out", "out", code=2).split())
    golden("text", told, "1000000 runs", "1000")
    assert not Path("out").exists()


def test_constraints_that_leave_nothing_are_told() -> None:
    Path("plan.yaml").write_text(f"{PLAN}constraints: [environment.wind.mean_mps > 7]\n", encoding="utf-8")
    assert "no combination satisfies the constraints" in " ".join(campaign("plan.yaml", "--out", "out", code=2).split())
    assert not Path("out").exists()


def test_a_figure_that_no_summary_has_is_told_before_anything_runs(golden: Golden) -> None:
    Path("plan.yaml").write_text(PLAN.replace("cross_track_rms_m", "cross_track_rms"), encoding="utf-8")
    told = " ".join(campaign("plan.yaml", "--out", "out", code=2).split())
    golden("text", told)
    assert "did you mean mission.cross_track_rms_m?" in told
    assert rows_in("out") == 0
