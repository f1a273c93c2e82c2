"""Faults on purpose in lockstep, where they repeat, from the profile to the report."""

from __future__ import annotations

from pathlib import Path

import pytest
from conftest import Xitl, payloads, summary

FAULTS = """\
extends: sitl
clock: {duration_s: 9.0}
faults:
  lossy: {from_s: 2.0, until_s: 6.0, link: {loss: 0.2, duplicate: 0.1, reorder: 0.1}}
  cut: {from_s: 7.0, until_s: 8.0, link: {cut: true, direction: sensors}}
  gaps: {from_s: 1.0, imu: {dropout: 0.1}, gnss: {position_bias_ned_m: [2.0, 0.0, 0.0]}}
  never: {from_s: 99.0, barometer: {freeze: true}}
"""


@pytest.mark.slow
def test_faults_repeat_byte_for_byte_and_add_up(xitl: Xitl, tmp_path: Path) -> None:
    (tmp_path / "faulty.yaml").write_text(FAULTS)
    texts = [xitl("sim", "-p", "faulty.yaml", "--out", name, "--verbose").stdout for name in ("one", "other")]
    one, other = payloads(tmp_path / "one/run.mcap"), payloads(tmp_path / "other/run.mcap")
    assert one.keys() == other.keys()
    assert [topic for topic in one if one[topic] != other[topic]] == []
    assert [stamp for stamp, _ in one["/faults"]] == [1_000_000_000 * second for second in (1, 2, 6, 7, 8)]

    document = summary(tmp_path / "one")
    did = {fault["name"]: fault["did"] for fault in document["faults"]}
    sensors, actuators = document["links"]
    for link in (sensors, actuators):
        assert link["sent"] == link["received"] - link["repeated"] + link["lost"]
        assert link["lost"] == link["impaired"]
    # No two faults of the link overlap: each lost frame is one fault's.
    assert did["lossy"]["frames_lost_to_agent"] + did["cut"]["frames_lost_to_agent"] == sensors["lost"]
    assert did["lossy"]["frames_lost_from_agent"] == actuators["lost"]
    # A second of 200 Hz IMU less its dropout, 50 + 50 + 5 Hz of the others, and orders; deviation of the dropout: 4.2.
    assert 260 <= did["cut"]["frames_lost_to_agent"] <= 330
    assert did["gaps"]["gnss_biased"] == 41  # 5 Hz from 1 s on, to 9 s
    assert did["never"] == {}
    assert {"PS1-LS", "PS1-LA", "PS1-M"} <= set(document["graph"]["measured"]["links"])

    text = " ".join(texts[0].split())
    assert "never never – –" in text
    assert "gaps 1 the end" in text
