"""What did not go as it should in a run, and on what it ran: rows for the report, none where all was well."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

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
