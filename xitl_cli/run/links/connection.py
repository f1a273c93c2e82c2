"""Connection to one agent: connect, start, send, monitor and stop."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
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
from sim_core.dataclass import dataclass
from xitl_cli.errors import UserError
from xitl_cli.graph.graph import AgentTraffic
from xitl_cli.profile.schema import RunProfile
from xitl_cli.record.recorder import Recorder
from xitl_cli.record.topics import LinkReport
from xitl_cli.run.core.faults import FaultsInForce
from xitl_cli.run.core.node import RunContext
from xitl_cli.run.core.reports import NodeReport
from xitl_cli.run.links.inbox import OWN_IDS, AgentInbox
from xitl_cli.run.links.link_accounts import agent_traffic, node_report
from xitl_cli.run.links.peer import HOST_COMPONENT_ID, HOST_SYSTEM_ID, Peer
from xitl_cli.run.links.setup import Plans, set_parameters, upload_plan


@dataclass(frozen=True, slots=True)
class AgentTerms:
    """How a connection identifies and names its agent."""

    key: str
    """Group of the profile."""
    who: str
    """Name of the agent in sentences."""
    node: str
    """Node that the agent has to announce."""
    role: str
    """Value of its option --role."""
    target: Target
    """MAVLink system and component."""
    connect_timeout_s: float
    silent_s: float
    """Silence in seconds that ends the run."""
    link_key_file: str | None = None
    says: str = "motor commands"
    """Messages that are missing during a silence."""
    speaks: str = "commands"
    """Verb for the return of those messages."""


def autopilot_terms(profile: RunProfile, name: str) -> AgentTerms:
    """Return the terms of the agent called `name`: `agent`, or an agent in standby."""
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
    """Return the terms of the companion. The profile must have a companion."""
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


TICK_REPEAT_S = 0.5
POLL_S = 0.001  # for a link without a descriptor to wait for
SAID_S = 0.5


class Silence:
    """Monitors the silence of one agent, from one motor command to the next. A run ends after `limit_s` of silence.

    Each silence of at least `SAID_S` is reported once when it is detected and once when it ends. longest_s: the
    longest. A silence that an injected fault causes is reported, but does not count towards `limit_s`.
    """

    def __init__(self, limit_s: float, now_ns: int) -> None:
        self.longest_s = 0.0
        self._limit_ns = round(limit_s * 1e9)
        self._heard_ns = self._counted_from_ns = now_ns
        self._said = False

    @property
    def under_way(self) -> bool:
        """Whether a silence has been reported and has not ended."""
        return self._said

    def heard(self, now_ns: int) -> float | None:
        """Note a motor command. Returns the length in seconds of the reported silence that it ends, otherwise None."""
        silent_ns, self._heard_ns = now_ns - self._heard_ns, now_ns
        if not self._said:
            return None
        self._said = False
        self.longest_s = max(self.longest_s, silent_ns * 1e-9)
        return silent_ns * 1e-9

    def noticed(self, now_ns: int) -> bool:
        """Whether a silence is to be reported now, for the first time."""
        silent_ns = now_ns - self._heard_ns
        if silent_ns < SAID_S * 1e9:
            return False
        self.longest_s = max(self.longest_s, silent_ns * 1e-9)
        new, self._said = not self._said, True
        return new

    def too_long(self, now_ns: int) -> bool:
        """Whether the silence has reached the limit."""
        return now_ns - max(self._heard_ns, self._counted_from_ns) >= self._limit_ns

    def made_by_fault(self, now_ns: int) -> None:
        """Count the silence from now on: until now a fault blocked the link."""
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
_SOME_RUN = 1  # for an agent without a token

_NEVER_IMPAIRED = {dialect.MAVLINK_MSG_ID_XITL_RUN, dialect.MAVLINK_MSG_ID_XITL_FAULTS}


class StoppedWaitingError(Exception):
    """The user ended the run while it waited for an answer."""


@dataclass(frozen=True, slots=True)
class Supervision:
    """Rules for a connection that waits for an agent with an autopilot behind it, which sets the agent's speed."""

    silent_s: Callable[[], float]
    """Longest silence in lockstep."""
    check: Callable[[], None] = lambda: None
    """Raises UserError when the autopilot is known to have ended."""
    why_silent: Callable[[float, float], UserError] | None = None
    """Returns the error for so many seconds of silence until a second of simulation time."""
    traffic_behind: Callable[[AgentTraffic], AgentTraffic] = lambda agent: agent
    """Returns the traffic of the autopilot behind the agent, for the graph of the run."""


class AgentConnection:
    """The agent called `name`; its messages go to `inbox`.

    gone: reason why the agent cannot continue, None while it can.

    terms: by default those of the profile's autopilot. why_silent: see Supervision.
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
        """Send hello until the agent answers. Raises UserError when it does not answer or has another dialect."""
        self._peer = peer
        transport = peer.transport
        if self._profile.faults:
            transport = self._impaired = self._impairable(transport)
        self.link = self.inbox.accounts.link = Link(transport, HOST_SYSTEM_ID, HOST_COMPONENT_ID, signing=self._signing)
        timeout_s = self._terms.connect_timeout_s
        say_hello = partial(self._send_run, dialect.XITL_RUN_COMMAND_HELLO)
        self._say_until(lambda: self.inbox.view.status is not None, say_hello, HELLO_INTERVAL_S, timeout_s, peer.check)
        if self.inbox.view.status is None:
            terms, where = self._terms, transport.peer
            if self.link.refused_signature:
                raise UserError(
                    f"{where}: {terms.who} answers, but not signed with {terms.key}.link_key_file = "
                    f"{terms.link_key_file}; start it with --link-key and the same key, or remove the key from the "
                    "profile"
                )
            if self.link.counters.dropped:  # data without a valid frame
                baud = ", or use the same baud rate" if self.link.transport.name == "serial" else ""
                raise UserError(
                    f"{where}: this host does not understand the answers; install the same release of xitl on both"
                    f"{baud}"
                )
            raise peer.unreachable(timeout_s)
        protocol = self.inbox.view.status.protocol
        if protocol != PROTOCOL:
            raise UserError(
                f"{transport.peer}: the agent speaks version {protocol} of the XITL dialect, "
                f"this host version {PROTOCOL}; install the same release of xitl on both"
            )
        info = self.inbox.view.info
        if info is not None and self._terms.node not in info.nodes.split(","):
            raise UserError(
                f"{transport.peer}: the agent is no {self._terms.key}, it runs {info.nodes}; "
                f"start it with --role {self._terms.role}, or use another {self._terms.key}.link"
            )
        system_id, expected = self.inbox.view.status.get_srcSystem(), self.target[0]
        if system_id != expected:
            raise UserError(
                f"{transport.peer}: {self._who} is MAVLink system {system_id}, but autopilot.system_id is {expected}; "
                f"start it with --system-id {expected}, or use another {self._terms.key}.link"
            )
        self._reached = True

    def begin(
        self,
        context: RunContext,
        parameters: dict[str, float],
        plans: Plans,
    ) -> None:
        """Start the agent, set its parameters and upload its plans.

        Raises UserError when the agent does not accept them.
        """
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
        """Start, and wait for the answer. Both ends count their frames after the start message."""
        view = self.inbox.view
        view.status = None

        def start() -> None:
            self._send_run(dialect.XITL_RUN_COMMAND_START)
            self.link.reset_counters()

        calls = self._say_until(self._has_our_run, start, HELLO_INTERVAL_S, START_WAIT_S, self.peer.check)
        if not self._has_our_run():
            raise self.peer.unreachable(START_WAIT_S)
        if calls > 1:  # a start message that arrives late starts the run a second time
            self._receive_until(lambda: False, HELLO_INTERVAL_S)
        self.inbox.accounts.started()

    def _has_our_run(self) -> bool:
        """Whether the latest status reports this run. An agent of an earlier release reports no token."""
        status = self.inbox.view.status
        return status is not None and status.running in (_SOME_RUN, self._token or _SOME_RUN)

    def _lost_run(self) -> UserError | None:
        """Return the error for a run that is no longer active on the agent; None while it is."""
        if self.inbox.view.status is None or self._has_our_run():
            return None
        peer, at = self.peer.transport.peer, f"at {self._sim_s():.2f} s of simulation time"
        if self.inbox.view.status.running:
            return UserError(
                f"{peer}: {self._who} is in another run, {at}: another host has started it; use one agent for each "
                "host, and a key for the link (--link-key), then run again"
            )
        return UserError(
            f"{peer}: {self._who} answers but is in no run, {at}: it was restarted; find the reason in its log, then "
            "run again"
        )

    # In the run

    @property
    def target(self) -> Target:
        """MAVLink system and component of the agent."""
        return self._terms.target

    @property
    def peer(self) -> Peer:
        """The peer that `reach` got."""
        assert self._peer is not None
        return self._peer

    def send_sensors(self, messages: list[Any]) -> None:
        """Send the samples that are due."""
        self.inbox.timing.sent(messages)
        self.link.send(*messages)

    def send(self, message: Any) -> None:
        """Send a message to the agent."""
        self.link.send(message)

    def send_tick(self, sim_ns: int, tick: int) -> None:
        """Lockstep: send the tick that follows all samples up to now."""
        self._refused_before = self._refused
        self.link.send(dialect.MAVLink_xitl_tick_message(sim_ns // 1000, tick))
        self.peer.hand_over()

    def wait_for_answer(self, sim_ns: int, tick: int, silent_s: float, check: Callable[[], None]) -> None:
        """Lockstep: wait for the answer to a tick, repeat the tick if needed, and handle incoming messages.

        Raises UserError when there is no answer for `silent_s` or when the agent has ended. Passes on what `check`
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
        """Time of one wait for an answer. An agent in this process works only between the waits."""
        return POLL_S if self.link.transport.fileno() is None else TICK_REPEAT_S

    def again_s(self, interval_s: float, patience_s: float) -> float:
        """Return the time after which to repeat an unanswered message: `interval_s` if the message may be lost.

        On a lossless transport an answer is only late, for example on a busy machine, and a repeated message would
        change the run. The message is then repeated after half of `patience_s`, because the connection fails after the
        other half.
        """
        sure = self.link.transport.lossless and self._refused == self._refused_before
        return 0.5 * patience_s if sure else interval_s

    @property
    def _refused(self) -> int:
        """A count that changes when the transport has not accepted a message, or when its connection has ended."""
        return self.link.transport.unsent + self.link.transport.losses

    def _say_until(
        self,
        heard: Callable[[], bool],
        say: Callable[[], object],
        interval_s: float,
        patience_s: float,
        check: Callable[[], object] = lambda: None,
    ) -> int:
        """Call `say` as often as needed, until `heard` is True or the patience is over. Returns the number of calls."""
        began_s = called_s = time.monotonic()
        calls = 0
        while not heard() and (now_s := time.monotonic()) - began_s < patience_s:
            check()
            if not calls or now_s - called_s >= self.again_s(interval_s, patience_s):
                say()
                calls, called_s = calls + 1, now_s
            self._receive_until(heard, interval_s)
        return calls

    def request_time(self) -> None:
        """Request the agent's time stamps."""
        self.link.send(self.inbox.timing.request(self.link.counters.sent))

    def receive(self, timeout_s: float = 0.0) -> list[Any]:
        """Handle the messages that have arrived; wait for them at most `timeout_s`."""
        self.peer.pump()
        messages = self.link.receive(timeout_s)
        if self._reached:  # drop messages of other senders: any node may send on a bus, and a cable may be swapped
            own, arrived = self.target, len(messages)
            passed_on = OWN_IDS if self._terms.role == BRIDGE else 0  # lower ids may come from the autopilot behind it
            messages = [
                message
                for message in messages
                if message.get_msgId() < passed_on or (message.get_srcSystem(), message.get_srcComponent()) == own
            ]
            self._strangers += arrived - len(messages)
        self.inbox.handle(messages)
        return messages

    def _receive_until(self, done: Callable[[], bool], seconds: float) -> bool:
        """Handle incoming messages until `done` returns True or the time is up. Returns the result of `done`."""
        until_s = time.monotonic() + seconds
        while not done() and (left_s := until_s - time.monotonic()) > 0.0:
            self.receive(left_s)
        return done()

    def watch(self) -> None:
        """Real time: detect an agent that has ended, is silent or was restarted. `gone` then has the reason."""
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
        if self.gone is not None:
            return
        if silence.under_way and silence.too_long(now_ns):
            self.gone = self.silent(self._terms.silent_s)
        elif (silence.under_way or inbox.clock_stepped) and now_ns - self._probed_ns > HELLO_INTERVAL_S * 1e9:
            self._probed_ns = now_ns
            inbox.clock_stepped = False  # an agent that was restarted at once is never silent, but has another clock
            self._send_run(dialect.XITL_RUN_COMMAND_HELLO)

    def silent(self, seconds: float) -> UserError:
        """Return the error for a run that cannot continue without the agent."""
        if self._why_silent is not None:
            return self._why_silent(seconds, self._sim_s())
        return UserError(
            f"{self.peer.transport.peer}: {self._who} stopped answering and was silent for {seconds:.3g} s, at "
            f"{self._sim_s():.2f} s of simulation time; check its log, its power and the cable"
        )

    def apply_faults(self, sim_ns: int, faults: FaultsInForce | None) -> None:
        """Activate new faults, and repeat the agent's part once a second. None: no change."""
        if faults is not None:
            self._faults = faults
            if self._impaired is None:  # the first fault that is not in the profile
                self._impaired = self._impairable(self.link.transport)
                self.link.go_through(self._impaired)
            self._impaired.set(faults.to_agent, faults.seed)
        elif not self._faults.on_agent or sim_ns - self._faults_sent_ns < FAULTS_REPEAT_NS:
            return
        self._faults_sent_ns = sim_ns
        self.link.send(self._faults.message(sim_ns))

    def _impairable(self, transport: Transport) -> ImpairedTransport:
        spared = set(_NEVER_IMPAIRED)
        if self._lockstep:
            spared.add(dialect.MAVLINK_MSG_ID_XITL_TICK)
        clock_s = self._sim_s if self._lockstep else time.monotonic
        return ImpairedTransport(transport, lambda message_id: message_id in spared, clock_s)

    # After the run

    def stop(self) -> None:
        """End the run at the other end too. Let both ends agree on their counts if the agent still answers."""
        self.inbox.accounts.over = True
        self.inbox.timing.settle()
        if self._peer is None or self.gone is not None:
            return
        if self._impaired is not None:
            self._impaired.set(NO_FAULTS)
        # Wait until queued and delayed frames have been sent.
        transport, until_s = self.link.transport, time.monotonic() + DRAIN_S
        while (self.link.wake_s() is not None or transport.backlog_s() > 0.0) and time.monotonic() < until_s:
            self.receive(0.01)
        inbox = self.inbox
        inbox.no_run = None
        began_s = time.monotonic()
        sent = 0

        def end() -> None:
            nonlocal sent
            self._send_run(dialect.XITL_RUN_COMMAND_STOP)
            sent = self.link.counters.sent

        calls = self._say_until(lambda: inbox.no_run is not None, end, STOP_INTERVAL_S, STOP_WAIT_S)
        if inbox.no_run is None:
            return
        if not self._lockstep or calls > 1:
            late = self._faults.from_agent
            took_s = time.monotonic() - began_s
            self._receive_until(lambda: False, max(QUIET_S, 1.2 * took_s, late.delay_s + late.jitter_s))
        inbox.view.status = inbox.no_run
        inbox.accounts.stopped(inbox.no_run, sent)

    @property
    def is_open(self) -> bool:
        """Whether an agent is connected, from `reach` to `close`."""
        return self._peer is not None and self.gone is None

    def close(self) -> None:
        """Release process and sockets. Safe to call at any time."""
        if self._peer is not None:
            self._peer.close()
            self._peer = None

    # Reports

    @property
    def impaired(self) -> tuple[int, int, int | None]:
        """Frames that faults dropped for good, in each direction, and the simulation time of the agent's count."""
        status = self.inbox.view.status
        ours = 0 if self._impaired is None else self._impaired.lost
        if status is None:
            return ours, 0, None
        return ours, status.frames_impaired, self.inbox.sim_ns(status.time_usec)

    def links(self) -> tuple[LinkReport, LinkReport]:
        """Return the reports of both directions, towards the agent and from it."""
        inbox = self.inbox
        there, back = inbox.accounts.reports(self._prefix, self.impaired[0], inbox.view.status, inbox.timing)
        return there, replace(
            back, refused=(back.refused or 0) + self._strangers, host_end=self.link.transport.counts()
        )

    def warnings(self) -> list[str]:
        """Return warnings about the link for the user."""
        there, back = self.links()
        counts = {f"{self._who} refused": there.refused, f"the host refused on the link of {self._who}": back.refused}
        return [
            f"{who} {count} frames, datagrams or calls of others; the topic /log names their senders"
            for who, count in counts.items()
            if count
        ]

    def record_links(self, recorder: Recorder, stamp_ns: int) -> None:
        """Record the state of the link so far."""
        for report in self.links():
            recorder.write(stamp_ns, report)

    def node(self) -> NodeReport | None:
        """Return the agent's report of its machine, or None when it never sent one."""
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
    """Return the connections' part of a run's report: links, tasks, clocks and nodes, and the traffic for its graph."""
    links = [report for agent in agents for report in agent.links()]
    nodes = [(agent, report) for agent in agents if (report := agent.node()) is not None]
    return {
        "links": links,
        "tasks": [task for agent in agents for task in agent.inbox.view.tasks.values()],
        "clocks": [agent.inbox.timing.report() for agent in agents],
        "nodes": [report for _, report in nodes],
        "warnings": [text for agent in agents for text in agent.warnings()],
        "agents": [agent_traffic(report, links, agent.inbox.traffic) for agent, report in nodes],
    }


def wait_for_any(links: Sequence[Link], seconds: float) -> None:
    """Return when a link has something to read or needs service, at the latest after `seconds`."""
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
