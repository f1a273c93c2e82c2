"""Who of a fleet waits for whom before it sets out."""

from __future__ import annotations

from pathlib import Path

import pytest

from xitl_cli.profile import load_profile
from xitl_cli.run.session import departs_after
from xitl_cli.run.traffic.self_report import VesselVoices

FLEET = """
extends: [bases/base-sitl, sites/santo-antonio, vehicles/asv-full]
vessels:
  lead: {{mission: {{start: {{north_m: 60, east_m: -60}}}}, driver: {{departs_with: {0}}}}}
  second: {{driver: {{kind: follow, follow: {{vessel: lead, offset_frd_m: [-10, 0]}}}}}}
  third: {{driver: {{kind: follow, follow: {{vessel: second, offset_frd_m: [-10, 0]}}}}}}
  other: {{mission: {{start: {{north_m: 60, east_m: -120}}}}}}
"""


@pytest.mark.parametrize(
    ("departs_with", "awaited"),
    [("followers", ("second", "third")), ("fleet", ("second", "third", "other")), ("nobody", ())],
)
def test_a_leader_waits_for_its_followers_and_theirs(
    departs_with: str, awaited: tuple[str, ...], tmp_path: Path
) -> None:
    path = tmp_path / "fleet.yaml"
    path.write_text(FLEET.format(departs_with))
    after = departs_after(load_profile(str(path)).run_profiles())
    assert after["lead"] == awaited
    assert after["other"] == ()


def test_who_is_not_ready_is_told_by_name() -> None:
    voices, ready = VesselVoices(), set()
    names = ("a", "b", "c", "d", "e")
    assert voices.waited_for(names[:2]) == "a, b to be ready"  # not made yet
    for name in names:
        voices.add(name, lambda: None, lambda: False, lambda name=name: name in ready)  # type: ignore[misc]
    assert voices.waited_for(names) == "a, b, c and 2 more to be ready"
    ready |= {"a", "b", "c", "d"}
    assert voices.waited_for(names) == "e to be ready"
    ready.add("e")
    assert voices.waited_for(names) == voices.waited_for(()) == ""
