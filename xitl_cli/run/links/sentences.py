"""What to say when a run cannot go on with an agent: one sentence each."""

from __future__ import annotations

from agent.wire.link import Link
from xitl_cli.errors import UserError
from xitl_cli.run.links.terms import Terms


def silent(peer: str, who: str, seconds: float, sim_s: float) -> UserError:
    """Nothing came for so long."""
    return UserError(
        f"{peer}: {who} stopped answering and was silent for {seconds:.3g} s, at {sim_s:.2f} s of simulation time; "
        "look at its log, its power and the cable"
    )


def restarted(peer: str, who: str, sim_s: float) -> UserError:
    """It is there, but knows of no run."""
    return UserError(
        f"{peer}: {who} answers but has no run on, at {sim_s:.2f} s of simulation time: it was started anew; look at "
        "its log for why it ended, then run again"
    )


def not_understood(terms: Terms, link: Link) -> UserError | None:
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
