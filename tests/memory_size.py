"""Size of an object with everything that it holds, for tests of bounded memory."""

from __future__ import annotations

import pickle


def size_bytes(kept: object) -> int:
    """Return the serialised size: a few bytes for each number that it holds."""
    return len(pickle.dumps(kept))
