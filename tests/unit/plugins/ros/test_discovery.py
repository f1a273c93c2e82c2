"""How far nodes are discovered, and which of them may command."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from sim_core.keys import SpecificationError
from tests.golden import Golden
from xitl_cli.errors import UserError
from xitl_cli.plugins.ros.discovery import (
    UNKNOWN_S,
    Commanders,
    SenderCheck,
    WriterNames,
    discovery_range,
    stays_on_machine,
)
from xitl_cli.profile.schema.ros import RosSpec

HELM, OTHER = b"\1" * 12, b"\2" * 12
WRITER = b"\0\0\1\3"


@pytest.fixture(autouse=True)
def _no_variables(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY"):
        monkeypatch.delenv(name, raising=False)


@pytest.mark.parametrize(
    ("key", "variables", "reach"),
    [
        (None, {}, "LOCALHOST"),
        (None, {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}, "SUBNET"),
        (None, {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT"}, "SYSTEM_DEFAULT"),
        (None, {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "ROS_LOCALHOST_ONLY": "1"}, "LOCALHOST"),
        ("subnet", {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, "SUBNET"),
        ("localhost", {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}, "LOCALHOST"),
    ],
)
def test_the_profile_is_stronger_than_the_environment(
    monkeypatch: pytest.MonkeyPatch, key: str | None, variables: dict[str, str], reach: str
) -> None:
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    spec = RosSpec(discovery=key)  # type: ignore[arg-type]
    assert discovery_range(spec) == reach
    assert stays_on_machine(spec) == (reach == "LOCALHOST")


def test_an_unknown_range_is_refused(monkeypatch: pytest.MonkeyPatch, golden: Golden) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNETS")
    with pytest.raises(UserError) as refused:
        discovery_range(RosSpec())
    golden("error", refused.value)


def test_a_commander_has_a_full_name() -> None:
    with pytest.raises(SpecificationError, match="is not a full node name"):
        RosSpec(commanders=("/helm", "mate")).check()


def announcement(prefix: bytes, name: str) -> SimpleNamespace:
    """A ParticipantEntitiesInfo of a participant with one node with one writer."""
    writer = SimpleNamespace(data=prefix + WRITER)
    node = SimpleNamespace(node_namespace="/", node_name=name, writer_gid_seq=[writer])
    return SimpleNamespace(gid=SimpleNamespace(data=prefix + b"\0\0\1\xc1"), node_entities_info_seq=[node])


def test_a_participant_names_its_own_writers_alone() -> None:
    names = WriterNames()
    names.update(HELM + WRITER, announcement(HELM, "helm"))
    names.update(OTHER + WRITER, announcement(OTHER, "other"))
    names.update(OTHER + WRITER, announcement(HELM, "other"))  # about another one
    assert names.node_of(HELM + WRITER) == "/helm"
    assert names.node_of(OTHER + WRITER) == "/other"
    assert names.node_of(b"\3" * 12 + WRITER) is None


def test_a_message_waits_for_the_name_of_its_sender() -> None:
    now_s, names, passed = [0.0], WriterNames(), list[str]()
    commanders = Commanders(("/helm",))
    check = SenderCheck(commanders, names.node_of, lambda: now_s[0])
    check.check("/arm", HELM + WRITER, lambda: passed.append("helm"))
    check.check("/arm", OTHER + WRITER, lambda: passed.append("other"))
    check.flush()
    assert (passed, dict(commanders.refused)) == ([], {})
    names.update(HELM + WRITER, announcement(HELM, "helm"))
    check.flush()
    assert (passed, dict(commanders.refused)) == (["helm"], {})
    now_s[0] = UNKNOWN_S
    check.flush()
    assert (passed, dict(commanders.refused)) == (["helm"], {"/arm": 1})
    assert "a node without a name may not command" in commanders.problems()[0]
