"""Untrusted XML as a small tree with line numbers. A document type is refused, so that no entity is ever expanded.

Neither KML nor GPX has one. Entity bombs, external entities and external document types all need it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from xml.parsers import expat

from xitl_cli.profile.missions.course import MissionFileError

MOST_DEPTH = 100
MOST_ELEMENTS = 500_000


@dataclass(slots=True)
class Element:
    """One element of an XML document."""

    name: str
    """Without its namespace."""
    attributes: dict[str, str]
    line: int
    """1-based."""
    pieces: list[str] = field(default_factory=list)
    """Pieces of the text directly in it."""
    children: list[Element] = field(default_factory=list)

    def walk(self) -> Iterator[Element]:
        """Yield the element and all elements below it, in the order of the file."""
        yield self
        for child in self.children:
            yield from child.walk()

    def text_of(self, name: str) -> str:
        """Return the text of the children of this name."""
        return " ".join("".join(child.pieces) for child in self.children if child.name == name)


class _Builder:
    def __init__(self) -> None:
        self.root: Element | None = None
        self._open: list[Element] = []
        self._count = 0
        self._parser = parser = expat.ParserCreate(namespace_separator=" ")
        parser.SetParamEntityParsing(expat.XML_PARAM_ENTITY_PARSING_NEVER)
        parser.StartDoctypeDeclHandler = self._refuse_doctype
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.CharacterDataHandler = self._characters
        parser.buffer_text = True

    def parse(self, text: str) -> None:
        self._parser.Parse(text.encode(), True)

    def _refuse_doctype(self, name: str, *rest: object) -> None:
        line = self._parser.CurrentLineNumber
        raise MissionFileError("has a <!DOCTYPE>, which KML and GPX have not; remove it with its entities", line)

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        line = self._parser.CurrentLineNumber
        self._count += 1
        if len(self._open) >= MOST_DEPTH or self._count > MOST_ELEMENTS:
            raise MissionFileError("has too many elements, or too deep ones; save only the course", line)
        element = Element(name.rpartition(" ")[2], attributes, line)
        if self._open:
            self._open[-1].children.append(element)
        else:
            self.root = element
        self._open.append(element)

    def _end(self, name: str) -> None:
        self._open.pop()

    def _characters(self, text: str) -> None:
        self._open[-1].pieces.append(text)


def read_xml(text: str) -> Element:
    """Return the root of a document. Raises MissionFileError with the line."""
    builder = _Builder()
    try:
        builder.parse(text)
    except expat.ExpatError as error:
        what = expat.ErrorString(error.code)
        raise MissionFileError(f"is not valid XML: {what}; save it again", error.lineno) from None
    assert builder.root is not None
    return builder.root
