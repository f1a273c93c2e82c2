"""What became of another autopilot in a run: rows for the report."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

_TIMES = {
    "time_to_origin_s": "origin",
    "time_to_ready_s": "ready to arm",
    "time_to_arm_s": "armed",
    "time_to_motion_s": "under way",
}
_SENT = {"imu_out": "inertial", "solution_out": "of motion", "gnss_out": "of satellites"}
_TROUBLE = {
    "unsent": "not taken",
    "world_resent": "asked for again",
    "world_lost": "missed",
    "restarts": "restarts of it",
    "junk": "bytes not understood",
    "mavlink_lost": "MAVLink lost",
    "script_dropped": "dropped by its script",
}


def autopilot_rows(section: dict[str, Any] | None) -> Iterator[tuple[str, str]]:
    """(what, text) of `autopilot` in summary.json."""
    if section is None:
        return
    who = " ".join(filter(None, (section["kind"], section["vehicle"], section["firmware"])))
    yield "autopilot", who
    if section["kind"] == "px4":
        yield "", "(this bridge has not yet been run against PX4)"
    times = [f"{word} {section[key]:.1f} s" for key, word in _TIMES.items() if section[key] is not None]
    if times:
        yield "", ", ".join(times)
    if not section["log"]:
        yield "", "its own log stays where it runs" if section["program"] is None else "it left no log of its own"
    counts = section["bridge"]
    if counts is not None:
        yield "bridge", _bridge(counts)
    scheduler = section["scheduler"]
    if scheduler is not None:
        yield "scheduler", _scheduler(scheduler, section["clock"], section["agent"])


def _bridge(counts: dict[str, int]) -> str:
    sent = [f"{counts[key]} {word}" for key, word in _SENT.items() if counts[key]]
    words = [f"frames in: {', '.join(sent)}" if sent else "no frames in", f"{counts['outputs_in']} outputs back"]
    if counts["world_rate"]:
        words.append(f"world at {counts['world_rate']} Hz")
    words += [f"{counts[key]} {word}" for key, word in _TROUBLE.items() if counts[key]]
    return "\n".join((words[0], ", ".join(words[1:])))


def _scheduler(scheduler: dict[str, Any], clock: str, agent: dict[str, int]) -> str:
    words = [f"{scheduler[key]} {word}" for key, word in (("long_loops", "long"),) if scheduler[key] is not None]
    if scheduler["loops"] is not None:
        words.append(f"of {scheduler['loops']} loops")
    text = " ".join(words)
    if scheduler["max_us"] is not None:
        text += f", longest {scheduler['max_us'] / 1e3:.1f} ms"
    if scheduler["load_max_percent"] is not None:
        text += f", load {scheduler['load_mean_percent']:.1f} %, at most {scheduler['load_max_percent']:.1f} %"
    if clock != "real":
        text += "\n(by its simulated clock: says nothing of processor time)"
    return text + f"\nthe agent missed {agent['missed']} of {agent['cycles']} cycles"
