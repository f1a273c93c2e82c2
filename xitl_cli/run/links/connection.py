"""Connection to one agent: reach it, start it, feed it, watch it, stop it."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from random import randrange
from typing import Any

from agent.assembly import AUTOPILOT_COMPONENT_ID, COMPANION_COMPONENT_ID
from agent.mavlink.exchange import Target
from agent.node import PROTOCOL
from agent.options import BRIDGE, COMPANION, FCU
from agent.timing.clock import wait_readable
from agent.wire import dialect
from agent.wire.impaired import NO_FAULTS, ImpairedTransport
from agent.wire.link import Link
from agent.wire.signing import Signing
from agent.wire.transport import Transport
from xitl_cli.errors import UserError
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.recorder import Recorder
from xitl_cli.run.core.faults import FaultsInForce
from xitl_cli.run.core.node import RunContext
from xitl_cli.run.core.reports import LinkReport, NodeReport
from xitl_cli.run.links.inbox import OWN_IDS, AgentInbox
from xitl_cli.run.links.link_accounts import link_state, node_report
from xitl_cli.run.links.peer import HOST_COMPONENT_ID, HOST_SYSTEM_ID, Peer
from xitl_cli.run.links.setup import Plans, set_parameters, upload_plan


@dataclass(frozen=True, slots=True)
class AgentTerms:
    """key: the profile's group. who: in sentences. node: what it has to announce, with --role `role`.

    target: its MAVLink system and component. says: what is missed when it is silent, and what it does (`speaks`) when
    it is back. silent_s: what is too long.
    """

    key: str
    who: str
    node: str
    role: str
    target: Target
    connect_timeout_s: float
    silent_s: float
    link_key_file: str | None = None
    says: str = "motor commands"
    speaks: str = "commands"


def autopilot_terms(profile: RunProfile, name: str) -> AgentTerms:
    """Of the agent called `name`: `agent`, or one in standby."""
    autopilot = profile.autopilot
    return AgentTerms(
        key="autopilot",
        who="the agent" if name == "agent" else f"the {name} agent",
        node="LC",
        role=FCU if autopilot.kind == "embedded" else BRIDGE,
        target=(autopilot.system_id, AUTOPILOT_COMPONENT_ID),
        connect_timeout_s=autopilot.connect_timeout_s,
        silent_s=autopilot.silent_s,
        link_key_file=autopilot.link_key_file,
    )


def companion_terms(profile: RunProfile) -> AgentTerms:
    """Of a profile that has one."""
    companion = profile.companion
    assert companion is not None
    return AgentTerms(
        key="companion",
        who="the companion",
        node="HC",
        role=COMPANION,
        target=(profile.autopilot.system_id, COMPANION_COMPONENT_ID),
        connect_timeout_s=companion.connect_timeout_s,
        silent_s=companion.silent_s,
        link_key_file=companion.link_key_file,
        says="word",
        speaks="is heard",
    )


def _silent_error(peer: str, who: str, seconds: float, sim_s: float) -> UserError:
    """Nothing came for so long."""
    return UserError(
        f"{peer}: {who} stopped answering and was silent for {seconds:.3g} s, at {sim_s:.2f} s of simulation time; "
        "look at its log, its power and the cable"
    )


def _restarted_error(peer: str, who: str, sim_s: float) -> UserError:
    """It is there, but knows of no run."""
    return UserError(
        f"{peer}: {who} answers but has no run on, at {sim_s:.2f} s of simulation time: it was started anew; look at "
        "its log for why it ended, then run again"
    )


def _taken_over_error(peer: str, who: str, sim_s: float) -> UserError:
    """It has the run of somebody else on."""
    return UserError(
        f"{peer}: {who} has another run on, at {sim_s:.2f} s of simulation time: another host has started it; give "
        "each host an agent of its own, and the link a key (--link-key), then run again"
    )


def _not_understood_error(terms: AgentTerms, link: Link) -> UserError | None:
    """Something came, but no good frame; None when nothing did."""
    where = link.transport.peer
    if link.refused_signature:
        return UserError(
            f"{where}: {terms.who} answers, but not signed with {terms.key}.link_key_file = {terms.link_key_file}; "
            "start it with --link-key and the same key, or leave it out here"
        )
    if link.counters.dropped:
        baud = "; or the baud rates differ" if link.transport.name == "serial" else ""
        return UserError(
            f"{where}: what answers there is not understood by this host; install the same release of xitl on "
            f"both{baud}"
        )
    return None


TICK_REPEAT_S = 0.5
POLL_S = 0.001  # where a link has no descriptor to wait for
SAID_S = 0.5


class Silence:
    """Watches one agent. It speaks when a motor command of its comes; `limit_s` of silence is more than a run takes.

    Each silence of at least `SAID_S` is told once when it is noticed and once when it ends. longest_s: the longest.
    One that a fault of ours makes says nothing of the agent: it is told, and not held against `limit_s`.
    """

    def __init__(self, limit_s: float, now_ns: int) -> None:
        self.longest_s = 0.0
        self._limit_ns = round(limit_s * 1e9)
        self._heard_ns = self._counted_from_ns = now_ns
        self._said = False

    @property
    def under_way(self) -> bool:
        """Whether a silence has been told and has not ended."""
        return self._said

    def heard(self, now_ns: int) -> float | None:
        """A motor command came: the length in seconds of the silence that it ends, if that was told."""
        silent_ns, self._heard_ns = now_ns - self._heard_ns, now_ns
        if not self._said:
            return None
        self._said = False
        self.longest_s = max(self.longest_s, silent_ns * 1e-9)
        return silent_ns * 1e-9

    def noticed(self, now_ns: int) -> bool:
        """Whether a silence is to be told now, for the first time."""
        silent_ns = now_ns - self._heard_ns
        if silent_ns < SAID_S * 1e9:
            return False
        self.longest_s = max(self.longest_s, silent_ns * 1e-9)
        new, self._said = not self._said, True
        return new

    def too_long(self, now_ns: int) -> bool:
        """Whether it has lasted longer than a run takes."""
        return now_ns - max(self._heard_ns, self._counted_from_ns) >= self._limit_ns

    def made_by_fault(self, now_ns: int) -> None:
        """Until now nothing can have been heard."""
        self._counted_from_ns = now_ns


HELLO_INTERVAL_S = 0.5
START_WAIT_S = 3.0
STOP_INTERVAL_S = 0.2
STOP_WAIT_S = 2.0
DRAIN_S = 1.0
QUIET_S = 0.1
SYNC_BURST = 10
FAULTS_REPEAT_NS = 1_000_000_000
NOTICE, WARNING = dialect.MAV_SEVERITY_NOTICE, dialect.MAV_SEVERITY_WARNING
_SOME_RUN = 1  # without a token

_NEVER_IMPAIRED = {dialect.MAVLINK_MSG_ID_XITL_RUN, dialect.MAVLINK_MSG_ID_XITL_FAULTS}


class StoppedWaitingError(Exception):
    """Somebody ends the run while an answer is waited for."""


@dataclass(frozen=True, slots=True)
class Supervision:
    """What a connection goes by while it waits, where an agent is only as quick as what is behind it.

    silent_s: how long it may be silent in lockstep. check: raises UserError when it is known to be gone. why_silent:
    what to say of so many seconds of silence until a second of simulation time.
    """

    silent_s: Callable[[], float]
    check: Callable[[], None] = lambda: None
    why_silent: Callable[[float, float], UserError] | None = None


class AgentConnection:
    """The agent called `name`, whose messages go to `inbox`. gone: why it cannot go on, None while it can.

    terms: those of the profile's autopilot where none are given. why_silent: see Supervision.
    """

    def __init__(
        self,
        name: str,
        profile: RunProfile,
        inbox: AgentInbox,
        signing: Signing | None = None,
        terms: AgentTerms | None = None,
        why_silent: Callable[[float, float], UserError] | None = None,
    ) -> None:
        self.name = name
        self.inbox = inbox
        self._terms = autopilot_terms(profile, name) if terms is None else terms
        self.gone: UserError | None = None
        self._why_silent = why_silent
        self._who = self._terms.who
        self._prefix = "" if name == "agent" else f"{name} "
        self._profile = profile
        self._lockstep = profile.clock.mode == "lockstep"
        self._token = 0 if self._lockstep else randrange(2, 256)
        self._reached = False
        self._strangers = 0
        self._signing = signing
        self._impaired: ImpairedTransport | None = None
        self._faults = FaultsInForce()
        self._faults_sent_ns = 0
        self._silence: Silence | None = None
        self._probed_ns = 0
        self._peer: Peer | None = None
        self._now_ns: Callable[[], int] = lambda: 0
        self._refused_before = 0

    # Before the run

    def reach(self, peer: Peer) -> None:
        """Say hello to an agent until it answers. Raises UserError when it does not, or speaks another dialect."""
        self._peer = peer
        transport = peer.transport
        if self._profile.faults:
            transport = self._impaired = self._impairable(transport)
        self.link = self.inbox.accounts.link = Link(transport, HOST_SYSTEM_ID, HOST_COMPONENT_ID, signing=self._signing)
        timeout_s = self._terms.connect_timeout_s
        say_hello = partial(self._send_run, dialect.XITL_RUN_COMMAND_HELLO)
        self._say_until(lambda: self.inbox.view.status is not None, say_hello, HELLO_INTERVAL_S, timeout_s, peer.check)
        if self.inbox.view.status is None:
            raise self._not_understood() or peer.unreachable(timeout_s)
        protocol = self.inbox.view.status.protocol
        if protocol != PROTOCOL:
            raise UserError(
                f"{transport.peer}: the agent speaks version {protocol} of the XITL dialect, "
                f"this host version {PROTOCOL}; install the same release of xitl on both"
            )
        info = self.inbox.view.info
        if info is not None and self._terms.node not in info.nodes.split(","):
            raise UserError(
                f"{transport.peer}: the agent there is no {self._terms.key}, it runs {info.nodes}; "
                f"start it with --role {self._terms.role}, or use another {self._terms.key}.link"
            )
        system_id, wanted = self.inbox.view.status.get_srcSystem(), self.target[0]
        if system_id != wanted:
            raise UserError(
                f"{transport.peer}: {self._who} there is MAVLink system {system_id}, autopilot.system_id is {wanted}; "
                f"start it with --system-id {wanted}, or use another {self._terms.key}.link"
            )
        self._reached = True

    def begin(
        self,
        context: RunContext,
        parameters: dict[str, float],
        plans: Plans,
    ) -> None:
        """Start it, set its parameters, upload its plans. Raises UserError when it does not take them."""
        self._now_ns = context.clock.now_ns
        self.inbox.begin(context)
        self.link.tap = self.inbox.tap
        self._start()
        lossless = self.link.transport.lossless
        set_parameters(self.target, parameters, self.link.send, self.receive, self._terms.key, lossless)
        for mission_type, items in plans.items():
            upload_plan(self.target, items, self.link.send, self.receive, lossless, mission_type)
        if not self._lockstep:
            for _ in range(SYNC_BURST):
                self.request_time()
                self.receive(0.02)
        self.inbox.timing.begin()

    def _start(self) -> None:
        """Start, and wait for the answer: both ends count their frames from behind the start message."""
        view = self.inbox.view
        view.status = None

        def start() -> None:
            self._send_run(dialect.XITL_RUN_COMMAND_START)
            self.link.reset_counters()

        said = self._say_until(self._has_our_run, start, HELLO_INTERVAL_S, START_WAIT_S, self.peer.check)
        if not self._has_our_run():
            raise self.peer.unreachable(START_WAIT_S)
        if said > 1:  # a start that is slow to arrive starts it once more
            self._receive_until(lambda: False, HELLO_INTERVAL_S)
        self.inbox.accounts.started()

    def _has_our_run(self) -> bool:
        """As far as its latest status tells: an agent of an earlier release tells of no token."""
        status = self.inbox.view.status
        return status is not None and status.running in (_SOME_RUN, self._token or _SOME_RUN)

    def _lost_run(self) -> UserError | None:
        """Why our run is not on there any more; None while it is."""
        if self.inbox.view.status is None or self._has_our_run():
            return None
        error = _taken_over_error if self.inbox.view.status.running else _restarted_error
        return error(self.peer.transport.peer, self._who, self._sim_s())

    # In the run

    @property
    def target(self) -> Target:
        """Its MAVLink system and component."""
        return self._terms.target

    @property
    def peer(self) -> Peer:
        """Where it runs; `reach` was told."""
        assert self._peer is not None
        return self._peer

    def send_sensors(self, messages: list[Any]) -> None:
        """Samples that are due."""
        self.inbox.timing.sent(messages)
        self.link.send(*messages)

    def send(self, message: Any) -> None:
        """An order, or whatever else the agent is to get."""
        self.link.send(message)

    def send_tick(self, sim_ns: int, tick: int) -> None:
        """Lockstep: all that was sampled up to now has been sent."""
        self._refused_before = self._refused
        self.link.send(dialect.MAVLink_xitl_tick_message(sim_ns // 1000, tick))
        self.peer.hand_over()

    def wait_for_answer(self, sim_ns: int, tick: int, silent_s: float, check: Callable[[], None]) -> None:
        """Lockstep: wait for the answer to a tick that was sent, and send it again; what comes meanwhile is taken in.

        Raises UserError when there is no answer for `silent_s` or the agent is known to be gone, and what `check`
        raises.
        """
        inbox = self.inbox
        self.receive(0.0)
        started_s = sent_s = looked_s = time.monotonic()
        while inbox.answered_tick != tick:
            self.receive(self.wait_s)
            if inbox.answered_tick == tick:
                return
            now_s = time.monotonic()
            if now_s - started_s > silent_s:
                raise self.silent(now_s - started_s)
            if now_s - looked_s > TICK_REPEAT_S:
                looked_s = now_s
                self.peer.check()
                check()
                if now_s - sent_s > self.again_s(TICK_REPEAT_S, silent_s):
                    self.send_tick(sim_ns, tick)
                    sent_s = now_s

    @property
    def wait_s(self) -> float:
        """How long to wait at a time for an answer: an agent in this process works only between the waits."""
        return POLL_S if self.link.transport.fileno() is None else TICK_REPEAT_S

    def again_s(self, interval_s: float, patience_s: float) -> float:
        """After how long to say again what was said last and is not answered: after `interval_s` if it may be lost.

        On a lossless transport an answer is late, as on a machine that is busy, and to ask twice would make the run
        another one: there it is asked again when half of the patience is over, as it would fail after the other half.
        """
        sure = self.link.transport.lossless and self._refused == self._refused_before
        return 0.5 * patience_s if sure else interval_s

    @property
    def _refused(self) -> int:
        """Changes when the transport has not taken something, or its connection has ended."""
        return self.link.transport.unsent + self.link.transport.losses

    def _say_until(
        self,
        heard: Callable[[], bool],
        say: Callable[[], object],
        interval_s: float,
        patience_s: float,
        check: Callable[[], object] = lambda: None,
    ) -> int:
        """Say it, as often as needed, until it is `heard` or the patience is over. Returns how often it was said."""
        began_s = said_s = time.monotonic()
        said = 0
        while not heard() and (now_s := time.monotonic()) - began_s < patience_s:
            check()
            if not said or now_s - said_s >= self.again_s(interval_s, patience_s):
                say()
                said, said_s = said + 1, now_s
            self._receive_until(heard, interval_s)
        return said

    def request_time(self) -> None:
        """Ask for its time stamps."""
        self.link.send(self.inbox.timing.request(self.link.counters.sent))

    def receive(self, timeout_s: float = 0.0) -> list[Any]:
        """Take in what has arrived; waits for it at most `timeout_s`."""
        self.peer.pump()
        messages = self.link.receive(timeout_s)
        if self._reached:
            messages = self._agents_own(messages)
        self.inbox.handle(messages)
        return messages

    def _agents_own(self, messages: list[Any]) -> list[Any]:
        """Without what claims to be between the two ends and has another sender: on a bus anybody may send."""
        own = self.target
        heard = [
            message
            for message in messages
            if message.get_msgId() < OWN_IDS or (message.get_srcSystem(), message.get_srcComponent()) == own
        ]
        self._strangers += len(messages) - len(heard)
        return heard

    def _receive_until(self, done: Callable[[], bool], seconds: float) -> bool:
        """Take in what arrives until it is done, which is returned, or time is up."""
        until_s = time.monotonic() + seconds
        while not done() and (left_s := until_s - time.monotonic()) > 0.0:
            self.receive(left_s)
        return done()

    def watch(self) -> None:
        """Real time: notice when it is gone, silent or started anew; `gone` then says so."""
        now_ns = time.monotonic_ns()
        if self._silence is None:
            self._silence = Silence(self._terms.silent_s, now_ns)
        silence, inbox = self._silence, self.inbox
        if self._faults.cut:
            silence.made_by_fault(now_ns)
        if inbox.fresh:
            lasted_s = silence.heard(inbox.command_ns)
            if lasted_s is not None:
                inbox.say(NOTICE, "run", f"{self._who} {self._terms.speaks} again after {lasted_s:.2f} s")
        try:
            self.peer.check()
        except UserError as error:
            self.gone = error
            return
        if silence.noticed(now_ns):
            inbox.say(WARNING, "run", f"no {self._terms.says} from {self._who} for {SAID_S:g} s")
        self.gone = self._lost_run()
        if self.gone is None and silence.under_way:
            if silence.too_long(now_ns):
                self.gone = self.silent(self._terms.silent_s)
            elif now_ns - self._probed_ns > HELLO_INTERVAL_S * 1e9:
                self._probed_ns = now_ns
                self._send_run(dialect.XITL_RUN_COMMAND_HELLO)

    def silent(self, seconds: float) -> UserError:
        """What to say when the run cannot go on without it."""
        if self._why_silent is not None:
            return self._why_silent(seconds, self._sim_s())
        return _silent_error(self.peer.transport.peer, self._who, seconds, self._sim_s())

    def _not_understood(self) -> UserError | None:
        return _not_understood_error(self._terms, self.link)

    def apply_faults(self, sim_ns: int, faults: FaultsInForce | None) -> None:
        """Put new faults in force, and remind the agent of its part once a second. None: as they were."""
        if faults is not None:
            self._faults = faults
            if self._impaired is None:  # the first that was not in the profile
                self._impaired = self._impairable(self.link.transport)
                self.link.go_through(self._impaired)
            self._impaired.set(faults.to_agent, faults.seed)
        elif not self._faults.on_agent or sim_ns - self._faults_sent_ns < FAULTS_REPEAT_NS:
            return
        self._faults_sent_ns = sim_ns
        self.link.send(self._faults.message(sim_ns))

    def _impairable(self, transport: Transport) -> ImpairedTransport:
        clock_s = self._sim_s if self._lockstep else time.monotonic
        return ImpairedTransport(transport, self._is_never_impaired, clock_s)

    def _is_never_impaired(self, message_id: int) -> bool:
        return message_id in _NEVER_IMPAIRED or (self._lockstep and message_id == dialect.MAVLINK_MSG_ID_XITL_TICK)

    # After the run

    def stop(self) -> None:
        """End the run at the other end too and let both ends agree on their counts, as far as it still answers."""
        self.inbox.accounts.over = True
        self.inbox.timing.settle()
        if self._peer is None or self.gone is not None:
            return
        if self._impaired is not None:
            self._impaired.set(NO_FAULTS)
        self._drain()
        inbox = self.inbox
        inbox.no_run = None
        began_s = time.monotonic()
        sent = 0

        def end() -> None:
            nonlocal sent
            self._send_run(dialect.XITL_RUN_COMMAND_STOP)
            sent = self.link.counters.sent

        said = self._say_until(lambda: inbox.no_run is not None, end, STOP_INTERVAL_S, STOP_WAIT_S)
        if inbox.no_run is None:
            return
        if not self._lockstep or said > 1:
            late = self._faults.from_agent
            took_s = time.monotonic() - began_s
            self._receive_until(lambda: False, max(QUIET_S, 1.2 * took_s, late.delay_s + late.jitter_s))
        inbox.view.status = inbox.no_run
        inbox.accounts.stopped(inbox.no_run, sent)

    def _drain(self) -> None:
        """Let what waits for the line or is delayed go out first."""
        transport, until_s = self.link.transport, time.monotonic() + DRAIN_S
        while (self.link.wake_s() is not None or transport.backlog_s() > 0.0) and time.monotonic() < until_s:
            self.receive(0.01)

    @property
    def is_open(self) -> bool:
        """Whether there is an agent to talk to, from `reach` to `close`."""
        return self._peer is not None and self.gone is None

    def close(self) -> None:
        """Give back process and sockets. Safe to call at any time."""
        if self._peer is not None:
            self._peer.close()
            self._peer = None

    # Reports

    @property
    def impaired(self) -> tuple[int, int, int | None]:
        """Frames that faults have kept back for good: towards the agent, and from it; and when the agent told."""
        status = self.inbox.view.status
        ours = 0 if self._impaired is None else self._impaired.lost
        if status is None:
            return ours, 0, None
        return ours, status.frames_impaired, self.inbox.sim_ns(status.time_usec)

    def links(self) -> tuple[LinkReport, LinkReport]:
        """Towards the agent, and from it."""
        inbox = self.inbox
        there, back = inbox.accounts.reports(self._prefix, self.impaired[0], inbox.view.status, inbox.timing)
        return there, replace(
            back, refused=(back.refused or 0) + self._strangers, host_end=self.link.transport.counts()
        )

    def warnings(self) -> list[str]:
        """What a person should know of its link."""
        there, back = self.links()
        told = {f"{self._who} refused": there.refused, f"the host refused on the link of {self._who}": back.refused}
        return [
            f"{who} {count} frames, datagrams or calls of others; /log says whose"
            for who, count in told.items()
            if count
        ]

    def record_links(self, recorder: Recorder, stamp_ns: int) -> None:
        """Keep how the link has done so far."""
        for report in self.links():
            recorder.write(stamp_ns, link_state(report))

    def node(self) -> NodeReport | None:
        """What it says of its machine, None when it never did."""
        status, info = self.inbox.view.status, self.inbox.view.info
        return None if status is None or info is None else node_report(self.name, info, status)

    def _sim_s(self) -> float:
        return self._now_ns() * 1e-9

    def _send_run(self, command: int) -> None:
        mode = dialect.XITL_CLOCK_MODE_LOCKSTEP if self._lockstep else dialect.XITL_CLOCK_MODE_REALTIME
        name = self._profile.name.encode()[:32]
        message = dialect.MAVLink_xitl_run_message(self._now_ns() // 1000, name, command, mode, PROTOCOL, self._token)
        self._refused_before = self._refused
        self.link.send(message)


def connections_report(agents: Sequence[AgentConnection]) -> dict[str, Any]:
    """What connections add to a run's report: links, tasks, clocks and nodes, and the traffic for its graph."""
    return {
        "links": [report for agent in agents for report in agent.links()],
        "tasks": [task for agent in agents for task in agent.inbox.view.tasks.values()],
        "clocks": [agent.inbox.timing.report() for agent in agents],
        "nodes": [report for agent in agents if (report := agent.node()) is not None],
        "warnings": [text for agent in agents for text in agent.warnings()],
        "traffic": {agent.name: agent.inbox.traffic for agent in agents},
    }


def wait_for_any(links: Sequence[Link], seconds: float) -> None:
    """Return when one of them has something to read or wants to be looked after, at the latest after `seconds`."""
    wakes_s = [wake_s for link in links if (wake_s := link.wake_s()) is not None]
    seconds = min([seconds, *wakes_s])
    if seconds <= 0.0:
        return
    descriptors = [link.transport.fileno() for link in links]
    present = [descriptor for descriptor in descriptors if descriptor is not None]
    if len(present) < len(descriptors):
        time.sleep(min(seconds, POLL_S))
        return
    wait_readable(present, seconds)
