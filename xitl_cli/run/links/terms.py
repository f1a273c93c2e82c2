"""What a connection to an agent goes by, for an autopilot and for a companion."""

from __future__ import annotations

from dataclasses import dataclass

from agent.assembly import AUTOPILOT_COMPONENT_ID, COMPANION_COMPONENT_ID
from agent.options import BRIDGE, COMPANION, FCU
from xitl_cli.profile.schema import RunProfile


@dataclass(frozen=True, slots=True)
class Terms:
    """key: the profile's group. who: in sentences. node: what it has to announce, with --role `role`.

    says: what is missed when it is silent, and what it does (`speaks`) when it is back. silent_s: what is too long.
    """

    key: str
    who: str
    node: str
    role: str
    component_id: int
    connect_timeout_s: float
    silent_s: float
    link_key_file: str | None = None
    says: str = "motor commands"
    speaks: str = "commands"


def terms_of_autopilot(profile: RunProfile, name: str) -> Terms:
    """Of the agent called `name`: `agent`, or one in standby."""
    autopilot = profile.autopilot
    return Terms(
        key="autopilot",
        who="the agent" if name == "agent" else f"the {name} agent",
        node="LC",
        role=FCU if autopilot.kind == "embedded" else BRIDGE,
        component_id=AUTOPILOT_COMPONENT_ID,
        connect_timeout_s=autopilot.connect_timeout_s,
        silent_s=autopilot.silent_s,
        link_key_file=autopilot.link_key_file,
    )


def terms_of_companion(profile: RunProfile) -> Terms:
    """Of a profile that has one."""
    companion = profile.companion
    assert companion is not None
    return Terms(
        key="companion",
        who="the companion",
        node="HC",
        role=COMPANION,
        component_id=COMPANION_COMPONENT_ID,
        connect_timeout_s=companion.connect_timeout_s,
        silent_s=companion.silent_s,
        link_key_file=companion.link_key_file,
        says="word",
        speaks="is heard",
    )
