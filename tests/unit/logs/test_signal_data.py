"""What of a log a report's page holds for its picker: bounded, evenly chosen, and said."""

from __future__ import annotations

import base64
import json

import numpy as np
import pytest
from expression_cases import made_signals, ns
from made_log import MadeLog, MadeTable

from tests.recorded import CALM
from xitl_cli.logs.clocks.time_line import TimeLine
from xitl_cli.logs.formats import open_log
from xitl_cli.logs.report.plots import json_text, signals_payload
from xitl_cli.logs.report.signal_data import MOST_BYTES, held_log


def test_a_small_log_is_held_whole() -> None:
    held = held_log(made_signals(), TimeLine(), "")
    assert held.sentence == "every row of every message"
    by_name = {(table.name, table.instance): table for table in held.tables}
    assert set(by_name) == {("ATT", None), ("GPS", None), ("MODE", None), ("/truth/state", None)} | {
        ("XKF1", 0),
        ("XKF1", 1),
    }
    assert [column.name for column in by_name["/truth/state", None].columns] == ["pose.x", "v_mps[0]", "v_mps[1]"]
    modes = by_name["MODE", None].columns[0]
    assert (modes.held, modes.values.tolist()) == (True, [4.0, 10.0])
    assert not by_name["ATT", None].columns[0].held
    assert by_name["XKF1", 1].at_s[0] == pytest.approx(0.05)


@pytest.mark.parametrize("limit", [20_000, 100_000])
def test_a_large_one_is_thinned_to_the_limit_and_says_so(limit: int) -> None:
    at_s = np.arange(0.0, 200.0, 0.01)
    tables = [MadeTable(name, ns(at_s), {"x": np.sin(at_s), "y": at_s}) for name in ("A", "B")]
    wide = MadeTable("W", ns(at_s[:9]), {"cov": np.ones((9, 36)), "x": at_s[:9]})
    held = held_log(MadeLog(*tables, wide), TimeLine(), "boat", limit)
    assert sum(4 * (2 + len(table.columns)) * len(table.at_s) for table in held.tables) <= limit
    first = held.tables[0]
    assert first.of == 20_000
    assert (first.at_s[0], first.at_s[-1]) == (0.0, pytest.approx(199.99))
    assert np.ptp(np.diff(first.at_s)) <= 0.0101  # evenly
    assert f"at most {held.rows} rows of a message, evenly chosen (A: {held.rows} of 20000)" in held.sentence
    assert "without 1 fields of arrays" in held.sentence


@pytest.mark.medium
def test_a_real_log_fits_and_comes_back_as_it_was() -> None:
    with open_log(CALM) as log:
        held = held_log(log, TimeLine(log.zero_ns), "")
        payload = json_text(signals_payload(held))
        assert len(payload) < 1.6 * MOST_BYTES
        table = next(each for each in json.loads(payload)["tables"] if each["name"] == "GPS")
        packed = table["columns"]["Spd"]["values"]
        speed = np.frombuffer(base64.b64decode(packed["data"]), "<f4")
        assert speed.tolist() == log["GPS"]["Spd"].astype("f4").tolist()
        assert table["columns"]["Status"]["values"]["type"] in ("constant", "f4")
        assert "FMT" not in {each.name for each in held.tables}
