"""The radio of `world.ais`: who is too far off, and what is lost on the way, by the counts of the summary."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from xitl_cli.profile import load_profile
from xitl_cli.record.recorder import Recorder
from xitl_cli.run.nodes.ais import AisNode, AisRecorder
from xitl_cli.run.traffic.self_report import SelfReport

PLACES_NE_M = {
    "leader": (0.0, 0.0),
    "follower_1": (30.0, 0.0),
    "follower_2": (1000.0, 0.0),
    "follower_3": (1030.0, 0.0),
}


class Voices:
    """They go north at 2 m/s."""

    now_ns = 0

    def said(self, name: str) -> SelfReport:
        north_m, east_m = PLACES_NE_M[name]
        return SelfReport(self.now_ns, (north_m + 2e-9 * self.now_ns, east_m), (2.0, 0.0), 0.0)


def radio_for(seconds: float, *overrides: str) -> tuple[dict[str, Any], dict[str, list[Any]]]:
    """What is counted, and what each heard."""
    runnable = list(load_profile("fleet-convoy", list(overrides)).run_profiles())
    heard: dict[str, list[Any]] = {one.vessel: [] for one in runnable}
    voices: Any = Voices()
    node = AisNode(runnable, voices, {name: told.append for name, told in heard.items()})
    every = round(runnable[0].clock.physics_rate_hz / 10.0)
    for tick in range(round(seconds * 10)):
        voices.now_ns = tick * 100_000_000
        step: Any = SimpleNamespace(number=tick * every, now_ns=voices.now_ns)
        node.exchange(step)
    return node.report()["ais"], heard


def test_what_a_receiver_hears_is_recorded_and_goes_on_to_it(tmp_path: Path) -> None:
    runnable = list(load_profile("fleet-convoy").run_profiles())
    heard: list[Any] = []
    voices: Any = Voices()
    recorder = Recorder(tmp_path / "run.mcap", "lz4", vessel="follower_1")
    receiver = AisRecorder(heard.append)
    context: Any = SimpleNamespace(recorder=recorder)
    receiver.begin(context)
    node = AisNode(runnable, voices, {"follower_1": receiver})
    every = round(runnable[0].clock.physics_rate_hz / 10.0)
    for tick in range(200):
        voices.now_ns = tick * 100_000_000
        step: Any = SimpleNamespace(number=tick * every, now_ns=voices.now_ns)
        receiver.exchange(step)
        node.exchange(step)
    recorder.close()
    with (tmp_path / "run.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        found = [one for *_, one in reader.iter_decoded_messages(topics=["/follower_1/ais"])]
    assert len(found) == len(heard) > 0
    assert {one.report for one in found} == {"position", "static"}
    for one, sent in zip(found, heard, strict=True):
        assert one.mmsi == sent.report.mmsi
        first = one.sentences.splitlines()[0]
        assert mmsi_of(first.split(",")[5]) == one.mmsi
    position = next(one for one in found if one.report == "position")
    assert (position.ais_class, position.speed_mps, position.heading_rad) == ("class-a", 2.0, 0.0)
    assert math.isnan(next(one for one in found if one.report == "static").latitude_deg)


def mmsi_of(armoured: str) -> int:
    """Bits 8 to 37 of any AIS message (ITU-R M.1371-5, annex 8), from its six-bit characters."""
    codes = [ord(each) - 48 for each in armoured]
    bits = "".join(f"{code - 8 if code > 40 else code:06b}" for code in codes)
    return int(bits[8:38], 2)


def test_out_of_range_is_what_is_sent_farther_away() -> None:
    """Two and two, a kilometre apart, with a range of 100 m: of its three receivers each reaches one."""
    counts, heard = radio_for(120.0, "world.ais.range_m=100")
    sent = sum(counts["sent"].values())
    assert min(counts["sent"].values()) >= 11
    assert (counts["heard"], counts["out_of_range"], counts["lost"]) == (sent, 2 * sent, 0)
    mmsi = {name: {one.report.mmsi for one in told} for name, told in heard.items()}
    assert all(len(found) == 1 for found in mmsi.values())
    assert len(set.union(*mmsi.values())) == 4


@pytest.mark.medium
def test_loss_is_a_share_of_what_arrives_and_a_seed_repeats_it() -> None:
    counts, heard = radio_for(240.0, "world.ais.loss=0.3")
    arrived = counts["heard"] + counts["lost"]
    assert (arrived, counts["out_of_range"]) == (3 * sum(counts["sent"].values()), 0)
    # Three standard deviations of a binomial.
    assert counts["lost"] / arrived == pytest.approx(0.3, abs=3.0 * math.sqrt(0.21 / arrived))
    assert sum(map(len, heard.values())) == counts["heard"]
    again, same = radio_for(240.0, "world.ais.loss=0.3")
    assert (again, same) == (counts, heard)
    assert radio_for(240.0, "world.ais.loss=0.3", "clock.seed=2")[0] != counts
