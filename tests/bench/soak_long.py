"""`make soak-long`: hours of a run in real time with ground stations, companion, view, browser and random faults.

It samples the processes every ten seconds, reads the whole recording in the end, and prints what grew and what the
ends of each link counted. The result is also in OUT/soak.json. Exit code 1 if a limit is exceeded.
"""

from __future__ import annotations

import argparse
import json
import random
import re
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from mcap.reader import SeekingReader

from tests.bench.process_samples import Growth, Sample, growth, processes_of, sample
from tests.bench.soak_clients import Browser, Client, Station, Viewer, leave
from tests.chromium import CHROMIUM
from tests.free_ports import free_port
from xitl_cli.logs import open_log

MOST_MB_PER_H = 1.0
SETTLE_S = 600.0
SAMPLE_S = 10.0
ASK_S = 20.0
"""Pause between two requests of the busiest station."""
FIRST_FAULT_S = 60.0
LAST_FAULT_S = 30.0
"""Before the end: the ends of the links agree on a link without faults."""
START_S = 60.0
LEAVE_S = 90.0

Faults = dict[str, dict[str, Any]]


def random_faults(seed: int, duration_s: float) -> Faults:
    """Faults of links, clocks, sensors and propellers, one after the other, as keys of a profile."""
    draw = random.Random(seed)
    kinds = {
        "cut": lambda which: {"link": {"which": which, "cut": True}},
        "delay": lambda which: {
            "link": {"which": which, "delay_s": round(draw.uniform(0.01, 0.2), 3), "jitter_s": 0.02}
        },
        "loss": lambda which: {"link": {"which": which, "loss": 0.2, "duplicate": 0.1, "reorder": 0.1}},
        "gnss-lost": lambda which: {"gnss": {"dropout": 1.0}},
        "gnss-biased": lambda which: {"gnss": {"position_bias_ned_m": [3.0, -3.0, 0.0]}},
        "imu-lost": lambda which: {"imu": {"dropout": 0.3}},
        "compass-frozen": lambda which: {"magnetometer": {"freeze": True}},
        "barometer-lost": lambda which: {"barometer": {"dropout": 1.0}},
        "thrust-lost": lambda which: {"propeller": {"which": "propeller 0", "thrust_loss": 0.5}},
        "clock-step": lambda which: {"agent": {"which": "agent", "clock_offset_s": round(draw.uniform(0.05, 1.0), 3)}},
        "busy": lambda which: {"agent": {"which": which, "cpu_load": 0.3}},
    }
    faults: Faults = {}
    at_s = FIRST_FAULT_S
    while at_s < duration_s - LAST_FAULT_S - 10.0:
        kind = draw.choice(sorted(kinds))
        keys = kinds[kind](draw.choice(["agent", "agent", "companion"]))
        lasts_s = draw.uniform(1.0, 4.0) if kind in ("cut", "busy") else draw.uniform(2.0, 10.0)
        times: dict[str, Any] = {"from_s": round(at_s, 1)}
        if kind != "clock-step":  # a clock does not go back
            times["until_s"] = round(at_s + lasts_s, 1)
        faults[f"{kind}-{len(faults) + 1}"] = {**times, **keys}
        at_s += lasts_s + draw.uniform(20.0, 60.0)
    return faults


def soak_profile(duration_s: float, seed: int, ports: Sequence[int], split_s: float) -> dict[str, Any]:
    """Return the profile of the run. ports: of the ground stations, TCP and UDP."""
    return {
        "extends": ["hitl-loopback", "sensors/perception"],
        "description": "Hours of hardware in the loop over the loopback",
        "driver": {"kind": "ground-station", "stay": True},
        "autopilot": {"ground_stations": [f"tcp://127.0.0.1:{ports[0]}", f"udp://127.0.0.1:{ports[1]}"]},
        "companion": {"runs": "process", "link": "udp://127.0.0.1:0"},
        "sensors": {"lidar": {"rate_hz": 5, "points_hz": 10000}},
        "clock": {"duration_s": duration_s, "seed": seed},
        "recording": {"split": {"time_s": split_s}},
        "faults": random_faults(seed, duration_s),
    }


@dataclass
class Watched:
    """What was seen during the run: samples by process, by id; and the clients."""

    samples: dict[str, list[Sample]] = field(default_factory=dict)
    ids: dict[str, int] = field(default_factory=dict)
    replaced: list[str] = field(default_factory=list)
    """Processes that another one replaced."""

    def look(self, host: int, at_s: float) -> None:
        for name, pid in processes_of(host).items():
            if self.ids.setdefault(name, pid) != pid:
                self.replaced.append(name)
                self.ids[name] = pid
            taken = sample(pid, at_s)
            if taken is not None:
                self.samples.setdefault(name, []).append(taken)


def run(
    folder: Path, duration_s: float, seed: int, split_s: float, sample_s: float, ask_s: float
) -> tuple[Watched, list[Client]]:
    """Make the run in `folder`. Raises RuntimeError if it does not begin."""
    ports = free_port(2), free_port()
    profile = soak_profile(duration_s, seed, ports, split_s)
    (folder / "soak.yaml").write_text(json.dumps(profile, indent=1))
    said = folder / "host.txt"
    command = [
        "sim",
        "soak.yaml",
        "--duration",
        f"{duration_s:g}",
        "--out",
        "run",
        "--overwrite",
        "--view",
        "--verbose",
    ]
    stations: list[Client] = [
        Station(
            f"tcp:127.0.0.1:{ports[0]}", 255, steers=True, requests=("parameters", "mission", "files"), pause_s=ask_s
        ),
        Station(f"tcp:127.0.0.1:{ports[0]}", 254, requests=("mission", "files"), pause_s=2.0 * ask_s, stay_s=120.0),
        Station(f"udpin:127.0.0.1:{ports[1]}", 253, requests=("parameters",), pause_s=3.0 * ask_s),
    ]
    watched = Watched()
    with said.open("w") as output:
        host = subprocess.Popen(
            [sys.executable, "-m", "xitl_cli.main", *command], cwd=folder, stdout=output, stderr=subprocess.STDOUT
        )
        began_s = time.monotonic()
        clients = list(stations)
        try:
            while not re.search("^t ", said.read_text(), re.MULTILINE):
                if host.poll() is not None or time.monotonic() - began_s > START_S:
                    raise RuntimeError(f"the run did not begin:\n{said.read_text()}")
                time.sleep(0.1)
            found = re.search(r"view: (http\S+)", said.read_text())
            assert found is not None
            clients.append(Viewer(found[1], stay_s=300.0))
            if CHROMIUM is None:
                print("no browser looks at the view: Chromium is not installed; apt install chromium", flush=True)
            else:
                clients.append(Browser(found[1], stay_s=300.0))
            began_s = time.monotonic()
            for client in clients:
                client.start()
            due_s = 0.0
            while host.poll() is None and reached_s(said) < duration_s - LAST_FAULT_S / 2:
                watched.look(host.pid, time.monotonic() - began_s)
                due_s += sample_s
                while host.poll() is None and time.monotonic() - began_s < due_s:
                    time.sleep(0.2)
            leave(clients, LEAVE_S)
            host.wait(duration_s)
        finally:
            if host.poll() is None:
                host.terminate()
                host.wait()
    return watched, clients


def reached_s(said: Path) -> float:
    """Simulation time of the newest line of progress of a run, 0 before the first."""
    with said.open("rb") as file:
        file.seek(max(said.stat().st_size - 1000, 0))
        times = re.findall(rb"^t +([\d.]+) s", file.read(), re.MULTILINE)
    return float(times[-1]) if times else 0.0


# Checks of the result


def link_problems(summary: Mapping[str, Any]) -> Iterator[str]:
    """Yield a sentence for each direction of a link whose counts do not add up."""
    for link in summary["links"]:
        counts = {name: link[name] for name in ("sent", "received", "repeated", "lost", "impaired")}
        if any(count is None for count in counts.values()):
            yield f"{link['name']}: the ends did not agree: {counts}"
            continue
        uncounted = counts["sent"] - (counts["received"] - counts["repeated"]) - counts["lost"]
        if uncounted:
            yield f"{link['name']}: {uncounted} frames uncounted: {counts}"
        if counts["lost"] < counts["impaired"]:
            yield f"{link['name']}: {counts['lost']} lost, {counts['impaired']} of them by faults"


def recording_problems(folder: Path, summary: Mapping[str, Any]) -> Iterator[str]:
    """Read every table of the recording as one set. Yield a sentence for each deviation from its files."""
    files = [folder / part["file"] for part in summary.get("recording", [{"file": "run.mcap"}])]
    in_files: dict[str, int] = {}
    for path in files:
        with path.open("rb") as file:
            reader = SeekingReader(file)
            found = reader.get_summary()
            if found is None or found.statistics is None:
                yield f"{path.name} has no index"
                continue
            for number, count in found.statistics.channel_message_counts.items():
                topic = found.channels[number].topic
                in_files[topic] = in_files.get(topic, 0) + count
    with open_log(folder) as log:
        for part in log.files:
            for topic, repeated in part.repeated.items():
                in_files[topic] -= repeated
        for topic, count in sorted(in_files.items()):
            rows = sum(1 for _ in log.payloads(topic))
            if rows != count:
                yield f"{topic}: {rows} rows in the set, {count} in its files"
        tables = dict(log.tables)
        for topic in log.tables:
            if topic.startswith("/link/"):
                tables |= log.frame_tables(topic)
        for name, table in tables.items():
            stamps_ns = table.stamp_ns
            if len(stamps_ns) != len(table):
                yield f"{name}: {len(stamps_ns)} stamps for {len(table)} rows"
            for column in table.columns:
                if len(table[column]) != len(table):
                    yield f"{name}.{column}: {len(table[column])} values for {len(table)} rows"
        states_ns = log["/truth/state"].stamp_ns
        if np.any(np.diff(states_ns) != states_ns[0]):
            yield "/truth/state has a gap"
        if log.health.degraded or log.health.undecoded:
            yield f"the recording is degraded: {log.health.as_json()}"


def clock_relations(folder: Path, faults: Faults) -> dict[str, dict[str, float]]:
    """By node: change of its offset less the injected steps, over the run; largest and last drift; steps."""
    relations = {}
    with open_log(folder) as log:
        ended_s = log["/truth/state"].stamp_ns[-1] * 1e-9
        begun = [keys["agent"] for keys in faults.values() if "agent" in keys and keys["from_s"] < ended_s]
        injected_s = sum(agent.get("clock_offset_s", 0.0) for agent in begun)
        clocks = log["/clocks"]
        names = np.asarray(clocks["node"])
        for node in sorted(set(names.tolist()) - {"PS1"}):
            rows = names == node
            offset_s, drift_ppm = clocks["offset_s"][rows], clocks["drift_ppm"][rows]
            settled = len(drift_ppm) // 5
            relations[node] = {
                "offset_change_ms": 1e3 * float(offset_s[-1] - offset_s[0] - (injected_s if node == "LC" else 0.0)),
                "drift_ppm": float(drift_ppm[-1]),
                "largest_drift_ppm": float(np.abs(drift_ppm[settled:]).max()),
                "steps": int(clocks["steps"][rows][-1]),
            }
    return relations


def growth_problems(name: str, grown: Growth) -> Iterator[str]:
    """Yield a sentence for each limit that a process exceeds."""
    if grown.anon_mb_per_h >= MOST_MB_PER_H:
        yield f"{name}: its memory grows by {grown.anon_mb_per_h:.2f} MB/h"
    if grown.descriptors_grown > 0:
        yield f"{name}: {grown.descriptors_grown:g} more descriptors"
    if grown.threads_grown > 0:
        yield f"{name}: {grown.threads_grown:g} more threads"


def client_problems(client: Client) -> Iterator[str]:
    """Yield a sentence for each failure of a client."""
    if client.failure:
        yield client.failure
    if client.is_alive():
        yield f"{client.name}: does not leave"
    counts = client.counts
    for name in sorted(counts):
        if name.endswith(" asked") and counts[name] > counts[name.replace("asked", "answered")] + 1:
            yield f"{client.name}: {counts[name]} {name}, {counts[name.replace('asked', 'answered')]} answered"
    if counts["damaged"]:
        yield f"{client.name}: {counts['damaged']} damaged frames"


def judged(
    folder: Path, watched: Watched, clients: Sequence[Client], duration_s: float, seed: int, settle_s: float
) -> dict[str, Any]:
    """Return the result: figures, a sentence for each process that grows (`growing`), and for each other failure."""
    run_folder = folder / "run"
    summary = json.loads((run_folder / "summary.json").read_text())
    faults = json.loads((folder / "soak.yaml").read_text())["faults"]
    grown = {name: growth(samples, settle_s) for name, samples in watched.samples.items()}
    growing = [sentence for name, each in grown.items() if each is not None for sentence in growth_problems(name, each)]
    growing += [f"{name} ran for too short a time to measure" for name, each in grown.items() if each is None]
    problems = [f"{name} was replaced" for name in watched.replaced]
    problems += [f"no {name} was seen" for name in {"host", "agent", "companion", "view"} - set(watched.samples)]
    problems += [sentence for client in clients for sentence in client_problems(client)]
    if summary["error"] is not None or summary["ended"] != "duration reached":
        problems.append(f"the run ended early: {summary['ended']}, {summary['error']}")
    problems += link_problems(summary)
    problems += recording_problems(run_folder, summary)
    if len(summary["faults"]) != len(faults):
        problems.append(f"{len(faults)} faults injected, {len(summary['faults'])} reported")
    size_mb = sum(path.stat().st_size for path in run_folder.glob("run*.mcap")) * 1e-6
    return {
        "hours": duration_s / 3600.0,
        "seed": seed,
        "settle_s": settle_s,
        "faults": len(faults),
        "processes": {name: None if each is None else asdict(each) for name, each in grown.items()},
        "clocks": clock_relations(run_folder, faults),
        "links": summary["links"],
        "clients": {client.name: dict(client.counts) for client in clients},
        "stations_missed": {node["link"]: node["stations_missed"] for node in summary["nodes"]},
        "view": {name: count for name, count in summary["view"].items() if name != "address"},
        "pace": summary["pace"],
        "recording": {"files": len(summary["recording"]), "mb": size_mb, "mb_per_h": size_mb / duration_s * 3600.0},
        "growing": growing,
        "problems": problems,
        "samples": {name: [asdict(each) for each in samples] for name, samples in watched.samples.items()},
    }


def printed(result: Mapping[str, Any]) -> str:
    """Return the result as a table and a verdict."""
    lines = [
        f"{result['hours']:.2f} h, seed {result['seed']}, {result['faults']} faults; rates after the first "
        f"{result['settle_s'] / 60:.0f} minutes",
        "",
        f"{'process':10} {'anon MiB':>8} {'RSS MiB':>8} {'anon MB/h':>9} {'95 %':>15} {'RSS MB/h':>9} {'files':>6} "
        f"{'grown':>5} {'threads':>7} {'grown':>5} {'CPU %':>6}",
    ]
    for name, one in result["processes"].items():
        if one is None:
            continue
        low, high = one["anon_interval_mb_per_h"]
        lines.append(
            f"{name:10} {one['anon_mib']:8.1f} {one['rss_mib']:8.1f} {one['anon_mb_per_h']:9.2f} "
            f"{f'{low:.2f} … {high:.2f}':>15} {one['rss_mb_per_h']:9.2f} {one['descriptors']:6.0f} "
            f"{one['descriptors_grown']:5.0f} {one['threads']:7.0f} {one['threads_grown']:5.0f} "
            f"{one['cpu_percent']:6.1f}"
        )
    lines += ["", f"{'link':20} {'sent':>10} {'received':>10} {'repeated':>9} {'lost':>8} {'by faults':>9}"]
    for link in result["links"]:
        counts = [str(link[name]) for name in ("sent", "received", "repeated", "lost", "impaired")]
        lines.append("{:20} {:>10} {:>10} {:>9} {:>8} {:>9}".format(link["name"], *counts))
    lines += ["", f"{'clock':10} {'offset ms':>10} {'drift ppm':>10} {'largest':>8} {'steps':>6}"]
    for node, one in result["clocks"].items():
        lines.append(
            f"{node:10} {one['offset_change_ms']:10.3f} {one['drift_ppm']:10.2f} {one['largest_drift_ppm']:8.2f} "
            f"{one['steps']:6}"
        )
    recording = result["recording"]
    lines += ["", f"recording: {recording['files']} files, {recording['mb']:.0f} MB, {recording['mb_per_h']:.0f} MB/h"]
    for name, counts in result["clients"].items():
        lines.append(f"{name}: " + ", ".join(f"{count} {what}" for what, count in sorted(counts.items())))
    lines += [f"stations missed: {result['stations_missed']}", f"view: {result['view']}", f"pace: {result['pace']}", ""]
    lines += [f"FAIL: {sentence}" for sentence in (*result["growing"], *result["problems"])] or ["pass"]
    return "\n".join(lines)


def soak(
    folder: Path,
    duration_s: float,
    seed: int,
    split_s: float = 600.0,
    sample_s: float = SAMPLE_S,
    ask_s: float = ASK_S,
) -> dict[str, Any]:
    """Make a run of `duration_s` in `folder` and judge it. Writes folder/soak.json."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    watched, clients = run(folder, duration_s, seed, split_s, sample_s, ask_s)
    result = judged(folder, watched, clients, duration_s, seed, min(SETTLE_S, 0.2 * duration_s))
    (folder / "soak.json").write_text(json.dumps(result, indent=1))
    return result


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.bench.soak_long", description=__doc__)
    parser.add_argument("--hours", type=float, default=2.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("build/soak"))
    options = parser.parse_args()
    result = soak(options.out, options.hours * 3600.0, options.seed)
    print(printed(result))
    return 1 if result["growing"] or result["problems"] else 0


if __name__ == "__main__":
    sys.exit(main())
