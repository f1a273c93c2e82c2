"""The page as text: self-contained, hostile text stays text, arrays come back as they went in."""

from __future__ import annotations

import base64
import hashlib
import json
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from report_samples import AT_NS, HOSTILE, sample_report

from tests.golden import Golden
from xitl_cli.logs.clocks.time_line import TimeLine
from xitl_cli.logs.model.errors import LogError
from xitl_cli.logs.model.log import LogHealth
from xitl_cli.logs.model.sections import Plot, Trace
from xitl_cli.logs.report import html
from xitl_cli.logs.report.page import report_page
from xitl_cli.logs.report.plots import json_text, plot_payload


class Read(HTMLParser):
    """Elements with their attributes, and the text of each script."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: list[str] = []
        self.text: list[str] = []
        self.within = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        self.within = tag
        if tag == "script":
            self.scripts.append("")

    def handle_endtag(self, tag: str) -> None:
        self.within = ""

    def handle_data(self, data: str) -> None:
        if self.within == "script":
            self.scripts[-1] += data
        elif self.within != "style":
            self.text.append(data)


@pytest.fixture(scope="module")
def text() -> str:
    return html.html(report_page(sample_report()))


@pytest.fixture(scope="module")
def read(text: str) -> Read:
    return Read(text)


def decoded(array: dict[str, Any]) -> np.ndarray:
    values = np.frombuffer(base64.b64decode(array["data"]), dtype="<" + array["type"])
    return array["first"] + values.astype(np.float64) * array["step"] if array["type"] == "u4" else values


def test_nothing_comes_from_elsewhere(read: Read) -> None:
    assert not [tag for tag, attributes in read.elements if {"src", "srcset", "action", "formaction"} & set(attributes)]
    links = [attributes.get("href") or "" for _, attributes in read.elements if "href" in attributes]
    assert links
    assert all(link.startswith("#") for link in links)
    assert "link" not in {tag for tag, _ in read.elements}


def test_hostile_text_is_shown_and_not_obeyed(read: Read) -> None:
    assert "img" not in {tag for tag, _ in read.elements}
    assert not [name for _, attributes in read.elements for name in attributes if name.startswith("on")]
    assert "".join(read.text).count(HOSTILE.split("\x1b")[0]) >= 4  # finding, fact, grid and lack


def test_only_the_two_scripts_of_the_page_may_run(read: Read) -> None:
    policy = next(a["content"] for tag, a in read.elements if tag == "meta" and a.get("http-equiv"))
    assert policy is not None
    allowed = re.findall(r"'sha256-([^']+)'", policy)
    codes = [script for script in read.scripts if not script.startswith("{")]
    hashes = [base64.b64encode(hashlib.sha256(code.encode()).digest()).decode() for code in codes]
    assert hashes == allowed
    assert len(hashes) == 2
    assert policy.startswith("default-src 'none'; ")


def test_the_data_of_every_plot_is_json(read: Read) -> None:
    data = [json.loads(script) for script in read.scripts if script.startswith("{")]
    assert [each.get("kind") for each in data] == ["track", "bands", "time", "time", "time", "loglog", None]
    assert data[-1]["range"] == pytest.approx([0.0, 60.0])


def test_json_in_a_script_cannot_end_it() -> None:
    assert "<" not in json_text({"text": HOSTILE})
    assert json.loads(json_text({"text": HOSTILE})) == {"text": HOSTILE}


def test_arrays_come_back_within_what_an_eye_can_see() -> None:
    values = np.sin(AT_NS * 1e-9)
    values[5] = np.inf
    payload = plot_payload(Plot("p", "P", "m", (Trace("y", AT_NS[:4000], values[:4000]),)), TimeLine())
    x, y = decoded(payload["traces"][0]["x"]), decoded(payload["traces"][0]["y"])
    # 20 s in 2**32 steps is 5 ns a step; float32 has 24 bits.
    np.testing.assert_allclose(x, AT_NS[:4000] * 1e-9, atol=5e-9)
    assert np.isnan(y[5])
    np.testing.assert_allclose(np.delete(y, 5), np.delete(values[:4000], 5), rtol=6e-8)


def test_small_changes_of_a_large_number_are_kept() -> None:
    values = 1.7e9 + np.arange(100) * 0.01
    payload = plot_payload(Plot("p", "P", "s", (Trace("t", AT_NS[:100], values),)), TimeLine())
    np.testing.assert_array_equal(decoded(payload["traces"][0]["y"]), values)


def test_damage_and_refused_files_are_told(text: str) -> None:
    assert "<strong>Degraded</strong>: damaged in 2 places" in text
    assert "damaged in 2 places, the first at byte 417 (no record begins here)" in text
    assert "34 bytes could not be read" in text
    assert "looks like a PX4 log" in text


def test_a_whole_log_says_so() -> None:
    assert "<strong>Whole</strong>: every record was read." in html.html(
        report_page(sample_report(LogHealth(1000, 90)))
    )


def test_an_earlier_page_is_replaced_and_no_scrap_is_left(tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    page.write_text("<!doctype html>old")
    html.write(sample_report(), page)
    assert "old" not in page.read_text(encoding="utf-8")[:100]
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]


@pytest.mark.parametrize("place", [".", "missing/report.html", "file/report.html"])
def test_a_place_that_cannot_be_written_gets_a_sentence(tmp_path: Path, place: str, golden: Golden) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(LogError) as refused:
        html.write_text(tmp_path / place, "x")
    golden("error", refused.value)
