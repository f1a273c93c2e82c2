"""Runs with known causes, from analyze_cases.yaml."""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml
from numpy.random import Generator, default_rng

from tests.bench.analyze_scores import NONE

CASES = Path(__file__).with_suffix(".yaml")
_SITE = ("bases/base-sitl", "sites/santo-antonio")
_FAULT = "injected"
_SENSOR_FILES = ("rover-vectornav", "rover-no-simulated-sensors")


@dataclass(frozen=True, slots=True)
class Case:
    """A run and its cause."""

    name: str
    group: str
    """NONE for a clean run."""
    seed: int
    document: Mapping[str, Any]
    """Its profile."""
    onset_s: float | None
    """None for a clean run, and for a cause that holds from the start."""
    causes: tuple[str, ...]
    causes_in_log: tuple[str, ...]
    """Those that the autopilot's log alone can show."""
    effects: tuple[str, ...]
    notice: bool = False
    """Whether a notice names the cause too."""
    fine: tuple[str, ...] = ()
    """OK findings that do not contradict the cause."""

    @property
    def real_time(self) -> bool:
        return "hitl-loopback" in self.document["extends"]

    @property
    def run_name(self) -> str:
        return f"{self.name}-{self.seed}".replace("/", "-")


def read_table() -> dict[str, Any]:
    table: dict[str, Any] = yaml.safe_load(CASES.read_text(encoding="utf-8"))
    return table


ARDUPILOT = "ardupilot/"
"""Beginning of the names of the cases with a stock ArduPilot."""


def cases(seed: int) -> Iterator[Case]:
    """All cases of a seed with the embedded autopilot: those with a fault, then each vessel without one.

    The environment of a vessel changes from seed to seed.
    """
    table = read_table()
    for name, row in table["cases"].items():
        yield _faulty(name, row, table, table["embedded"], seed)
    environments = table["clean"]["environments"]
    for number, vehicle in enumerate(table["clean"]["vehicles"]):
        environment = environments[(number + seed) % len(environments)]
        profile = [*_SITE, f"vehicles/{vehicle}", f"environments/{environment}"]
        document = _document(profile, table, table["embedded"], {}, seed)
        yield Case(f"{vehicle}/{environment}", NONE, seed, document, None, (), (), ())


def ardupilot_cases(seed: int) -> Iterator[Case]:
    """All cases of a seed with a stock ArduPilot: those with a fault, then each vessel without one."""
    table = read_table()
    autopilot = table["ardupilot"]
    for name, changed in autopilot["cases"].items():
        row = {**table["cases"][name], **changed}
        row["set"] = {**table["cases"][name].get("set", {}), **changed.get("set", {})}
        yield _faulty(name, row, table, autopilot, seed)
    environments = table["clean"]["environments"]
    for number, (vehicle, files) in enumerate(autopilot["clean"].items()):
        environment = environments[(number + seed) % len(environments)]
        profile = [autopilot["profile"], f"vehicles/{vehicle}", f"environments/{environment}"]
        given = {"autopilot.parameter_files": [*_SENSOR_FILES, *files]}
        document = _document(profile, table, autopilot, given, seed)
        yield Case(f"{ARDUPILOT}{vehicle}/{environment}", NONE, seed, document, None, (), (), ())


def group_of_findings() -> dict[str, str]:
    """Group of each kind of finding that names a cause: the first one in the table."""
    groups: dict[str, str] = {}
    for row in read_table()["cases"].values():
        for cause in row["causes"]:
            groups.setdefault(cause, row["group"])
    return groups


def _faulty(
    name: str, row: Mapping[str, Any], table: Mapping[str, Any], autopilot: Mapping[str, Any], seed: int
) -> Case:
    rng = default_rng([seed, zlib.crc32(name.encode())])
    begin_s = float(round(rng.uniform(*autopilot["onset_s"]), 1))
    profile = [autopilot.get("profile", row.get("profile", "sitl")), *row.get("extends", ())]
    document = _document(profile, table, autopilot, row.get("set", {}), seed)
    onset_s = None
    if "fault" in row:
        onset_s = begin_s
        until = {"until_s": begin_s + row["lasts_s"]} if "lasts_s" in row else {}
        document["faults"] = {_FAULT: {"from_s": begin_s, **_drawn(row["fault"], rng), **until}}
    causes, effects = tuple(row["causes"]), tuple(row.get("effects", ()))
    in_log, notice, fine = tuple(row.get("in_log", causes)), row.get("notice", False), tuple(row.get("fine", ()))
    prefix = ARDUPILOT if autopilot is table["ardupilot"] else ""
    return Case(prefix + name, row["group"], seed, document, onset_s, causes, in_log, effects, notice, fine)


def _drawn(value: Any, rng: Generator) -> Any:
    """The value with a number in place of each `{between: [a, b]}`."""
    if isinstance(value, dict):
        if set(value) == {"between"}:
            return float(rng.uniform(*value["between"]))
        return {key: _drawn(part, rng) for key, part in value.items()}
    return [_drawn(part, rng) for part in value] if isinstance(value, list) else value


def _document(
    extends: list[str], table: Mapping[str, Any], autopilot: Mapping[str, Any], given: Mapping[str, Any], seed: int
) -> dict[str, Any]:
    document: dict[str, Any] = {"extends": extends}
    clock = {"clock.duration_s": autopilot["duration_s"], "clock.seed": seed}
    for key, value in {**table["set"], **autopilot["set"], **given, **clock}.items():
        group = document
        *groups, last = key.split(".")
        for part in groups:
            group = group.setdefault(part, {})
        group[last] = value
    return document
