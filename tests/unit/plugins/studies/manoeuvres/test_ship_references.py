"""References of the manoeuvres of published ships: the overshoots of a free run next to those of the table."""

from __future__ import annotations

import pytest

from xitl_cli.plugins.studies.manoeuvres.references import ReferenceKind
from xitl_cli.plugins.studies.manoeuvres.ship_trials import ship_references


@pytest.mark.parametrize(
    ("figure", "free_run_deg"),
    [("10_first", 8.2), ("10_second", 21.9), ("20_first", 13.7), ("20_second", 14.9)],
)
def test_overshoots_of_kvlcc2_in_the_free_run_are_shown_and_disputed(figure: str, free_run_deg: float) -> None:
    table, measured = ship_references("kvlcc2-l7", f"ship_zig_zag_{figure}_deg")
    assert (table.source.kind, table.disputed) == (ReferenceKind.PUBLISHED, "")
    assert (measured.source.kind, measured.value) == (ReferenceKind.MEASURED, free_run_deg)
    assert f"give {table.value:g}°" in measured.disputed
