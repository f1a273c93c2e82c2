"""Memory, descriptors and threads of processes over time, from /proc, and their rates per hour."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np


@dataclass(frozen=True, slots=True)
class Sample:
    """A process at an instant.

    rss_kib: all resident pages. anon_kib: its share of those without a file (Pss_Anon). Pages of programs and libraries
    are only in the first one: whether they are resident, and how many processes share them, depends on other processes.
    """

    at_s: float
    rss_kib: int
    anon_kib: int
    descriptors: int
    threads: int
    cpu_s: float


@dataclass(frozen=True, slots=True)
class Growth:
    """Growth of a process after it has settled.

    Memory per hour by the median of all slopes between two samples (Theil 1950, Sen 1968), with its interval at 95 %.
    Descriptors and threads: the median of the last third of the samples less that of the first third.
    """

    samples: int
    rss_mib: float
    """At the end."""
    anon_mib: float
    rss_mb_per_h: float
    anon_mb_per_h: float
    anon_interval_mb_per_h: tuple[float, float]
    descriptors: float
    descriptors_grown: float
    threads: float
    threads_grown: float
    cpu_percent: float
    """Of one core."""


def sample(pid: int, at_s: float) -> Sample | None:
    """Sample a process; None if it has ended."""
    folder = Path(f"/proc/{pid}")
    try:
        rollup = (folder / "smaps_rollup").read_text()
        stat = (folder / "stat").read_text().rpartition(") ")[2].split()
        descriptors = len(list((folder / "fd").iterdir()))
    except OSError:
        return None
    kib = {name: int(value) for name, value in re.findall(r"^(\w+): +(\d+) kB$", rollup, re.MULTILINE)}
    if "Rss" not in kib:
        return None
    cpu_s = (int(stat[11]) + int(stat[12])) / 100
    return Sample(at_s, kib["Rss"], kib["Pss_Anon"], descriptors, int(stat[17]), cpu_s)


def growth(samples: Sequence[Sample], settle_s: float) -> Growth | None:
    """Growth from `settle_s` on; None with fewer than six samples from then on."""
    settled = [each for each in samples if each.at_s >= settle_s]
    if len(settled) < 6:
        return None
    from scipy.stats import theilslopes  # the whole package takes a second

    columns = {name: np.array([asdict(each)[name] for each in settled], dtype=float) for name in asdict(settled[0])}
    hours = columns["at_s"] / 3600.0
    slopes = {name: theilslopes(columns[f"{name}_kib"] * 1024e-6, hours, alpha=0.95) for name in ("rss", "anon")}
    third = len(settled) // 3
    last = {name: float(np.median(values[-third:])) for name, values in columns.items()}
    first = {name: float(np.median(values[:third])) for name, values in columns.items()}
    spent_s = columns["at_s"][-1] - columns["at_s"][0]
    return Growth(
        samples=len(settled),
        rss_mib=settled[-1].rss_kib / 1024,
        anon_mib=settled[-1].anon_kib / 1024,
        rss_mb_per_h=float(slopes["rss"][0]),
        anon_mb_per_h=float(slopes["anon"][0]),
        anon_interval_mb_per_h=(float(slopes["anon"][2]), float(slopes["anon"][3])),
        descriptors=last["descriptors"],
        descriptors_grown=last["descriptors"] - first["descriptors"],
        threads=last["threads"],
        threads_grown=last["threads"] - first["threads"],
        cpu_percent=100.0 * float(columns["cpu_s"][-1] - columns["cpu_s"][0]) / float(spent_s),
    )


def processes_of(host: int) -> Mapping[str, int]:
    """Process ids by name: the host, and the agent, companion and view that it started."""
    found = {"host": host}
    try:
        children = Path(f"/proc/{host}/task/{host}/children").read_text().split()
    except OSError:
        return found
    for child in children:
        try:
            command = Path(f"/proc/{child}/cmdline").read_bytes().split(b"\0")
        except OSError:
            continue
        if b"agent" in command:
            found["companion" if b"companion" in command else "agent"] = int(child)
        elif b"xitl_cli.plugins.view.process" in command:
            found["view"] = int(child)
    return found
