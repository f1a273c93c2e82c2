"""The site of docs/: every page is in its navigation, has a picture, and names what is there."""

from __future__ import annotations

import re
import sys
import tomllib
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT))  # tools/ is no part of the package

from tools.check_site import faults  # noqa: E402
from tools.pictures.table import IMAGES, PICTURES  # noqa: E402

PAGES = sorted((ROOT / "docs").rglob("*.md"))
CONFIGURATION = tomllib.loads((ROOT / "zensical.toml").read_text(encoding="utf-8"))["project"]
_PICTURE = re.compile(r"!\[([^\]]*)\]\(([^)\s]+)\)")
MOST_BYTES, MOST_OF_A_PICTURE = 10_000_000, 3_000_000


def in_navigation(entries: list[Any]) -> Iterator[str]:
    for entry in entries:
        for target in entry.values() if isinstance(entry, dict) else [entry]:
            if isinstance(target, str):
                yield target
            else:
                yield from in_navigation(target)


def pictures(page: Path) -> list[tuple[str, str]]:
    """Words for those who do not see it, and address, of each."""
    prose = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    return _PICTURE.findall(prose)


def test_every_page_is_in_the_navigation_once() -> None:
    named = list(in_navigation(CONFIGURATION["nav"]))
    assert sorted(named) == sorted(page.relative_to(ROOT / "docs").as_posix() for page in PAGES)
    assert named[0] == "index.md"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_page_has_a_picture_that_is_there(page: Path) -> None:
    found = pictures(page)
    assert found, f"{page}: no picture; draw one in tools/pictures and add it to its table"
    for words, address in found:
        assert len(words) > 12, f"{page}: {address}: say what it shows"
        assert (page.parent / address).is_file(), f"{page}: {address} is missing; run `make pictures`"


def test_the_readme_begins_with_a_moving_picture() -> None:
    beginning = (ROOT / "README.md").read_text(encoding="utf-8").split("\n\n")[1]
    assert re.search(r"^!\[[^\]]{20,}\]\((docs/img/[\w-]+\.webp)\)$", beginning)
    with Image.open(IMAGES / "make-run.webp") as picture:
        assert picture.n_frames > 30


def test_every_picture_is_made_and_shown() -> None:
    shown = {Path(address).name for page in [*PAGES, ROOT / "README.md"] for _, address in pictures(page)}
    kept = {file.name for file in IMAGES.iterdir()}
    of_the_paper = {name for name in kept if name.startswith("paper-")}  # by tools/write_paper.py
    assert kept == set(PICTURES) | of_the_paper
    assert kept == shown


def test_pictures_are_small_enough_for_a_repository() -> None:
    sizes = {file.name: file.stat().st_size for file in IMAGES.iterdir()}
    assert {name: size for name, size in sizes.items() if size > MOST_OF_A_PICTURE} == {}
    assert sum(sizes.values()) < MOST_BYTES


@pytest.mark.parametrize("file", sorted(IMAGES.glob("*.svg")), ids=lambda file: file.stem)
def test_a_drawing_stands_alone(file: Path) -> None:
    text = file.read_text(encoding="utf-8")
    ElementTree.fromstring(text)
    assert re.findall(r"(?:href|src)=|@import|url\((?!#)", text) == []


def test_no_page_asks_another_machine_for_fonts() -> None:
    assert CONFIGURATION["theme"]["font"] is False


@pytest.mark.parametrize(
    ("page", "fault"),
    [
        ('<a href="other.html#there">', ""),
        ('<a href="#here"><p id="here">', ""),
        ('<a href="https://example.org">', ""),
        ('<img src="img/a.svg">', ""),
        ('<a href="none.html">', "none.html: is not in the site"),
        ('<a href="other.html#nowhere">', "has no such anchor"),
        ('<a href="../README.md">', "leads out of the site"),
        ('<img src="img/none.svg">', "img/none.svg: is not in the site"),
        ('<script src="https://example.org/a.js">', "loads https://example.org/a.js from another machine"),
        ('<link rel="stylesheet" href="//fonts.example.org/a.css">', "from another machine"),
    ],
)
def test_a_built_site_is_checked(page: str, fault: str, tmp_path: Path) -> None:
    (tmp_path / "img").mkdir()
    (tmp_path / "img/a.svg").write_text("<svg/>")
    (tmp_path / "other.html").write_text('<h2 id="there">')
    (tmp_path / "index.html").write_text(page)
    (tmp_path.parent / "README.md").write_text("")
    found = list(faults(tmp_path))
    assert len(found) == bool(fault)
    assert fault in "".join(found)


def test_style_sheets_and_empty_sites_are_checked(tmp_path: Path) -> None:
    assert "no page" in next(faults(tmp_path))
    (tmp_path / "index.html").write_text("")
    (tmp_path / "a.css").write_text(
        "@import 'https://example.org/b.css'; p { background: url(data:image/png;base64,) }"
    )
    assert list(faults(tmp_path)) == ["a.css: loads https://example.org/b.css from another machine"]
