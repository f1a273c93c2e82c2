"""Tables of which the columns are described, and one with every kind of column."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from made_log import MadeTable

from xitl_cli.logs.model.table import Column


def made_table(name: str, columns: Mapping[str, tuple[Column, Any]], stamp_ns: Any, place: Any) -> MadeTable:
    described = {key: column for key, (column, _) in columns.items()}
    return MadeTable(name, stamp_ns, {key: held for key, (_, held) in columns.items()}, place=place, columns=described)


def every_kind(rows: int = 5, first_ns: int = 1_000_000_123) -> MadeTable:
    """Numbers of all sizes, a text, bytes, a fixed and a varying array."""
    steps = np.arange(rows)
    numbers = {
        f"N{np.dtype(code).str[1:]}": (Column(f"N{np.dtype(code).str[1:]}", "m", "m"), steps.astype(code) + 1)
        for code in ("i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f2", "f4", "f8")
    }
    texts = np.array([f'text, "{n}"\nend' if n % 2 else "" for n in range(rows)])
    data = np.array([bytes(range(n)) for n in range(rows)] + [None], dtype=object)[:rows]
    varying = np.array([[float(k) if k <= n % 3 else np.nan for k in range(3)] for n in range(rows)])
    further = {
        "Angle": (Column("Angle", "deg", "cdeg"), steps / 100),
        "Odd": (Column("Odd", "deg"), np.where(steps % 2, np.nan, steps * np.float32(0.1)).astype(np.float32)),
        "Text": (Column("Text", kind="text"), texts),
        "Data": (Column("Data", kind="bytes"), data),
        "Fixed": (Column("Fixed", "V", shape=(2,)), np.stack([steps, steps * 2], axis=1).astype(np.int16)),
        "pose.x": (Column("pose.x", "m", shape=(-1,)), varying),
        "_sysid": (Column("_sysid"), steps.astype(np.uint8)),
    }
    return made_table("KIND", numbers | further, first_ns + steps * 1_000_001, steps * 10)
