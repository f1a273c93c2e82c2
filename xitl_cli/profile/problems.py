"""The problems of a profile: each one sentence with file, line, key, value and the fix."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from xitl_cli.errors import UserError
from xitl_cli.profile.entry import Origin


@dataclass(frozen=True, slots=True)
class Problem:
    """One thing wrong in a profile."""

    origin: Origin
    sentence: str

    def __str__(self) -> str:
        return f"{self.origin}: {self.sentence}"


class ProfileError(UserError):
    """A profile that cannot be used. `str()` is the first problem and a count; `problems` holds all of them.

    `profile` is what the user called it, so that the line can say how to see the rest.
    """

    def __init__(self, problems: Sequence[Problem], profile: str) -> None:
        if not problems:
            raise ValueError("a ProfileError needs at least one problem")
        self.problems = tuple(problems)
        self.profile = profile
        more = len(self.problems) - 1
        rest = f" (and {more} more: run `xitl profiles check {profile}`)" if more else ""
        super().__init__(f"{self.problems[0]}{rest}")


def shown(value: object) -> str:
    """A value as an error quotes it: short, on one line."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, dict):
        return "a group of keys" if value else "an empty group"
    if isinstance(value, (list, tuple)):
        return f"a list of {len(value)}" if value else "an empty list"
    if isinstance(value, int) and value.bit_length() > 64:
        return "an integer of more than 64 bits"
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
