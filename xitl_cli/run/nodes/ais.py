"""AIS between the vessels of a fleet: sends each transponder's reports to all receivers in range."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from numpy.random import default_rng

from agent.wire.transport import Transport, TransportError, open_transport
from sim_core.world.spec import AisSpec
from xitl_cli.errors import UserError
from xitl_cli.profile.schema import RunProfile
from xitl_cli.profile.schema.world import AisRadioSpec
from xitl_cli.record.topics import AisReport
from xitl_cli.run.core.node import RunContext, RunNode, RunStep
from xitl_cli.run.links.autopilot_commands import Send
from xitl_cli.run.traffic.ais import (
    AisClass,
    AisDimensions,
    AisReceiver,
    AisStatic,
    AisTransmission,
    SentenceReceiver,
    Transponder,
    mavlink_receiver,
    px4_receiver,
    sentences,
)
from xitl_cli.run.traffic.self_report import VesselVoices
from xitl_cli.run.world.world import local_frame
from xitl_cli.seeds import Seeds

LOOKS_HZ = 10.0
FIRST_S: Mapping[AisClass, float] = {"class-a": 10.0, "class-b": 30.0}
"""The first report is sent at a random instant within this time, which is the report interval of a vessel under way."""
LOCAL_LINE = "tcp://127.0.0.1:0"


class AisLine:
    """The line on which an ArduPilot reads the sentences of its AIS receiver.

    An ArduPilot of this run connects to `url`.

    Raises UserError when the line that the profile names cannot be opened.
    """

    def __init__(self, profile: RunProfile) -> None:
        autopilot = profile.autopilot
        url = autopilot.ais_link
        try:
            self.transport: Transport = open_transport(url or LOCAL_LINE, listen=url is None)
        except TransportError as error:
            raise UserError(f"autopilot.ais_link: {error}") from None

    @property
    def url(self) -> str:
        """Address of the line."""
        return self.transport.address

    def close(self) -> None:
        """Close the line."""
        self.transport.close()


def receiver_of(profile: RunProfile, send: Send, line: AisLine | None) -> AisReceiver | None:
    """Return the AIS receiver of a vessel's autopilot, or None without one."""
    if profile.autopilot.kind == "embedded":
        return mavlink_receiver(send)
    if profile.autopilot.kind == "px4":
        return px4_receiver(send)
    return None if line is None else SentenceReceiver(line.transport)


def ais_static(spec: AisSpec, length_m: float, beam_m: float, ahead_m: float = 0.0, draft_m: float = 0.0) -> AisStatic:
    """Return the static data of a vessel. Its middle lies `ahead_m` ahead of the position that it reports."""
    dimensions = AisDimensions.around(length_m, beam_m, ahead_m)
    assert spec.mmsi is not None
    return AisStatic(spec.mmsi, spec.name, spec.callsign, spec.ship_type, dimensions, draft_m)


class AisRecorder(RunNode):
    """A vessel's receiver that also records the transmissions."""

    def __init__(self, receive: AisReceiver) -> None:
        self._receive = receive
        self._now_ns = 0

    @property
    def unsent_bytes(self) -> int:
        """Bytes of sentences that the receiver's line did not take."""
        return self._receive.unsent if isinstance(self._receive, SentenceReceiver) else 0

    def begin(self, context: RunContext) -> None:
        self._recorder = context.recorder

    def exchange(self, step: RunStep) -> None:
        self._now_ns = step.now_ns

    def __call__(self, heard: AisTransmission) -> None:
        """Receive one transmission."""
        self._recorder.write(self._now_ns, ais_report(heard))
        self._receive(heard)


def ais_report(heard: AisTransmission) -> AisReport:
    """Return a transmission as a record."""
    nmea = b"".join(sentence for payload in heard.payloads() for sentence in sentences(payload))
    text, report = nmea.decode("ascii").replace("\r\n", "\n").strip(), heard.report
    if isinstance(report, AisStatic):
        return AisReport(report.mmsi, heard.ais_class, "static", text, name=report.name, callsign=report.callsign)
    return AisReport(
        report.mmsi,
        heard.ais_class,
        "position",
        text,
        report.lat_deg,
        report.lon_deg,
        report.speed_mps,
        None if report.course_deg is None else math.radians(report.course_deg),
        None if report.heading_deg is None else math.radians(report.heading_deg),
        report.status,
    )


class AisNode(RunNode):
    """Sends the reports of vessels that have a voice and a transponder to the receivers in radio range.

    profiles: of the simulated vessels. The scripted vessels have voices too.
    """

    def __init__(self, profiles: list[RunProfile], voices: VesselVoices, receivers: Mapping[str, AisReceiver]) -> None:
        lead = profiles[0]
        frame, seed = local_frame(lead.site), lead.clock.seed
        self._voices = voices
        self._receivers = dict(receivers)
        self._radio: AisRadioSpec = lead.world.ais
        self._every = max(round(lead.clock.physics_rate_hz / LOOKS_HZ), 1)
        self._rng = default_rng(Seeds(seed).sequence("ais radio"))
        self._heard = self._lost = self._out_of_range = 0
        self._transponders: dict[str, Transponder] = {}
        vessels = {}
        for profile in profiles:
            model = profile.vehicle
            static = ais_static(profile.ais, model.length_m, model.width_m, model.midship_frd_x_m)
            vessels[profile.vessel] = (profile.ais, static)
        for name, script in lead.traffic.items():
            static = ais_static(script.ais, script.length_m, script.beam_m, draft_m=script.draft_m)
            vessels[name] = (script.ais, static)
        for name, (spec, static) in vessels.items():
            if spec.transponder != "none":
                first_s = float(default_rng(Seeds(seed, name).sequence("ais")).uniform(0.0, FIRST_S[spec.transponder]))
                self._transponders[name] = Transponder(spec.transponder, static, frame, first_s)

    def exchange(self, step: RunStep) -> None:
        if step.number % self._every:
            return
        for name, transponder in self._transponders.items():
            for sent in transponder.due(step.now_ns, self._voices.said(name)):
                for receiver, receive in self._receivers.items():
                    if receiver == name:
                        continue
                    there = self._voices.said(receiver)
                    if there is not None and math.dist(there.pos_ne_m, sent.place_ne_m) > self._radio.range_m:
                        self._out_of_range += 1
                    elif self._radio.loss > 0.0 and self._rng.random() < self._radio.loss:
                        self._lost += 1
                    else:
                        self._heard += 1
                        receive(sent)

    def report(self) -> dict[str, Any]:
        """Return `ais`: the transmissions, and their outcome at each receiver."""
        recorders = [receiver for receiver in self._receivers.values() if isinstance(receiver, AisRecorder)]
        return {
            "ais": {
                "sent": {name: transponder.sent for name, transponder in self._transponders.items()},
                "heard": self._heard,
                "lost": self._lost,
                "out_of_range": self._out_of_range,
                "unsent_bytes": sum(recorder.unsent_bytes for recorder in recorders),
            }
        }
