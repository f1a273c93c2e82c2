"""The reader of expressions in the report's page against the one here, over one table of cases."""

from __future__ import annotations

import json
import shutil
import subprocess
from functools import cache
from importlib import resources
from typing import Any

import numpy as np
import pytest
from expression_cases import CASES, REFUSED, UNITS, made_signals
from numpy.testing import assert_allclose

from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.table import by_instance

NODE = shutil.which("node")
pytestmark = pytest.mark.skipif(NODE is None, reason="node runs the page's script; apt install nodejs")
LOG = made_signals()
TEXTS = tuple(dict.fromkeys((*CASES, *UNITS)))
NEAR = ("ATT.Yew - 1", "ATX.Yaw - 1", "XKF1[7].VN - 1")
PROGRAM = """
const { source, texts } = JSON.parse(require("fs").readFileSync(0, "utf8"));
for (const table of source.tables) for (const column of Object.values(table.columns))
  column.values = Float64Array.from(column.values, (value) => value ?? NaN);
const told = texts.map((text) => {
  try {
    const found = expressions.signalOf(source, text);
    const values = [...found.values].map((value) => Number.isFinite(value) ? value : String(value));
    return { ...found, t: [...found.t], values };
  } catch (error) { return { error: error.message, kind: error.constructor.name }; }
});
console.log(JSON.stringify(told));
"""


def source() -> dict[str, Any]:
    """The made log as the page has one: arrays are columns of their own."""
    tables = []
    for table in LOG.tables.values():
        for number, part in by_instance(table).items():
            columns: dict[str, Any] = {}
            for name, column in part.columns.items():
                stored = np.asarray(part.values(name))
                held = stored.dtype.kind in "iub" and not column.unit
                for label, values in (
                    [(name, stored)] if stored.ndim == 1 else [(f"{name}[{k}]", stored[:, k]) for k in (0, 1)]
                ):
                    known = [float(value) if np.isfinite(value) else None for value in values]
                    columns[label] = {"values": known, "unit": column.unit, "held": held}
            instance = None if table.instance is None else number
            tables.append(
                {"name": table.name, "instance": instance, "t": (part.stamp_ns * 1e-9).tolist(), "columns": columns}
            )
    return {"label": "", "tables": tables}


@cache
def in_the_page() -> dict[str, dict[str, Any]]:
    assert NODE is not None
    script = (resources.files("xitl_cli.logs.report") / "assets" / "expressions.js").read_text(encoding="utf-8")
    texts = [*TEXTS, *REFUSED, *NEAR]
    told = subprocess.run(
        [NODE, "-e", script + PROGRAM],
        input=json.dumps({"source": source(), "texts": texts}),
        capture_output=True,
        text=True,
        check=False,
    )
    assert told.returncode == 0, told.stderr
    return dict(zip(texts, json.loads(told.stdout), strict=True))


@pytest.mark.parametrize("text", TEXTS)
def test_the_page_says_what_is_said_here(text: str) -> None:
    """To the last digits of a float: both add in the same order, and only functions such as sin may differ by one."""
    here, there = LOG.signal(text), in_the_page()[text]
    assert "error" not in there, there
    assert there["unit"] == here.unit
    assert there["base"] == here.base
    assert there["others"] == list(here.interpolated)
    assert there["notes"] == list(here.notes)
    assert_allclose(there["t"], here.time_s, rtol=0, atol=1e-9)
    values = [float(value.replace("Infinity", "inf")) if isinstance(value, str) else value for value in there["values"]]
    assert_allclose(values, here.values, rtol=1e-9, atol=1e-7)


@pytest.mark.parametrize("text", REFUSED)
def test_the_page_refuses_what_is_refused_here(text: str) -> None:
    with pytest.raises(LogError):
        LOG.signal(text) if text != "ATT" else LOG.signal("ATT - 1")
    told = in_the_page()[text]
    assert told["kind"] == "Error"  # of the reader, and not of JavaScript


def test_the_page_names_what_is_near() -> None:
    told = [in_the_page()[text]["error"] for text in NEAR]
    assert "did you mean Yaw?" in told[0]
    assert "did you mean ATT?" in told[1]
    assert "XKF1[7], and there is XKF1[0], XKF1[1]" in told[2]
