"""Report of a run at a terminal."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rich.console import Console

from agent.bridges.counts import BridgeCounts
from agent.machine import EMULATED
from xitl_cli.commands.terminal import say, show_facts, show_rows
from xitl_cli.logs.model.text import plural
from xitl_cli.logs.signals.real_time import not_real_time
from xitl_cli.record.topics import LinkReport
from xitl_cli.run.core import directory
from xitl_cli.run.core.reports import NodeReport, troubles
from xitl_cli.run.session import Result

_MORE = (directory.DATAFLASH, directory.ULOG, directory.MISSION, directory.MAP, directory.TRAJECTORY, directory.TRUTH)


def show_result(console: Console, result: Result, verbose: bool = False) -> None:
    """Print the verdict, then a line each for mission, estimate, timing and links; verbose: all tables as well."""
    summary = result.summary
    for text, style in verdict_lines(summary):
        say(console, text, style)
    in_verdict = not_real_time(tuple(summary["verdict"]["shortfalls"]))
    warnings = [("warning", text, "yellow") for text in summary["warnings"] if text != in_verdict]
    if "vessels" in summary:
        show_fleet(console, summary, warnings, verbose)
    else:
        results = (*_one_line_each(summary), *perception_rows(summary), *ros_rows(summary), *incidents(summary))
        show_facts(console, [*results, *warnings, ("profile", _profile_text(summary))])
        if verbose:
            _show_all(console, summary)
    files = (directory.RECORDING, directory.SUMMARY, directory.PROFILE, *_MORE)
    contents = [name for name in files if (result.directory / name).exists()]
    if others := len(directory.next_recordings(result.directory)):
        contents.insert(1, f"{plural(others, 'more file')} of the recording")
    if "vessels" in summary:
        contents.append(f"{plural(len(summary['vessels']), 'folder')} of its vessels")
    console.print(f"{result.directory}/: {', '.join(contents)}", soft_wrap=True)


MOST_ROWS = 16
"""Rows in the table of a fleet. A larger fleet shows its worst vessels first, and a count of the others."""
_FLEET_HEADS = ("vessel", "mode", "waypoints", "cross-track", "speed", "estimate off", "closest")


def show_fleet(
    console: Console, summary: dict[str, Any], warnings: Sequence[tuple[str, str, str]], verbose: bool = False
) -> None:
    """Print a row for each vessel, its incidents, and the run; verbose: all vessels, and all tables of each as well."""
    vessels: dict[str, dict[str, Any]] = summary["vessels"]
    names = list(vessels) if verbose else worst_vessels(vessels, MOST_ROWS)
    styles = ["" if vessels[name]["driver"]["completed"] else "yellow" for name in names]
    show_rows(console, _FLEET_HEADS, [fleet_row(summary, name) for name in names], (0, 1), styles)
    hidden = [name for name in vessels if name not in names]
    if hidden:
        done = sum(vessels[name]["driver"]["completed"] for name in hidden)
        say(console, f"and {len(hidden)} more, {done} of them completed; see summary.json, or use --verbose")
    # What needs attention, of each vessel
    incidents_of_all: list[tuple[str, str]] = []
    for name, part in vessels.items():
        facts = [*perception_rows(part), *incidents(part)]
        facts += [("links", _links_line([link])) for link in part["links"] if link["lost"] or link["dropped"]]
        incidents_of_all += [(name, f"{label}: {text}") for label, text in facts]
    shown = incidents_of_all if verbose else incidents_of_all[:MOST_ROWS]
    if len(shown) < len(incidents_of_all):
        more = plural(len(incidents_of_all) - len(shown), "more incident")
        shown.append(("", f"and {more}; see summary.json"))
    own_warnings = [(name, text, "yellow") for name, part in vessels.items() for text in part["warnings"]]
    # The run
    every = {
        key: [*summary.get(key, ()), *(row for part in vessels.values() for row in part[key])]
        for key in ("tasks", "nodes")
    }
    profile = f"{summary['profile']} ({summary['technique']}, seed {summary['seed']}), {plural(len(vessels), 'vessel')}"
    run = (("timing", _timing({**every, "clocks": []})), ("profile", profile))
    show_facts(console, [*shown, *own_warnings, *ros_rows(summary), *warnings, *run])
    if verbose:
        for name, part in vessels.items():
            console.print()
            say(console, name, "bold")
            _show_all(console, {**part, "pace": None})
        console.print()
        nothing: dict[str, Any] = {key: [] for key in ("nodes", "links", "faults")}
        _show_all(console, {**summary, **nothing, "autopilot": None, "actuators": None})


def worst_vessels(vessels: Mapping[str, dict[str, Any]], count: int) -> list[str]:
    """Return all names if they are at most `count`.

    Otherwise, return the worst `count`: not completed first, then by cross-track error.
    """
    if len(vessels) <= count:
        return list(vessels)

    def badness(name: str) -> tuple[bool, float]:
        mission = vessels[name]["mission"] or {}
        return not vessels[name]["driver"]["completed"], mission.get("cross_track_rms_m") or 0.0

    return sorted(vessels, key=badness, reverse=True)[:count]


def fleet_row(summary: dict[str, Any], name: str) -> list[str]:
    """Return the cells of one vessel: its mode at the end of the run, all else over the run."""
    part = summary["vessels"][name]
    mission, track = part["mission"], part["track"]
    return [
        name,
        track["mode"] or "–",
        "–"
        if not mission or not mission["waypoints_total"]
        else f"{mission['waypoints_reached']}/{mission['waypoints_total']}",
        _number(mission["cross_track_rms_m"] if mission else None, "m"),
        _number(track["speed_mean_mps"], "m/s"),
        _number(part["estimation"]["position_rms_m"], "m"),
        _number(closest_m(summary, name), "m"),
    ]


def closest_m(summary: dict[str, Any], name: str) -> float | None:
    """Return the smallest hull distance to another vessel in m; None without a measurement."""
    return min(
        (
            pair["distance_m"]
            for pair in (summary.get("encounters") or {}).get("pairs", ())
            if name in pair["vessels"] and pair["distance_m"] is not None
        ),
        default=None,
    )


def verdict_lines(summary: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield (text, style): completed or not, with the reason; real time kept or not, with the reason."""
    verdict, ended = summary["verdict"], summary["ended"]
    if verdict["completed"]:
        yield f"completed: {verdict['why']}", "bold green"
    elif ended == "duration reached" and verdict["duration_asked"]:
        yield f"ended: {verdict['why']}", "bold green"
    elif ended in ("interrupted", "failed"):
        yield (verdict["why"] if ended == "interrupted" else f"failed: {verdict['why']}"), "bold red"
    else:
        yield f"not completed: {verdict['why']}", "bold red"
    took = f"{summary['duration_s']:.1f} s in {summary['wall_s']:.1f} s"
    factor = summary["real_time_factor"]
    slow = "" if summary["physics"]["compiled"] else ", physics in numpy"
    if verdict["real_time"] is None:
        yield f"lockstep: {took}" + (f", {factor:.1f}× real time" if factor else "") + slow, ""
    elif verdict["real_time"]:
        yield f"real time kept: {took}", "bold green"
    else:
        yield not_real_time(tuple(verdict["shortfalls"])), "bold red"


def _one_line_each(summary: dict[str, Any]) -> Iterator[tuple[str, str]]:
    mission, estimation = summary["mission"], summary["estimation"]
    if mission is not None and mission["waypoints_total"] and mission["cross_track_rms_m"] is not None:
        yield (
            "mission",
            f"{mission['waypoints_reached']} of {mission['waypoints_total']} waypoints, cross-track RMS "
            f"{_number(mission['cross_track_rms_m'], 'm')}, at most {_number(mission['cross_track_max_m'], 'm')}",
        )
    if estimation["position_rms_m"] is not None:
        yield (
            "estimate",
            f"off {_number(estimation['position_rms_m'], 'm')} RMS in position, "
            f"{_number(estimation['heading_rms_deg'], '°')} in heading",
        )
    if summary["tasks"]:
        yield "timing", _timing(summary)
    if summary["links"]:
        yield "links", _links_line(summary["links"])


def _timing(summary: dict[str, Any]) -> str:
    tasks = summary["tasks"]
    missed = [task for task in tasks if task["missed"]]
    cycles = sum(task["cycles"] for task in tasks)
    if not missed:
        text = f"none of {cycles} deadlines of {plural(len(tasks), 'task')} missed"
    else:
        counts = (f"{task['task']} {task['missed']} of {task['cycles'] + task['skipped']}" for task in missed)
        text = f"deadlines missed: {', '.join(counts)}"
    drifts = [clock for clock in summary["clocks"] if clock["drift_ppm"] and clock["node"] != "PS1"]
    for clock in drifts:
        text += f"; clock of {clock['node']} {clock['drift_ppm']:+.2f} ppm"
        if clock["drift_error_ppm"] is not None:
            text += f" (standard error {clock['drift_error_ppm']:.2g})"
    if any(node["machine"].startswith(EMULATED) for node in summary["nodes"]):
        text += "; the timing of an emulated board is that of its emulator"
    return text


def _links_line(links: list[dict[str, Any]]) -> str:
    """Summarize the links. A loss is unknown when the two ends did not agree at the end."""
    frames = sum(link["sent"] or link["received"] or 0 for link in links)
    troubles = [f"{link['lost']} lost of {link['name']}" for link in links if link["lost"]]
    for link in links:
        if link["lost"] is None and (link["sent"] or link["received"]):
            least = f", at least {link['gaps']}" if link["gaps"] else ""
            troubles.append(f"unknown number lost of {link['name']}{least}")
    troubles += [f"{link['dropped']} dropped of {link['name']}" for link in links if link["dropped"]]
    text = f"{frames} frames, {', '.join(troubles) or 'none lost'}"
    slow = [f"{link['name']} {link['latency_us']['p99'] / 1e3:.1f} ms" for link in links if link["latency_us"]["p99"]]
    return text + (f"; latency, 99 %: {', '.join(slow)}" if slow else "")


def _profile_text(summary: dict[str, Any]) -> str:
    graph = summary["graph"]
    measured = graph["measured"]["wdri"]
    text = (
        f"{summary['profile']} ({summary['technique']}, seed {summary['seed']}), "
        f"WDRI {summary['wdri']:.2f} claimed, {'none' if measured is None else f'{measured:.2f}'} measured"
    )
    if graph["missing"]:
        text += f"\nclaimed links without data: {', '.join(graph['missing'])}"
    if graph["unclaimed"]:
        text += f"\nlinks with data, not claimed: {', '.join(graph['unclaimed'])}"
    if graph["overclaimed"]:
        text += f"\nnodes claimed real, but virtual: {', '.join(graph['overclaimed'])}"
    return text


def _show_all(console: Console, summary: dict[str, Any]) -> None:
    show_facts(console, [*autopilot_rows(summary["autopilot"]), *details(summary)])
    for heads, rows, text_columns in _tables(summary):
        if rows:
            console.print()
            show_rows(console, heads, rows, text_columns)


def _tables(summary: dict[str, Any]) -> Iterator[tuple[tuple[str, ...], list[list[str]], tuple[int, ...]]]:
    """Yield headings, rows and the numbers of the text columns of each table."""
    rows = [
        [
            link["name"],
            *(_count(link[key]) for key in ("sent", "received", "lost", "dropped")),
            *(_number(link["latency_us"][key]) for key in ("p50", "p99", "max")),
        ]
        for link in summary["links"]
    ]
    yield ("link", "sent", "received", "lost", "dropped", "p50 µs", "p99 µs", "max µs"), rows, (0,)
    rows = [
        [
            task["node"],
            task["task"],
            f"{task['rate_hz']:g}",
            *(_count(task[key]) for key in ("cycles", "missed")),
            *(_number(task[key]) for key in ("start_jitter_p99_us", "start_jitter_max_us", "run_p99_us", "run_max_us")),
        ]
        for task in summary["tasks"]
    ]
    yield ("node", "task", "Hz", "cycles", "missed", "late p99", "max µs", "run p99", "max µs"), rows, (0, 1)
    # Clocks: drift in ppm, its standard error from the fit, and its variation over 10 s. The table fits in 80 columns
    # for machines with an uptime of up to three years.
    rows = []
    for clock in summary["clocks"]:
        offset_us, slope_std_s = clock["offset_us"], clock["slope_std_s"]
        long = offset_us is not None and abs(offset_us) >= 1e5
        rows.append(
            [
                clock["node"],
                f"{offset_us * 1e-6:.4f} s" if long else _number(offset_us, "µs"),
                _number(clock["asymmetry_bound_us"]),
                *(
                    "–" if clock[key] is None else f"{clock[key]:.2f}"
                    for key in ("drift_ppm", "drift_error_ppm", "drift_std_ppm")
                ),
                "–" if clock["slope_s"] is None else f"{clock['slope_s'] * 1e3:.5f}",
                _number(None if slope_std_s is None else slope_std_s * 1e6),
                _count(clock["steps"]),
            ]
        )
    yield ("clock", "offset", "± µs", "drift", "± ppm", "varies", "sample ms", "varies µs", "steps"), rows, (0,)
    rows = []
    for fault in summary["faults"]:
        begin = "never" if fault["from_s"] is None else f"{fault['from_s']:g}"
        end = "–" if fault["from_s"] is None else "the end"
        if fault["until_s"] is not None:
            end = f"{fault['until_s']:g}"
        effects = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in fault["did"].items())
        rows.append([fault["name"], begin, end, effects or "–"])
    yield ("fault", "from s", "until s", "effects"), rows, (0, 3)


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


def autopilot_rows(section: dict[str, Any] | None) -> Iterator[tuple[str, str]]:
    """Yield (label, text) of `autopilot` in summary.json."""
    if section is None:
        return
    yield "autopilot", " ".join(filter(None, (section["kind"], section["vehicle"], section["firmware"])))
    times = [f"{word} {section[key]:.1f} s" for key, word in _TIMES.items() if section[key] is not None]
    if times:
        yield "", ", ".join(times)
    if not section["log"]:
        yield "", "its log stays on its machine" if section["program"] is None else "it wrote no log"
    counts = section["bridge"]
    if counts is not None:
        sent = ", ".join(f"{counts[key]} {word}" for key, word in _SENT.items() if counts[key])
        words = [f"{counts['outputs_in']} outputs back"]
        if counts["world_rate"]:
            words.append(f"world at {counts['world_rate']} Hz")
        words += [f"{counts[key]} {word}" for key, word in troubles(BridgeCounts).items() if counts[key]]
        yield "bridge", (f"frames in: {sent}" if sent else "no frames in") + f"\n{', '.join(words)}"
    scheduler = section["scheduler"]
    if scheduler is not None:
        words = [] if scheduler["long_loops"] is None else [f"{scheduler['long_loops']} long"]
        if scheduler["loops"] is not None:
            words.append(f"of {scheduler['loops']} loops")
        text = " ".join(words)
        if scheduler["max_us"] is not None:
            text += f", longest {scheduler['max_us'] / 1e3:.1f} ms"
        if scheduler["load_max_percent"] is not None:
            text += f", load {scheduler['load_mean_percent']:.1f} %, at most {scheduler['load_max_percent']:.1f} %"
        if section["clock"] != "real":
            text += "\n(measured by its simulated clock, not in processor time)"
        agent = section["agent"]
        yield "scheduler", f"{text}\nthe agent missed {agent['missed']} of {agent['cycles']} cycles"


_MACHINE_STATE = {"memory_mib": "{:.0f} MiB", "cpu_percent": "CPU {:.0f} %", "temperature_c": "{:.0f} °C"}
_HOST_END = {
    "losses": "lost connections",
    "errors": "bus errors",
    "incomplete": "incomplete transfers",
    "malformed": "malformed frames",
    "foreign": "foreign frames",
}


def incidents(summary: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield (label, text) of incidents that need attention, from summary.json."""
    for takeover in summary["takeovers"]:
        yield (
            "takeover",
            f"{takeover['to_node']} for {takeover['from_node']} at {takeover['at_s']:.2f} s, which was silent for "
            f"{takeover['silent_s']:.2f} s; largest step {takeover['step']:.3f}",
        )
    for event in summary["autopilot_events"]:
        if event["event"] == "failsafe":
            yield "failsafe", f"{event['reason']} at {event['at_s']:.1f} s"
        elif event["event"] == "fence limits speed":
            yield "fence", f"limits the speed at {event['at_s']:.1f} s, in mode {event['mode']}"
    begun = [fault["name"] for fault in summary["faults"] if fault["from_s"] is not None]
    if begun:
        yield "faults", f"injected: {', '.join(begun)}"
    collisions = summary["collisions"]
    if collisions is not None and collisions["count"]:
        bodies = ", ".join(f"{count} with {body}" for body, count in collisions["by"].items())
        yield (
            "collisions",
            f"{collisions['count']}: {bodies}; the first at {collisions['first_s']:.2f} s, "
            f"the hardest at {collisions['max_impact_mps']:.2f} m/s",
        )


def details(summary: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield (label, text) about machines, commands and links, from summary.json."""
    for node in summary["nodes"]:
        words = [node["nodes"].replace(",", " "), node["kind"], node["machine"], *node["flags"]]
        if node["link"] != "agent":
            words.insert(0, node["link"])
        words += [text.format(node[key]) for key, text in _MACHINE_STATE.items() if node[key] is not None]
        words += [f"{node[key]} {text}" for key, text in troubles(NodeReport).items() if node[key]]
        yield "node", ", ".join(word for word in words if word)
    actuators = summary["actuators"]
    if actuators is not None and actuators["age_us"]["max"]:
        p50_ms, p99_ms, max_ms = (actuators["age_us"][key] / 1e3 for key in ("p50", "p99", "max"))
        text = f"{p50_ms:.1f} ms old when used, p99 {p99_ms:.1f}, at most {max_ms:.1f} ms"
        if actuators["stale"]:
            text += f"; none new at {actuators['stale']} exchanges, at most {actuators['longest_stale']} in a row"
        yield "commands", text
    for link in summary["links"]:
        odd = [f"{link[key]} {words}" for key, words in troubles(LinkReport).items() if link[key]]
        odd += [
            f"{count} {_HOST_END[key]} here" for key, count in link["host_end"].items() if count and key in _HOST_END
        ]
        if odd:
            yield "link", f"{link['name']}: {', '.join(odd)}"
    pace = summary["pace"]
    if pace is not None and pace["slips"]:
        yield (
            "suspended",
            f"{plural(pace['slips'], 'time')}, {pace['slipped_s']:.1f} s in all: this machine did not run",
        )


def ros_rows(summary: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield a row on the messages to and from ROS nodes; none without ROS."""
    ros = summary.get("ros")
    if ros is None:
        return
    published, received, dropped = (sum(ros[key].values()) for key in ("published", "received", "dropped"))
    topics = len(ros["published"])
    text = f"{plural(published, 'message')} on {plural(topics, 'topic')} out, {received} in"
    if ros["refused"]:
        text += f", {ros['refused']} of them rejected"
    yield "ROS", text
    if dropped:
        worst = max(ros["dropped"], key=ros["dropped"].__getitem__)
        yield "ROS", f"the bridge was too slow for {dropped} recorded messages and dropped them, most of {worst}"


def perception_rows(summary: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield rows on the radar and on the companion's results; none without them."""
    radar = (summary["perception"] or {}).get("radar")
    if radar is not None:
        yield "radar", f"{radar['turns']} turns, {radar['plots']} plots"
    odometry, mapping, obstacles = summary["odometry"], summary["mapping"], summary["obstacles"]
    if odometry is not None and odometry["poses"]:
        ate_m, path_m = odometry["ate_rms_m"], odometry["path_m"]
        if ate_m is None:
            text = f"{odometry['poses']} poses, too few to compare with the truth"
        else:
            text = "" if odometry["rate_hz"] is None else f"{odometry['rate_hz']:.1f} Hz, "
            text += f"ATE {ate_m:.2f} m"
            if path_m:
                text += f" ({100.0 * ate_m / path_m:.2f} % of {path_m:.0f} m)"
            text += f", {odometry['anchored_rms_m']:.2f} m from a common start"
            if odometry["rpe_m"] is not None:
                text += f", RPE {odometry['rpe_m']:.2f} m in a second"
        yield "odometry", text
    if mapping is not None and mapping["points"]:
        text = f"{mapping['points']} points by lidar, {mapping['sonar_points']} by sonar"
        if mapping["boom_rms_m"] is not None:
            text += f"; {mapping['boom_rms_m']:.2f} m RMS off the log boom within a metre of it"
        if mapping["boom_uncut_rms_m"] is not None:
            text += f", {mapping['boom_uncut_rms_m']:.2f} m for all of its points"
        if mapping["coverage"] is not None:
            text += f", {100.0 * mapping['coverage']:.0f} % of it seen"
        yield "map", text
    companion = summary["companion"]
    if companion is None:
        return
    if companion["gone_s"] is not None:
        yield "companion", f"lost at {companion['gone_s']:.1f} s"
    for text in companion["warnings"]:
        yield "companion", text
    if obstacles is not None:
        text = (
            f"{obstacles['detected']} of {obstacles['launched']} floating bodies detected, {obstacles['false']} false"
        )
        if obstacles["min_clearance_m"] is not None:
            text += f", smallest clearance {obstacles['min_clearance_m']:.1f} m"
        yield "obstacles", f"{text}; {plural(companion['detours'], 'detour')}, {plural(companion['stops'], 'stop')}"
        if companion["detections"] and obstacles["classes"]:
            classes = ", ".join(
                f"{one['right']} of {one['tracked']} {name}" for name, one in obstacles["classes"].items()
            )
            matched = f"{companion['detections_matched']} of {companion['detections']} detections matched"
            yield "classes", f"right for {classes}; {matched}"
        lost = companion["chunks_lost"] + companion["map_chunks_lost"]
        if lost or companion["clouds_dropped"]:
            dropped = companion["clouds_dropped"]
            yield "clouds", f"{lost} chunks lost; the companion was too slow for {dropped} clouds and dropped them"
