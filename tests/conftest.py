"""What holds for all tests: they may not depend on how fast the machine is, and what else it does."""

from __future__ import annotations

from hypothesis import settings

settings.register_profile("any machine", deadline=None)
settings.load_profile("any machine")
