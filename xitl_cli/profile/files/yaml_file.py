"""YAML text -> entries with origins.

Scalars follow the YAML 1.2 core schema, so `no` and `on` are text, `1e-3` is a number and `1:30` is text. Refused:
duplicate keys, keys that are not text, tags, merge keys (`extends` does that), aliases to themselves.
"""

from __future__ import annotations

import gc
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml

from agent.files import read_text
from xitl_cli.profile.files.entry import Entry, Origin, Scalar, profile_error, shown

MAX_BYTES = 16 << 20
MAX_VALUES = 100_000  # limit for an alias bomb, unless the text itself has as many values
LONG_TEXT = 1 << 16  # from this length on, errors are those of the fast loader, which are less precise
MAX_DEPTH = 60

_NULL = re.compile(r"~|null|Null|NULL|")
_BOOL = re.compile(r"true|True|TRUE|false|False|FALSE")
_INT = re.compile(r"[-+]?[0-9]{1,400}|0x[0-9a-fA-F]{1,300}|0o[0-7]{1,300}")
_FLOAT = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")


class _Loader(yaml.SafeLoader):
    """Composes nodes only; scalars are resolved here, by YAML 1.2."""

    yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012 - PyYAML's own class attribute


_quick_loader: Any = _Loader
if yaml.__with_libyaml__:

    class _LibyamlLoader(yaml.CSafeLoader):
        """The same, about ten times as fast."""

        yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012 - PyYAML's own class attribute

    _quick_loader = _LibyamlLoader


_SAME_IN_BOTH = re.compile(r"(?:[^\x00-\x09\x0b-\x1f\x7f-\x9f\u2028\u2029\ufeff?!%|>]|[|>](?!#)|(?<=[ \w])%)*")
"""Texts that both loaders read alike. They differ in tabs, other spaces and line ends, `?`, tags, directives, and
comments directly after `|`."""

_SURELY_COMPOSED = 400
"""Depth that libyaml composes on the stack of any thread. Only long profiles can have more."""


class _RefusedError(Exception):
    def __init__(self, line: int, sentence: str) -> None:
        super().__init__(sentence)
        self.line = line
        self.sentence = sentence


def read_yaml(path: Path, shown_as: str) -> Entry:
    """Return the mapping in the file at `path`, with `shown_as` as the source. Raises ProfileError if it is not one."""
    try:
        text = read_text(path, MAX_BYTES)
    except UnicodeDecodeError as error:
        raise profile_error(Origin(shown_as, 1), f"is not UTF-8 text (byte {error.start}); save it as UTF-8") from None
    except OSError as error:
        reason = (error.strerror or "unknown reason").lower()
        raise profile_error(
            Origin(shown_as, None), f"cannot be read: {reason}; check the path and its permissions"
        ) from None
    entry = _parsed_once(text, shown_as) if len(text) < LONG_TEXT else parse_yaml(text, shown_as)
    if entry is None:
        raise profile_error(
            Origin(shown_as, 1), "is empty; a profile is a mapping of keys such as `extends:` and `mission:`"
        )
    if not isinstance(entry.value, dict):
        raise profile_error(
            Origin(shown_as, entry.origin.line), f"is {shown(entry.plain())}; a profile is a mapping of keys"
        )
    return entry


@lru_cache(maxsize=256)
def _parsed_once(text: str, source: str) -> Entry | None:
    """Parse a text once. Most profiles share the same bases, and an entry never changes, so they share it."""
    return parse_yaml(text, source)


def parse_yaml(text: str, source: str, first_line: int | None = 1) -> Entry | None:
    """Return the value in `text`, None without one. With `first_line` None, origins have no line (an override)."""

    def origin(line: int) -> Origin:
        return Origin(source, None if first_line is None else first_line + line)

    try:
        _refuse_deep(text)
        if len(text) < LONG_TEXT and _SAME_IN_BOTH.fullmatch(text):
            with suppress(yaml.YAMLError, RecursionError, _RefusedError):  # the other loader has the precise error
                return _entry(_quick_loader, text, origin)
        return _entry(_Loader if len(text) < LONG_TEXT else _quick_loader, text, origin)
    except _RefusedError as error:
        raise profile_error(origin(error.line), error.sentence) from None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        problem = " ".join((error.problem or error.context or "syntax error").split())
        column = f", column {mark.column + 1}" if mark else ""
        sentence = f"is not valid YAML: {problem}{column}; check indentation, quotes and colons"
        raise profile_error(origin(mark.line if mark else 0), sentence) from None
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position)
        sentence = f"contains the character {chr(error.character)!r}, which YAML does not allow; remove it"
        raise profile_error(origin(line), sentence) from None
    except RecursionError:
        raise profile_error(origin(0), "is nested too deeply; flatten it") from None


def _entry(make_loader: Callable[[str], Any], text: str, origin: Callable[[int], Origin]) -> Entry | None:
    loader = make_loader(text)
    try:
        with _no_collection():
            node = loader.get_single_node()
            return None if node is None else _Reader(origin, len(text)).entry(node, node.start_mark.line)
    finally:
        loader.dispose()


def _refuse_deep(text: str) -> None:
    """Raise _RefusedError for a text that is nested so deeply that libyaml, which recurses in C, would crash."""
    longest = max(map(len, text.splitlines()), default=0)
    if text.count("[") + text.count("{") + longest <= _SURELY_COMPOSED:  # a level needs a bracket or a column
        return
    events, depth = _quick_loader(text), 0
    try:
        with suppress(yaml.YAMLError):  # the reader of the nodes has the precise error
            while events.check_event():
                event = events.get_event()
                depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
                if depth > MAX_DEPTH:
                    raise _RefusedError(event.start_mark.line, "is nested too deeply; flatten it")
    finally:
        events.dispose()


@contextmanager
def _no_collection() -> Iterator[None]:
    """Pause the garbage collector while nodes are created. It would take most of the time."""
    was_on = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_on:
            gc.enable()


class _Reader:
    """Converts the nodes of a text with this many characters to entries, within limits."""

    def __init__(self, origin: Any, characters: int) -> None:
        self._origin = origin
        self._values = 0
        self._most = max(MAX_VALUES, characters)  # without aliases no text has more values than characters

    def entry(self, node: yaml.Node, line: int, depth: int = 0) -> Entry:
        """Return the entry of `node`. `line` (0-based): line of its key, or of the node in a list."""
        self._values += 1
        if self._values > self._most:
            raise _RefusedError(line, f"expands to more than {self._most} values; use fewer aliases")
        if depth > MAX_DEPTH:
            raise _RefusedError(line, "is nested too deeply, or an alias contains itself; flatten it")
        if isinstance(node, yaml.MappingNode):
            _refuse_tag(node, "tag:yaml.org,2002:map")
            return Entry(self._mapping(node, depth), self._origin(line))
        if isinstance(node, yaml.SequenceNode):
            _refuse_tag(node, "tag:yaml.org,2002:seq")
            items = tuple(self.entry(item, item.start_mark.line, depth + 1) for item in node.value)
            return Entry(items, self._origin(line))
        assert isinstance(node, yaml.ScalarNode)
        _refuse_tag(node, "tag:yaml.org,2002:str")
        return Entry(_scalar(node), self._origin(line))

    def _mapping(self, node: yaml.MappingNode, depth: int) -> dict[str, Entry]:
        entries: dict[str, Entry] = {}
        for key_node, value_node in node.value:
            line = key_node.start_mark.line
            key = _scalar(key_node) if isinstance(key_node, yaml.ScalarNode) else None
            if not isinstance(key, str):
                raise _RefusedError(
                    line, f"the key {shown(getattr(key_node, 'value', key))} is not text; put it in quotes"
                )
            if key == "<<":
                raise _RefusedError(line, "merge keys (<<) are not used in profiles; name a profile under `extends:`")
            if key in entries:
                before = entries[key].origin
                raise _RefusedError(line, f"the key {key!r} is a duplicate of the one at {before}; remove one of them")
            entries[key] = self.entry(value_node, line, depth + 1)
        return entries


def _refuse_tag(node: yaml.Node, plain: str) -> None:
    if node.tag not in (plain, "!"):
        line = node.start_mark.line
        raise _RefusedError(line, f"the tag {shown(node.tag)} is not used in profiles; remove it")


def plain_scalar(text: str) -> Scalar:
    """Return the value of `text` without quotes."""
    if _NULL.fullmatch(text):
        return None
    if _BOOL.fullmatch(text):
        return text.lower() == "true"
    if _INT.fullmatch(text):
        return int(text, {"0x": 16, "0o": 8}.get(text[:2], 10))
    if _FLOAT.fullmatch(text):
        return float(text.lower().replace(".inf", "inf").replace(".nan", "nan"))
    return text


def _scalar(node: yaml.ScalarNode) -> Scalar:
    text: str = node.value
    return text if node.style else plain_scalar(text)  # quoted or block: always text
