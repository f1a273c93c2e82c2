"""How a run went, for a person at a terminal."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from xitl_cli.profile import Profile
from xitl_cli.run.core import directory
from xitl_cli.run.session import Result

_MORE = (directory.DATAFLASH, directory.MAP, directory.TRAJECTORY, directory.TRUTH)


def show_result(console: Console, profile: Profile, result: Result) -> None:
    """The summary as tables, readable at 80 columns and without colour."""
    summary = result.summary
    mission, estimation = summary["mission"], summary["estimation"]
    table = Table.grid(padding=(0, 2))
    table.add_row(
        "profile", f"{summary['profile']} ({summary['technique']}, {summary['clock']}, seed {summary['seed']})"
    )
    table.add_row("realism", _realism(summary))
    table.add_row("ended", summary["ended"])
    factor = summary["real_time_factor"]
    table.add_row(
        "time",
        f"{summary['duration_s']:.1f} s in {summary['wall_s']:.1f} s"
        + (f", {factor:.1f}× real time" if factor else ""),
    )
    driver = summary["driver"]
    if driver["kind"] in ("script", "replay"):
        table.add_row(driver["kind"], "played to its end" if driver["completed"] else "not played to its end")
    if mission["waypoints_total"]:
        state = "completed" if mission["completed"] else "not completed"
        table.add_row(
            "mission",
            f"{state}, {mission['waypoints_reached']} of {mission['waypoints_total']} waypoints, "
            f"cross-track RMS {_number(mission['cross_track_rms_m'], 'm')}",
        )
    if estimation["position_rms_m"] is not None:
        table.add_row(
            "estimate off",
            f"{_number(estimation['position_rms_m'], 'm')} RMS in position, "
            f"{_number(estimation['heading_rms_deg'], '°')} in heading",
        )
    for what, text in autopilot_rows(summary["autopilot"]):
        table.add_row(what, Text(text))
    for what, text in (*perception_rows(summary), *incidents(summary)):
        table.add_row(what, Text(text))
    console.print(table, highlight=False)
    for rows in (_links(summary["links"]), _tasks(summary["tasks"]), _clocks(summary["clocks"])):
        if rows is not None:
            console.print(rows, highlight=False)
    if summary["faults"]:
        console.print(_faults(summary["faults"]), highlight=False)
    console.print(
        f"{result.directory}/: {directory.RECORDING} (opens in Foxglove and Lichtblick), "
        + ", ".join(
            (directory.SUMMARY, directory.PROFILE, *(name for name in _MORE if (result.directory / name).exists()))
        ),
        highlight=False,
        markup=False,
        soft_wrap=True,
    )


def _realism(summary: dict[str, Any]) -> str:
    graph = summary["graph"]
    measured = graph["measured"]["wdri"]
    lines = [f"WDRI {summary['wdri']:.2f} claimed, {'none' if measured is None else f'{measured:.2f}'} measured"]
    if graph["missing"]:
        lines.append(f"claimed, but nothing was carried: {', '.join(graph['missing'])}")
    if graph["unclaimed"]:
        lines.append(f"carried, but not claimed: {', '.join(graph['unclaimed'])}")
    return "\n".join(lines)


def _links(links: list[dict[str, Any]]) -> Table | None:
    if not links:
        return None
    table = _table("link", "sent", "received", "lost", "dropped", "p50 µs", "p99 µs", "max µs")
    for link in links:
        latency = link["latency_us"]
        table.add_row(
            link["name"],
            *(_count(link[key]) for key in ("sent", "received", "lost", "dropped")),
            *(_number(latency[key]) for key in ("p50", "p99", "max")),
        )
    return table


def _tasks(tasks: list[dict[str, Any]]) -> Table | None:
    if not tasks:
        return None
    table = _table("node", "task", "Hz", "cycles", "missed", "late p99", "max µs", "run p99", "max µs")
    for task in tasks:
        table.add_row(
            Text(task["node"]),
            Text(task["task"]),
            f"{task['rate_hz']:g}",
            _count(task["cycles"]),
            _count(task["missed"]),
            _number(task["start_jitter_p99_us"]),
            _number(task["start_jitter_max_us"]),
            _number(task["run_p99_us"]),
            _number(task["run_max_us"]),
        )
    return table


def _clocks(clocks: list[dict[str, Any]]) -> Table | None:
    if not clocks:
        return None
    table = _table("clock", "offset", "± µs", "drift ppm", "± ppm", "a sample ms", "± µs", "steps")
    for clock in clocks:
        slope_s, slope_std_s = clock["slope_s"], clock["slope_std_s"]
        table.add_row(
            Text(clock["node"]),
            _offset(clock["offset_us"]),
            _number(clock["asymmetry_bound_us"]),
            *("–" if clock[key] is None else f"{clock[key]:.2f}" for key in ("drift_ppm", "drift_std_ppm")),
            "–" if slope_s is None else f"{slope_s * 1e3:.5f}",
            _number(None if slope_std_s is None else slope_std_s * 1e6),
            _count(clock["steps"]),
        )
    return table


def _faults(faults: list[dict[str, Any]]) -> Table:
    table = _table("fault", "from s", "until s", "what it did")
    table.columns[-1].justify = "left"
    for fault in faults:
        did = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in fault["did"].items())
        table.add_row(
            Text(fault["name"]),
            "never" if fault["from_s"] is None else f"{fault['from_s']:g}",
            "the end" if fault["from_s"] is not None and fault["until_s"] is None else _plain(fault["until_s"]),
            did or "–",
        )
    return table


def _table(*columns: str) -> Table:
    table = Table(box=None, header_style="bold", pad_edge=False, padding=(0, 2, 0, 0))
    for number, column in enumerate(columns):
        text = number == 0 or column == "task"
        table.add_column(column, justify="left" if text else "right")
    return table


def _offset(value_us: float | None) -> str:
    if value_us is None:
        return "–"
    return f"{value_us * 1e-6:.4f} s" if abs(value_us) >= 1e5 else _number(value_us, "µs")


def _plain(value: float | None) -> str:
    return "–" if value is None else f"{value:g}"


def _count(value: int | None) -> str:
    return "–" if value is None else str(value)


def _number(value: float | None, unit: str = "") -> str:
    if value is None:
        return "–"
    digits = 0 if abs(value) >= 100 or value == 0 else 2 if unit else 1
    return f"{value:.{digits}f}{' ' if unit and unit != '°' else ''}{unit}"


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


_ODD = {
    "gaps": "gaps",
    "late": "late",
    "repeated": "repeated",
    "unsent": "unsent",
    "refused": "refused",
    "impaired": "lost on purpose",
}
_HOST_END = {
    "losses": "breaks of the line",
    "errors": "bus errors",
    "incomplete": "transfers with a hole",
    "malformed": "malformed frames",
    "foreign": "foreign frames",
}
_NODE = {
    "log_dropped": "records of its log not written",
    "stations_missed": "things ground stations missed",
    "events_lost": "sentences lost",
}


def incidents(summary: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """(what, text) of each, from summary.json."""
    for node in summary["nodes"]:
        yield "node", _node(node)
    actuators = summary["actuators"]
    if actuators is not None and actuators["age_us"]["max"]:
        yield "commands", _actuators(actuators)
    for link in summary["links"]:
        odd = [f"{link[key]} {words}" for key, words in _ODD.items() if link[key]]
        odd += [
            f"{count} {_HOST_END[key]} here" for key, count in link["host_end"].items() if count and key in _HOST_END
        ]
        if odd:
            yield "link", f"{link['name']}: {', '.join(odd)}"
    for takeover in summary["takeovers"]:
        yield (
            "takeover",
            f"{takeover['to_node']} for {takeover['from_node']} at {takeover['at_s']:.2f} s, which was silent for "
            f"{takeover['silent_s']:.2f} s; largest step {takeover['step']:.3f}",
        )
    collisions = summary["collisions"]
    if collisions is not None and collisions["count"]:
        yield "collisions", _collisions(collisions)
    pace = summary["pace"]
    if pace["slips"]:
        times = "once" if pace["slips"] == 1 else f"{pace['slips']} times"
        yield "stood still", f"{times}, {pace['slipped_s']:.1f} s in all: this machine did not run meanwhile"


def _node(node: dict[str, Any]) -> str:
    words = [node["nodes"].replace(",", " "), node["kind"], node["machine"], *node["flags"]]
    if node["link"] != "agent":
        words.insert(0, node["link"])
    for key, text in (("memory_mib", "{:.0f} MiB"), ("cpu_percent", "CPU {:.0f} %"), ("temperature_c", "{:.0f} °C")):
        if node[key] is not None:
            words.append(text.format(node[key]))
    words += [f"{node[key]} {text}" for key, text in _NODE.items() if node[key]]
    return ", ".join(word for word in words if word)


def _collisions(collisions: dict[str, Any]) -> str:
    with_what = ", ".join(f"{count} with {what}" for what, count in collisions["by"].items())
    return (
        f"{collisions['count']}: {with_what}; the first at {collisions['first_s']:.2f} s, "
        f"the hardest at {collisions['max_impact_mps']:.2f} m/s"
    )


def _actuators(actuators: dict[str, Any]) -> str:
    age = actuators["age_us"]
    text = f"{age['p50'] / 1e3:.1f} ms old when used, p99 {age['p99'] / 1e3:.1f}, at most {age['max'] / 1e3:.1f} ms"
    if actuators["stale"]:
        text += f"; none new at {actuators['stale']} exchanges, at most {actuators['longest_stale']} in a row"
    return text


def perception_rows(summary: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Rows of the report; none without a companion."""
    odometry, mapping, obstacles = summary["odometry"], summary["mapping"], summary["obstacles"]
    if odometry is not None and odometry["poses"]:
        yield "odometry", _odometry(odometry)
    if mapping is not None and mapping["points"]:
        yield "map", _map(mapping)
    companion = summary["companion"]
    if companion is not None and companion["gone_s"] is not None:
        yield "companion", f"gone from {companion['gone_s']:.1f} s on"
    for text in () if companion is None else companion["warnings"]:
        yield "companion", text
    if obstacles is not None and companion is not None:
        yield "obstacles", _obstacles(obstacles, companion)
        lost = companion["chunks_lost"] + companion["map_chunks_lost"]
        if lost or companion["clouds_dropped"]:
            yield "clouds", f"{lost} chunks lost, {companion['clouds_dropped']} clouds came too fast for the companion"


def _odometry(odometry: dict[str, Any]) -> str:
    ate_m, path_m = odometry["ate_rms_m"], odometry["path_m"]
    if ate_m is None:
        return f"{odometry['poses']} poses, too few to be held against the truth"
    share = f" ({100.0 * ate_m / path_m:.2f} % of {path_m:.0f} m)" if path_m else ""
    return f"{odometry['rate_hz']:.1f} Hz, ATE {ate_m:.2f} m{share}, RPE {odometry['rpe_m']:.2f} m in a second"


def _map(mapping: dict[str, Any]) -> str:
    text = f"{mapping['points']} points by lidar, {mapping['sonar_points']} by sonar"
    if mapping["boom_rms_m"] is not None:
        text += f"; {mapping['boom_rms_m']:.2f} m RMS off the log boom"
    if mapping["coverage"] is not None:
        text += f", {100.0 * mapping['coverage']:.0f} % of it seen"
    return text


def _obstacles(obstacles: dict[str, Any], companion: dict[str, Any]) -> str:
    text = f"{obstacles['detected']} of {obstacles['launched']} adrift detected, {obstacles['false']} false"
    if obstacles["min_clearance_m"] is not None:
        text += f", cleared by {obstacles['min_clearance_m']:.1f} m and more"
    return f"{text}; {companion['detours']} detours, {companion['stops']} stops"
