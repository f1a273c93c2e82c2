"""Texts for people are limited in number, whatever they say: a station's garbage does not fill the links."""

from __future__ import annotations

from agent.fcu.mavlink.hub import TEXTS_AT_ONCE, TEXTS_HZ, MavlinkHub, TextLimit
from agent.fcu.vehicle.autopilot import Autopilot
from agent.fcu.vehicle_state import CRITICAL, INFO, WARNING

CYCLE_NS = 20_000_000
SECOND_NS = 1_000_000_000


def flooded(seconds: int, severity: int) -> tuple[MavlinkHub, list[str]]:
    """Fifty different texts a cycle, and what reaches a station of them."""
    hub = MavlinkHub(Autopilot())
    outbox, heard = hub.open_outbox(), []
    for cycle in range(50 * seconds):
        for number in range(50):
            hub.autopilot.events.add(severity, f"nonsense {cycle} {number}")
        hub.distribute(cycle * CYCLE_NS)
        heard += [event.text for event in outbox.events]
        outbox.events.clear()
    return hub, heard


def test_different_texts_are_limited_by_rate_counted_and_said() -> None:
    for severity in (WARNING, INFO):
        hub, heard = flooded(10, severity)
        said = [text for text in heard if text.endswith("texts dropped, too many at once")]
        assert len(heard) - len(said) <= TEXTS_AT_ONCE + 10 * TEXTS_HZ
        assert 8 <= len(said) <= 10
        left_out = 10 * 50 * 50 - (len(heard) - len(said))
        assert hub.autopilot.events.lost == left_out
        outbox = hub.open_outbox()
        hub.distribute(20 * SECOND_NS)  # the rest
        said += [event.text for event in outbox.events]
        assert sum(int(text.split()[0]) for text in said) == left_out


def test_what_is_urgent_gets_through_a_flood() -> None:
    hub, _ = flooded(2, WARNING)
    outbox = hub.open_outbox()
    hub.autopilot.events.add(CRITICAL, "we sink")
    hub.distribute(2 * SECOND_NS)
    assert "we sink" in [event.text for event in outbox.events]


def test_the_last_are_said_when_the_flood_is_over() -> None:
    hub, _ = flooded(1, WARNING)
    outbox = hub.open_outbox()
    hub.distribute(5 * SECOND_NS)
    assert [event.text.split(" ", 1)[1] for event in outbox.events] == ["texts dropped, too many at once"]


def test_a_bucket_fills_again_and_never_over() -> None:
    limit = TextLimit()
    assert sum(limit.allows(0) for _ in range(100)) == TEXTS_AT_ONCE
    assert sum(limit.allows(SECOND_NS) for _ in range(100)) == TEXTS_HZ
    assert sum(limit.allows(1000 * SECOND_NS) for _ in range(100)) == TEXTS_AT_ONCE
    assert not limit.allows(0)  # a clock that is set back gives nothing
