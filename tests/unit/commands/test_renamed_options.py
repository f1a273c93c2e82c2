"""An option's old name still works, and a notice gives the new one."""

from __future__ import annotations

import pytest

from xitl_cli.commands.options import renamed


@pytest.mark.parametrize(
    ("old", "new", "expected"), [(None, "5", "5"), ("3", None, "3"), ("3", "5", "5"), (None, None, None)]
)
def test_the_new_name_counts_and_the_old_one_is_accepted(
    old: str | None, new: str | None, expected: str | None, capsys: pytest.CaptureFixture[str]
) -> None:
    assert renamed(old, new, "--to", "--until") == expected
    assert ("--to is now --until" in capsys.readouterr().err) == (old is not None)
