"""A 1 GB recording as the recorder writes it, with a point cloud: how fast it opens, what one topic of it costs.

Run by hand, for each topic: `python -m tests.bench.bench_logs_mcap [MEGABYTES]`. Read bytes are what the process asked
the kernel for (/proc/self/io), so what the page cache holds counts, too.
"""

from __future__ import annotations

import atexit
import resource
import struct
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from sim_core.frames import euler_to_quat, quat_to_matrix
from sim_core.kinematics import Kinematics
from tests.bench.bench_logs import timed, xitl
from tests.bench.figure import Figure, scaled
from xitl_cli.logs.formats.mcap.file import McapLog
from xitl_cli.record.mcap_file import McapFile
from xitl_cli.record.recorder import Recorder
from xitl_cli.record.topics import LinkReport, MotionEstimate, MotorCommand, TaskTiming

RUNS = 5
POINTS = 9000
CLOUD_HZ, TRUTH_HZ, FRAME_HZ = 10, 50, 350
_CLOUD = "builtin_interfaces/Time stamp\nuint32 count\nuint8[] data\n"
_STATE = "/truth/state"
TOPICS = ("/links", "/log", "/environment", _STATE, "/truth/odometry", "/link/agent/tx", "/tf", "/cloud")


@dataclass(frozen=True)
class Cost:
    what: str
    seconds: float
    read_bytes: int


class Clock:
    """Stands for the wall clock, as in a run in real time."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        return self.now_s


def write(path: Path, size_bytes: int, cloud: bool = True) -> None:
    """A run in real time until the file is as large."""
    clock, random = Clock(), np.random.default_rng(1)
    file = McapFile(path, "lz4", now_s=clock)  # a run takes this long
    recorder = Recorder(file)
    clouds = file.ros_channel("/cloud", "xitl_msgs/msg/Cloud", _CLOUD) if cloud else None
    head = struct.Struct("<4siIII")
    points = [random.bytes(12 * POINTS) for _ in range(8)]
    frames = [b"\xfd" + random.bytes(54) for _ in range(64)]
    recorder.metadata("xitl", {"version": "0", "profile": "bench", "seed": "1", "started_utc": "2026-01-01T00:00:00"})
    tick, ticks_per_s = 0, FRAME_HZ
    while path.stat().st_size < size_bytes:
        stamp_ns = tick * 1_000_000_000 // ticks_per_s
        clock.now_s = stamp_ns * 1e-9
        recorder.frame_sent(stamp_ns, frames[tick % len(frames)])
        if tick % (ticks_per_s // TRUTH_HZ) == 0:
            _state(recorder, stamp_ns, random.normal(size=24))
        if clouds is not None and tick % (ticks_per_s // CLOUD_HZ) == 0:
            clouds(
                head.pack(b"\0\1\0\0", *divmod(stamp_ns, 10**9), POINTS, 12 * POINTS) + points[tick % len(points)],
                stamp_ns,
            )
        if tick % ticks_per_s == 0:
            recorder.write(stamp_ns, LinkReport("sensors", tick, tick))
            recorder.write(stamp_ns, TaskTiming("LC", "control", 50.0, tick, 0))
            if tick % (60 * ticks_per_s) == 0:
                recorder.log(stamp_ns, 6, "bench", "one minute more")
        recorder.flush_if_due()
        tick += 1
    recorder.close()


def _state(recorder: Recorder, stamp_ns: int, noise: np.ndarray) -> None:
    quat = euler_to_quat(noise[None, :3] * 0.1)
    zero = np.zeros((1, 3))
    motion = Kinematics(
        pos_ned_m=noise[None, 3:6],
        vel_ned_mps=noise[None, 6:9],
        acc_ned_mps2=noise[None, 9:12],
        quat_ned_frd=quat,
        rot_ned_frd=quat_to_matrix(quat),
        gyro_frd_radps=noise[None, 12:15],
        angular_acc_frd_radps2=zero,
    )
    recorder.truth(stamp_ns, motion, np.zeros((1, 2)))
    recorder.actuators(
        stamp_ns, MotorCommand((float(noise[20]), float(noise[21])), armed=True), "propeller 0, propeller 1"
    )
    recorder.frame_received(stamp_ns, b"\xfd" + noise[:8].tobytes())
    recorder.environment(stamp_ns, noise[3:6], noise[6:9], 0.0)
    recorder.estimate(stamp_ns, MotionEstimate(noise[3:6], noise[6:9], quat[0], noise[12:15]))


def measured(what: str, action: Callable[[], object]) -> Cost:
    before, start_s = _read_bytes(), time.perf_counter()
    action()
    return Cost(what, time.perf_counter() - start_s, _read_bytes() - before)


def _read_bytes() -> int:
    lines = Path("/proc/self/io").read_text().splitlines()
    return int(next(line for line in lines if line.startswith("rchar")).split()[1])


def information(path: Path) -> None:
    """What `xitl logs info` shows."""
    with McapLog(path) as log:
        _ = log.base, log.span_ns, dict(log.facts), log.health
        _ = {name: table.indexed_rows for name, table in log.tables.items()}


def topic(path: Path, name: str) -> None:
    """All columns of one topic."""
    with McapLog(path) as log:
        table = log.tables[name]
        for column in table.columns:
            if column != "data":
                table.values(column)


def costs(path: Path) -> list[Cost]:
    found = [measured("info", lambda: information(path))]
    for name in TOPICS:
        with McapLog(path) as log:
            there = name in log.tables
        if there:
            found.append(measured(name, lambda name=name: topic(path, name)))
    return found


@cache
def recording() -> Path:
    """1 GB with clouds, made anew in each run of the bench and gone with it."""
    folder = tempfile.TemporaryDirectory()
    atexit.register(folder.cleanup)
    path = Path(folder.name) / "large.mcap"
    write(path, scaled(1_000_000_000, 2_000_000))
    return path


def info_command_s() -> list[float]:
    """`xitl logs info` as a process of its own."""
    return timed(lambda: xitl("logs", "info", str(recording())), scaled(RUNS, 1))


def topic_percent() -> list[float]:
    """Read for all columns of the vessel's state."""
    cost = measured(_STATE, lambda: topic(recording(), _STATE))
    return [100 * cost.read_bytes / recording().stat().st_size]


FIGURES = [
    Figure("xitl logs info of a 1 GB recording", "< 1", "s", info_command_s),
    Figure("one topic of a 1 GB recording, read of the file", "< 10", "%", topic_percent),
]


def main() -> None:
    size_bytes = int(sys.argv[1] if len(sys.argv) > 1 else 1000) * 1_000_000
    with tempfile.TemporaryDirectory() as folder:
        for cloud, share in ((True, 1.0), (False, 0.1)):
            path = Path(folder) / f"{cloud}.mcap"
            start_s = time.perf_counter()
            write(path, int(size_bytes * share), cloud)
            size = path.stat().st_size
            took_s = time.perf_counter() - start_s
            print(f"{size / 1e6:.0f} MB, {'with' if cloud else 'without'} clouds, written in {took_s:.0f} s")
            information(path)  # imports
            for cost in costs(path):
                part = 100 * cost.read_bytes / size
                print(f"  {cost.what:18} {cost.seconds:8.3f} s {cost.read_bytes / 1e6:9.2f} MB {part:7.2f} %")
            path.unlink()
    print(f"most memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")


if __name__ == "__main__":
    main()
