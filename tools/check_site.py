"""Check a built site: what its pages name is in it, anchors too, and no page asks another machine for anything.

python tools/check_site.py build/site
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

LOADED = {"img": "src", "script": "src", "link": "href", "iframe": "src", "source": "src", "video": "src"}
NAMED_ONLY = {"canonical", "prev", "next", "alternate"}  # <link rel=…> that a browser does not load
_CSS_URL = re.compile(r"@import\s+[\"']([^\"']+)|url\(\s*[\"']?([^\"')]+)")
_PAGES_OF_THEIR_OWN = ("404.html",)  # served at any depth, with addresses from the root


class Page(HTMLParser):
    """links: what a reader may follow; loaded: what the browser asks for; anchors: what # may name."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.anchors: set[str] = set()
        self.feed(text)

    def handle_starttag(self, tag: str, attributes: list[tuple[str, str | None]]) -> None:
        given = {name: value or "" for name, value in attributes}
        self.anchors |= {given[name] for name in ("id", "name") if name in given}
        if tag == "a" and "href" in given:
            self.links.append(given["href"])
        address = given.get(LOADED.get(tag, ""))
        if address and not (tag == "link" and given.get("rel") in NAMED_ONLY):
            self.loaded.append(address)


def faults(site: Path) -> Iterator[str]:
    """A sentence for each."""
    pages = {file: Page(file.read_text(encoding="utf-8")) for file in sorted(site.rglob("*.html"))}
    if not pages:
        yield f"{site}: no page; build it with `make docs`"
    for file, page in pages.items():
        if file.name in _PAGES_OF_THEIR_OWN:
            continue
        name = file.relative_to(site)
        yield from (f"{name}: loads {address} from another machine" for address in page.loaded if is_outside(address))
        for address in [*page.links, *page.loaded]:
            if not is_outside(address) and (fault := _missing(address, file, site, pages)):
                yield f"{name}: {address}: {fault}"
    for file in sorted(site.rglob("*.css")):
        for found in _CSS_URL.finditer(file.read_text(encoding="utf-8")):
            if is_outside(address := found[1] or found[2]):
                yield f"{file.relative_to(site)}: loads {address} from another machine"


def is_outside(address: str) -> bool:
    """Whether it leads to another machine."""
    parts = urlsplit(address)
    return bool(parts.netloc) or parts.scheme in ("http", "https")


def _missing(address: str, file: Path, site: Path, pages: dict[Path, Page]) -> str:
    parts = urlsplit(address)
    if parts.scheme:  # data:, mailto:
        return ""
    target = (file.parent / unquote(parts.path)).resolve() if parts.path else file
    if target.is_dir():
        target /= "index.html"
    if not target.is_relative_to(site.resolve()) and target != file:
        return "leads out of the site"
    if not target.exists():
        return "is not in the site"
    anchors = {page.resolve(): read.anchors for page, read in pages.items()}.get(target.resolve())
    if parts.fragment and anchors is not None and unquote(parts.fragment) not in anchors:
        return "has no such anchor"
    return ""


def main() -> None:
    if len(sys.argv) != 2:
        sys.exit(__doc__)
    found = list(faults(Path(sys.argv[1]).resolve()))
    sys.exit("\n".join(found) if found else 0)


if __name__ == "__main__":
    main()
