"""Fault injection on links and agents by simulation time: combines, announces and records the active faults."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from functools import reduce
from operator import xor
from typing import Any

from agent.wire import dialect
from agent.wire.impaired import NO_FAULTS, LinkFaults
from sim_core.dataclass import dataclass
from xitl_cli.profile.schema.faults import (
    FAULT_GROUPS,
    AgentFault,
    BarometerFault,
    BatteryFault,
    FaultSpec,
    GnssFault,
    ImuFault,
    LinkFault,
    MagnetometerFault,
    PropellerFault,
    SensorFault,
)
from xitl_cli.record.recorder import Recorder
from xitl_cli.record.topics import FaultEvent
from xitl_cli.run.core.reports import FaultReport
from xitl_cli.seeds import Seeds

_WAYS = {"both": "to {} both ways", "sensors": "to {}", "actuators": "from {}"}
_BIASES = {
    ImuFault: (("gyro_bias_frd_radps", "gyro", "rad/s"), ("accel_bias_frd_mps2", "accel", "m/s²")),
    GnssFault: (("position_bias_ned_m", "position", "m"), ("velocity_bias_ned_mps", "velocity", "m/s")),
    MagnetometerFault: (("field_bias_frd_gauss", "field", "gauss"),),
    BarometerFault: (("pressure_bias_pa", "pressure", "Pa"),),
}


def describe_fault(fault: FaultSpec) -> str:
    """Return a text such as `link to the agent both ways: delay 0.1 s, loss 5 %; imu: gyro + [0, 0, 0.01] rad/s`."""
    parts: list[tuple[str, Iterable[str]]] = []
    if fault.link is not None:
        node = "the agent" if fault.link.which == "agent" else fault.link.which
        parts.append((f"link {_WAYS[fault.link.direction].format(node)}", _link(fault.link)))
    if fault.agent is not None:
        parts.append((fault.agent.which, _agent(fault.agent)))
    for name in ("imu", "gnss", "magnetometer", "barometer"):
        sensor = getattr(fault, name)
        if sensor is not None:
            parts.append((name, _sensor(sensor)))
    if fault.propeller is not None:
        which = fault.propeller.which
        parts.append((which if which.startswith("propeller") else f"{which} propeller", _propeller(fault.propeller)))
    if fault.rudder is not None:
        angle_deg = fault.rudder.jam_angle_deg
        jammed = "jammed at its angle" if angle_deg is None else f"jammed at {angle_deg:+g} degrees"
        parts.append((fault.rudder.which or "rudder", [jammed] if fault.rudder.jam or angle_deg is not None else []))
    if fault.battery is not None:
        parts.append(("battery", _battery(fault.battery)))
    return "; ".join(f"{name}: {', '.join(words)}" for name, words in parts)


def _link(link: LinkFault) -> Iterator[str]:
    if link.cut:
        yield "cut"
    for name in ("delay", "jitter"):
        if seconds := getattr(link, f"{name}_s"):
            yield f"{name} {seconds:g} s"
    for name in ("loss", "duplicate", "reorder"):
        if share := getattr(link, name):
            yield f"{name} {share * 100:.3g} % of the frames"


def _agent(agent: AgentFault) -> Iterator[str]:
    if agent.cpu_load:
        yield f"{agent.cpu_load:.0%} of every processor busy"
    if agent.clock_offset_s:
        yield f"clock {agent.clock_offset_s:g} s ahead"
    if agent.clock_skew_ppm:
        yield f"clock {agent.clock_skew_ppm:+g} ppm"


def _sensor(sensor: SensorFault) -> Iterator[str]:
    if sensor.dropout:
        yield f"{sensor.dropout * 100:.3g} % of the samples missing"
    if sensor.freeze:
        yield "values frozen"
    for key, name, unit in _BIASES[type(sensor)]:
        value = getattr(sensor, key)
        if isinstance(value, tuple):
            if any(value):
                yield f"{name} + [{', '.join(f'{part:g}' for part in value)}] {unit}"
        elif value:
            yield f"{name} + {value:g} {unit}"
    if isinstance(sensor, GnssFault) and sensor.drift_mps:
        yield f"position drifts {sensor.drift_mps:g} m/s to {sensor.drift_bearing_deg:g} degrees"


def _propeller(propeller: PropellerFault) -> Iterator[str]:
    if propeller.thrust_loss:
        yield f"{propeller.thrust_loss:.0%} of the thrust lost"
    if propeller.stuck_at is not None:
        yield f"stuck at {propeller.stuck_at:+.2f}"
    elif propeller.stuck:
        yield "stuck at its speed"
    if propeller.reversed:
        yield "reversed"


def _battery(battery: BatteryFault) -> Iterator[str]:
    if battery.added_resistance_ohm:
        yield f"{battery.added_resistance_ohm:g} ohm more resistance"
    if battery.failed_cells:
        yield f"{battery.failed_cells} cells failed"
    if battery.voltage_drop_v:
        yield f"{battery.voltage_drop_v:g} V less"


NEVER_NS = 1 << 62
_ALL = ""
_NOTICE = dialect.MAV_SEVERITY_NOTICE


@dataclass(frozen=True, slots=True)
class FaultsInForce:
    """The active faults of one link and of the agent behind it. The defaults mean no fault."""

    to_agent: LinkFaults = NO_FAULTS
    """The host applies them with `seed` in its ImpairedTransport. The agent gets the other fields in `message`."""
    from_agent: LinkFaults = NO_FAULTS
    cpu_load: float = 0.0
    clock_offset_s: float = 0.0
    clock_skew_ppm: float = 0.0
    seed: int = 0

    @property
    def cut(self) -> bool:
        """Whether no frame gets through in at least one direction."""
        return any(way.cut or way.loss >= 1.0 for way in (self.to_agent, self.from_agent))

    @property
    def on_agent(self) -> bool:
        """Whether the agent has a part in these faults."""
        return self.from_agent != NO_FAULTS or any((self.cpu_load, self.clock_offset_s, self.clock_skew_ppm))

    def message(self, sim_ns: int) -> Any:
        """Return the XITL_FAULTS that activates the agent's part."""
        link = self.from_agent
        return dialect.MAVLink_xitl_faults_message(
            time_usec=sim_ns // 1000,
            clock_offset_ns=round(self.clock_offset_s * 1e9),
            clock_skew_ppm=self.clock_skew_ppm,
            seed=self.seed ^ 1 if link != NO_FAULTS else 0,
            delay_usec=round(link.delay_s * 1e6),
            jitter_usec=round(link.jitter_s * 1e6),
            loss=link.loss,
            duplicate=link.duplicate,
            reorder=link.reorder,
            cpu_load=self.cpu_load,
            cut=int(link.cut),
        )


class FaultSchedule:
    """The faults of a profile in simulation time. `seeds` make random draws repeatable."""

    def __init__(self, faults: Mapping[str, FaultSpec], seeds: Seeds) -> None:
        self._seeds = seeds
        self._timed = [_Timed(name, fault, seeds) for name, fault in faults.items()]
        self._next_ns: dict[str, int] = {}
        self._in_force: dict[str, FaultsInForce] = {}
        self._next_said_ns = min((timed.from_ns for timed in self._timed), default=NEVER_NS)
        self._impaired: dict[str, tuple[int, int]] = {}

    def at(self, sim_ns: int, link: str = "agent") -> FaultsInForce | None:
        """Return the faults on `link` from now on, or None when they have not changed. Call it at every exchange."""
        if sim_ns < self._next_ns.get(link, 0):
            return None
        edges = [edge for timed in self._timed for edge in timed.edges_ns if edge > sim_ns]
        self._next_ns[link] = min(edges, default=NEVER_NS)
        faults = _combined([timed for timed in self._timed if timed.in_force(sim_ns)], link)
        if faults == self._in_force.get(link, FaultsInForce()):
            return None
        self._in_force[link] = faults
        return faults

    def changed(self, sim_ns: int) -> dict[str, FaultSpec] | None:
        """Return all active faults by name, or None when they have not changed since the last call."""
        if sim_ns < self._next_ns.get(_ALL, 0):
            return None
        edges = [edge for timed in self._timed for edge in timed.edges_ns if edge > sim_ns]
        self._next_ns[_ALL] = min(edges, default=NEVER_NS)
        return {timed.name: timed.fault for timed in self._timed if timed.in_force(sim_ns)}

    def set(self, name: str, fault: FaultSpec) -> None:
        """Add a fault, or replace the fault of this name.

        A fault with a new start begins again; otherwise only its end moves.
        """
        known = next((timed for timed in self._timed if timed.name == name), None)
        if known is None:
            self._timed.append(_Timed(name, fault, self._seeds))
        else:
            known.set(fault)
        self._next_ns.clear()
        self._next_said_ns = 0

    def record(self, sim_ns: int, recorder: Recorder) -> None:
        """Record and announce the faults that began or ended since the last call. Call it at every exchange."""
        if sim_ns < self._next_said_ns:
            return
        for timed in self._timed:
            if not timed.begun and timed.from_ns <= sim_ns:
                timed.begun = True
                recorder.write(sim_ns, FaultEvent(timed.name, active=True))
                recorder.log(sim_ns, _NOTICE, "run", f"fault {timed.name} begins: {describe_fault(timed.fault)}")
            if timed.begun and not timed.ended and timed.until_ns <= sim_ns:
                timed.ended = True
                recorder.write(sim_ns, FaultEvent(timed.name, active=False))
                recorder.log(sim_ns, _NOTICE, "run", f"fault {timed.name} ends")
        edges = [edge for timed in self._timed for edge in timed.edges_ns if edge > sim_ns]
        self._next_said_ns = min(edges, default=NEVER_NS)

    def names_in_force(self) -> tuple[str, ...]:
        """Return the names of the faults that `record` has announced as begun and not as ended."""
        return tuple(timed.name for timed in self._timed if timed.begun and not timed.ended)

    def count_impaired(self, to_agent: int, from_agent: int, told_ns: int | None, link: str = "agent") -> None:
        """Count the frames that faults dropped for good on `link` so far, in both directions. Call it after `record`.

        Each fault that was active since the last call gets the new frames. The agent reported its count at `told_ns`
        (simulation time, None if unknown). A fault that has ended therefore still gets the frames that the agent
        counted while the fault was active.
        """
        before = self._impaired.get(link, (0, 0))
        self._impaired[link] = to_agent, from_agent
        self._put_down(link, "sensors", "frames_lost_to_agent", to_agent - before[0], NEVER_NS)
        self._put_down(link, "actuators", "frames_lost_from_agent", from_agent - before[1], told_ns or 0)

    def _put_down(self, link: str, way: str, name: str, count: int, until_ns: int) -> None:
        """Add `count` to the faults of one direction.

        `until_ns`: simulation time up to which the frames were counted.
        """
        for timed in self._timed:
            fault = timed.fault.link
            if fault is None or fault.which != link or fault.direction not in ("both", way):
                continue
            if timed.begun and way not in timed.settled:
                if count > 0:
                    timed.did[name] = timed.did.get(name, 0) + count
                if timed.ended and until_ns >= timed.until_ns:
                    timed.settled.add(way)

    def reports(self, sensors: Mapping[str, Mapping[str, int]]) -> list[FaultReport]:
        """Return a report for each fault. `sensors`: counts of SensorSuite, by fault."""
        return [
            FaultReport(
                name=timed.name,
                kind=", ".join(timed.kinds),
                from_s=timed.fault.from_s if timed.begun else None,
                until_s=timed.fault.until_s if timed.ended else None,
                did={**timed.did, **sensors.get(timed.name, {})},
            )
            for timed in self._timed
        ]


class _Timed:
    """One fault, its interval in nanoseconds and its counts. It is active for from_ns <= time < until_ns."""

    def __init__(self, name: str, fault: FaultSpec, seeds: Seeds) -> None:
        self.name = name
        self.fault = fault
        self.from_ns, self.until_ns = span_ns(fault)
        self.seed = int(seeds.sequence(f"faults/{name}").generate_state(1)[0])
        self.kinds = [kind for kind in FAULT_GROUPS if getattr(fault, kind) is not None]
        self.begun = self.ended = False
        self.settled: set[str] = set()
        self.did: dict[str, int] = {}

    @property
    def edges_ns(self) -> tuple[int, int]:
        return self.from_ns, self.until_ns

    def set(self, fault: FaultSpec) -> None:
        if fault.from_s != self.fault.from_s:
            self.begun = self.ended = False
            self.settled.clear()
        self.fault = fault
        self.from_ns, self.until_ns = span_ns(fault)
        self.kinds = [kind for kind in FAULT_GROUPS if getattr(fault, kind) is not None]

    def in_force(self, sim_ns: int) -> bool:
        return self.from_ns <= sim_ns < self.until_ns


def span_ns(fault: FaultSpec) -> tuple[int, int]:
    """Return the interval of `fault` in nanoseconds. The end is exclusive."""
    return round(fault.from_s * 1e9), NEVER_NS if fault.until_s is None else round(fault.until_s * 1e9)


def _combined(timed: list[_Timed], link: str) -> FaultsInForce:
    """Combine all active faults on one link. The highest processor load counts; offsets and skews add up."""
    on_link = [fault for fault in timed if fault.fault.link is not None and fault.fault.link.which == link]
    links = [fault.fault.link for fault in on_link if fault.fault.link is not None]
    faults = [fault.fault.agent for fault in timed]
    agents = [agent for agent in faults if agent is not None and agent.which == link]
    return FaultsInForce(
        to_agent=_one_way([link for link in links if link.direction != "actuators"]),
        from_agent=_one_way([link for link in links if link.direction != "sensors"]),
        cpu_load=max((agent.cpu_load for agent in agents), default=0.0),
        clock_offset_s=math.fsum(agent.clock_offset_s for agent in agents),
        clock_skew_ppm=math.fsum(agent.clock_skew_ppm for agent in agents),
        seed=reduce(xor, (fault.seed for fault in on_link), 0),
    )


def _one_way(links: list[LinkFault]) -> LinkFaults:
    """Combine several faults on one direction. Delays add up; the shares of frames act independently of each other."""
    return LinkFaults(
        delay_s=math.fsum(link.delay_s for link in links),
        jitter_s=math.fsum(link.jitter_s for link in links),
        loss=_any_of([link.loss for link in links]),
        duplicate=_any_of([link.duplicate for link in links]),
        reorder=_any_of([link.reorder for link in links]),
        cut=any(link.cut for link in links),
    )


def _any_of(shares: list[float]) -> float:
    several = [share for share in shares if share]
    return several[0] if len(several) == 1 else 1.0 - math.prod(1.0 - share for share in several)
