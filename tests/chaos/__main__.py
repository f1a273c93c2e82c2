"""`make chaos SEED=1 EVENTS=200`: random events against host, autopilot and companion, and what must hold after each.

After each event: the outputs are neutral within their time-out, the recording is readable to one second before the
event, one sentence at the terminal names it, and the outputs resume. After each run: the counts of both ends add up.
The result is also in OUT/chaos.json. Exit code 1 if something does not hold.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import subprocess
import sys
import time
import traceback
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from tests.bench.soak_long import link_problems
from tests.chaos.events import ANOTHER_TIME, DISK_FULL, EVENTS, Effect, Event
from tests.chaos.rig import AGENT, COMPANION, Rig, count, time_namespaces_permitted
from tests.patience import let_pass, wait_until
from xitl_cli.logs import open_log

NEUTRAL_S = 0.25 + 0.5
"""FS_IMU_TIMEOUT, and the time for a cycle of 20 ms, a message each 40 ms and the start of two programs under load."""
READABLE_S = 1.0 + 0.1
"""A recording is flushed once a second, at an exchange."""
DISK_MB = 48
_MOUNTED = "XITL_CHAOS_DISK"


@dataclass
class Outcome:
    """Outcome of an event. neutral_s, unreadable_s: None if the event says nothing about them."""

    event: str
    run: int
    problems: list[str] = field(default_factory=list)
    neutral_s: float | None = None
    """From the loss of the sensors to the last output that was not neutral."""
    unreadable_s: float | None = None
    """Simulation time from the end of the readable recording to the event."""


@dataclass(frozen=True, slots=True)
class PlannedRun:
    events: tuple[Event, ...]
    clock_step_s: float | None


def plan(seed: int, events: int, kinds: Sequence[Event]) -> list[PlannedRun]:
    """Draw events, in runs: a run ends with an event that ends it, or after five."""
    draw = random.Random(seed)
    runs: list[PlannedRun] = []
    while events > 0:
        chosen: list[Event] = []
        while len(chosen) < min(events, 5) and not (chosen and chosen[-1].ends):
            alone = any(event.name in ("companion killed", "companion restarted") for event in chosen)
            possible = [
                event
                for event in kinds
                if not (event.first and chosen) and not (alone and event.name.startswith("companion"))
            ]
            chosen.append(draw.choice(possible))
        step_s = round(draw.uniform(0.1, 2.0), 3) if chosen[0].first else None
        runs.append(PlannedRun(tuple(chosen), step_s))
        events -= len(chosen)
    return runs


class Chaos:
    """Makes the planned runs on one rig. outcomes: of all events."""

    def __init__(self, rig: Rig, seed: int) -> None:
        self._rig = rig
        self._draw = random.Random(seed)
        self.outcomes: list[Outcome] = []

    def run(self, number: int, planned: PlannedRun) -> None:
        rig = self._rig
        rig.begin_run(number, planned.clock_step_s)
        effects = []
        for event in planned.events:
            outcome = Outcome(event.name, number)
            self.outcomes.append(outcome)
            if not event.first:
                let_pass(self._draw.uniform(0.2, 1.0))
            effect = self._event(event, outcome)
            effects.append(effect)
            print(
                f"{len(self.outcomes):4} run {number:3} {event.name:30} " + ("; ".join(outcome.problems) or "holds"),
                flush=True,
            )
        if not planned.events[-1].ends:
            rig.host.process.terminate()
            wait_until(lambda: rig.host.gone, "the run does not end")
        self.outcomes[-1].problems += self._count_problems(effects)
        shutil.rmtree(rig.run_folder)

    def _event(self, event: Event, outcome: Outcome) -> Effect:
        rig = self._rig
        said = {"host": rig.host.said, "station": self._texts()}
        at_s = rig.line.sim_s
        effect = event.act(rig, self._draw)
        outcome.problems += self._sentence_problems(effect, said[effect.speaker])
        if effect.starved_s is not None:
            outcome.neutral_s, problems = self._neutral(*effect.starved_s)
            outcome.problems += problems
        if effect.code is not None and rig.host.process.wait() != effect.code:
            outcome.problems.append(f"exit code {rig.host.process.returncode}, not {effect.code}")
        outcome.unreadable_s, problems = self._readable(at_s)
        outcome.problems += problems
        rig.absent |= effect.gone
        if effect.code is None:
            try:
                rig.wait_for_drive()
            except AssertionError as error:
                outcome.problems.append(str(error))
        return effect

    def _texts(self) -> str:
        return "\n".join(text for _, text in self._rig.outputs.texts.copy())

    def _sentence_problems(self, effect: Effect, before: str) -> Iterator[str]:
        def added() -> int:
            now = self._rig.host.said if effect.speaker == "host" else self._texts()
            return count(effect.sentence, now, effect.least) - count(effect.sentence, before, effect.least)

        try:
            wait_until(lambda: added() > 0, patience_s=effect.sentence_s)
        except AssertionError:
            yield f"no sentence at the {effect.speaker} like {effect.sentence!r}"
            return
        if added() > 1:
            yield f"{added()} sentences at the {effect.speaker} like {effect.sentence!r}"

    def _neutral(self, began_s: float, ended_s: float) -> tuple[float | None, list[str]]:
        """Return when the last output was not neutral, and what is wrong with that."""
        seen = [
            (at_s - began_s, neutral) for at_s, neutral in self._rig.outputs.outputs.copy() if began_s < at_s < ended_s
        ]
        if not any(at_s > NEUTRAL_S for at_s, _ in seen):
            return None, [] if ended_s - began_s < NEUTRAL_S + 0.2 else ["no outputs were heard"]
        last_s = max((at_s for at_s, neutral in seen if not neutral), default=0.0)
        return last_s, [f"outputs neutral after {last_s:.2f} s"] if last_s > NEUTRAL_S else []

    def _readable(self, at_s: float) -> tuple[float | None, list[str]]:
        """Read the recording as it is. at_s: simulation time of the event."""
        try:
            with open_log(self._rig.run_folder) as log:
                health = log.health
                newest_s = float(log["/truth/state"].stamp_ns[-1]) * 1e-9
        except Exception as error:  # noqa: BLE001  any error is a finding
            return None, [f"the recording cannot be read: {error!r}"]
        problems = [f"the recording is damaged: {health.as_json()}"] if health.damaged or health.lost_bytes else []
        if at_s - newest_s > READABLE_S:
            problems.append(f"readable to {newest_s:.2f} s, event at {at_s:.2f} s")
        return at_s - newest_s, problems

    def _count_problems(self, effects: Sequence[Effect]) -> Iterator[str]:
        """Check the counts of the finished run against each other and against those of the cables."""
        rig = self._rig
        if rig.host.process.returncode == -9:
            return
        try:
            summary = rig.summary()
        except (OSError, ValueError) as error:
            yield f"no summary: {error}"
            return
        gone = {name for effect in effects for name in effect.gone}
        dropping = any(effect.dropping for effect in effects) or summary["pace"]["slips"] > 0
        links = [link for link in summary["links"] if not any(link["name"] in _directions(name) for name in gone)]
        yield from link_problems({"links": links})
        for name, cable in rig.line.cables.items():
            if name in gone:
                continue
            withheld = dict(zip(_directions(name), (cable.withheld_to_agent, cable.withheld_from_agent), strict=True))
            for link in links:
                lost, known = link["lost"], withheld.get(link["name"])
                if known is not None and lost is not None and (lost < known or (lost > known and not dropping)):
                    yield f"{link['name']}: {lost} lost, the cable withheld {known}"


def _directions(name: str) -> tuple[str, str]:
    prefix = "" if name == AGENT else f"{COMPANION} "
    return f"{prefix}sensors", f"{prefix}actuators"


def chaos(folder: Path, seed: int, events: int, small_disk: bool) -> dict[str, Any]:
    """Make a chaos in `folder`. small_disk: folder/disk is a small file system. Writes folder/chaos.json."""
    kinds = [*EVENTS, *([DISK_FULL] if small_disk else []), *([ANOTHER_TIME] if time_namespaces_permitted() else [])]
    began_s = time.monotonic()
    rig = Rig(folder)
    chaos = Chaos(rig, seed)
    problems = []
    runs = plan(seed, events, kinds)
    try:
        for number, planned in enumerate(runs, start=1):
            try:
                chaos.run(number, planned)
            except Exception as error:  # noqa: BLE001  any error is a finding, and the next run may tell more
                problems.append(f"run {number}: {error!r}\n{traceback.format_exc()}")
                rig.host.kill()
                shutil.rmtree(rig.run_folder, ignore_errors=True)
    finally:
        rig.close()
    problems += [
        f"run {outcome.run}, {outcome.event}: {problem}" for outcome in chaos.outcomes for problem in outcome.problems
    ]
    result = {
        "seed": seed,
        "events": len(chaos.outcomes),
        "runs": len(runs),
        "seconds": time.monotonic() - began_s,
        "without": [event.name for event in (DISK_FULL, ANOTHER_TIME) if event not in kinds],
        "outcomes": [asdict(outcome) for outcome in chaos.outcomes],
        "problems": problems,
    }
    (folder / "chaos.json").write_text(json.dumps(result, indent=1))
    return result


def printed(result: dict[str, Any]) -> str:
    """Return the result as a table of the kinds of events, and the problems."""
    lines = [
        f"seed {result['seed']}: {result['events']} events in {result['runs']} runs, {result['seconds']:.0f} s",
        "",
        f"{'event':31} {'number':>6} {'failed':>6} {'neutral after s':>15} {'unreadable s':>12}",
    ]
    outcomes = result["outcomes"]
    for name in sorted({outcome["event"] for outcome in outcomes}):
        of_kind = [outcome for outcome in outcomes if outcome["event"] == name]
        worst = {}
        for key in ("neutral_s", "unreadable_s"):
            known = [outcome[key] for outcome in of_kind if outcome[key] is not None]
            worst[key] = f"{max(known):.2f}" if known else "–"
        failed = sum(bool(outcome["problems"]) for outcome in of_kind)
        lines.append(f"{name:31} {len(of_kind):6} {failed:6} {worst['neutral_s']:>15} {worst['unreadable_s']:>12}")
    lines += [f"not permitted here: {name}" for name in result["without"]]
    lines += ["", *(f"FAIL: {problem}" for problem in result["problems"])] if result["problems"] else ["", "pass"]
    return "\n".join(lines)


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.chaos", description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--events", type=int, default=200)
    parser.add_argument("--out", type=Path, default=Path("build/chaos"))
    options = parser.parse_args()
    folder = options.out.absolute()
    disk = folder / "disk"
    if _MOUNTED not in os.environ:
        shutil.rmtree(folder, ignore_errors=True)
        disk.mkdir(parents=True)
        mount = f'mount -t tmpfs -o size={DISK_MB}m none "$0" && exec "$@"'
        if os.geteuid() == 0 and shutil.which("unshare") is not None:
            command = ["unshare", "--mount", "sh", "-c", mount, str(disk), sys.executable, "-m", "tests.chaos"]
            again = subprocess.run([*command, *sys.argv[1:]], env={**os.environ, _MOUNTED: "1"}, check=False)
            return again.returncode
    result = chaos(folder, options.seed, options.events, small_disk=_MOUNTED in os.environ)
    print(printed(result))
    return 1 if result["problems"] else 0


if __name__ == "__main__":
    sys.exit(main())
