"""The language of conditions, constraints, verdicts and signals: parsing of text to a tree with few kinds of nodes.

    wrap180(ATT.DesYaw - ATT.Yaw)
    hypot(XKF1[0].VN, XKF1[0].VE) > 2 and not /actuators.armed
    /truth/state.position_ned_m[0] / 2
    faults.lossy-link.link.loss <= 0.3

Names are paths of words and numbers, with dots and [k]. If a value is expected, `/` begins the name of a topic, which
ends at its first dot. The operators and their precedence are Python's. Other input is an error, and no input is
executed. The report's page parses the same language (`report/assets/expressions.js`).
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import NoReturn, TypeAlias

LONGEST = 1000
DEEPEST = 50
OPERATORS = "+ - * / % **, == != < <= > >=, and, or, not"


class ExpressionError(ValueError):
    """Error in an expression and its fix, worded to follow the expression."""


@dataclass(frozen=True, slots=True)
class SyntaxNode:
    """A node; begin and end are its position in the text."""

    begin: int
    end: int


@dataclass(frozen=True, slots=True)
class Number(SyntaxNode):
    value: int | float


@dataclass(frozen=True, slots=True)
class TextLiteral(SyntaxNode):
    value: str


@dataclass(frozen=True, slots=True)
class Word(SyntaxNode):
    """The word true, false or null."""

    value: bool | None


@dataclass(frozen=True, slots=True)
class Name(SyntaxNode):
    """A name; path: as written, without spaces."""

    path: str


@dataclass(frozen=True, slots=True)
class Prefix(SyntaxNode):
    """A prefix operator; sign: - + not."""

    sign: str
    operand: Tree


@dataclass(frozen=True, slots=True)
class Arithmetic(SyntaxNode):
    """A binary operator; sign: + - * / % **."""

    sign: str
    left: Tree
    right: Tree


@dataclass(frozen=True, slots=True)
class ComparisonChain(SyntaxNode):
    """A chain of comparisons, such as `0 < x <= 3`, with one sign between two sides."""

    signs: tuple[str, ...]
    sides: tuple[Tree, ...]


@dataclass(frozen=True, slots=True)
class Junction(SyntaxNode):
    """A junction; sign: and, or."""

    sign: str
    parts: tuple[Tree, ...]


@dataclass(frozen=True, slots=True)
class Call(SyntaxNode):
    function: str
    arguments: tuple[Tree, ...]


Tree: TypeAlias = Number | TextLiteral | Word | Name | Prefix | Arithmetic | ComparisonChain | Junction | Call


@dataclass(frozen=True, slots=True)
class Language:
    """The language allowed in one place."""

    kind: str
    """Name of a text in this language."""
    example: str
    """Example of such a text."""
    functions: Mapping[str, tuple[int, int | None]]
    """By name, the least and largest number of arguments (None: any number)."""
    null: bool = False
    """Whether null is a value."""
    elements: bool = True
    """Whether a name may have [k]."""

    @property
    def allowed(self) -> str:
        return f"names, numbers, 'texts', {OPERATORS}, ( ) and {', '.join(self.functions)}"


@dataclass(frozen=True, slots=True)
class _Token:
    kind: str
    text: str
    begin: int
    end: int


_WORDS: dict[str, bool | None] = {
    "true": True, "false": False, "null": None, "True": True, "False": False, "None": None,
}  # fmt: skip
_FOREIGN = frozenset(("in", "is", "if", "else", "for", "lambda", "await", "yield"))
_SPACE = re.compile(r"\s*")
_NUMBER = re.compile(r"(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?(?!\w)")
_TEXT = re.compile(r"'[^']*'|\"[^\"]*\"")
_FIELDS = r"(?:\[\d+\]|\s*\.\s*\w+)*"
_NAME = re.compile(rf"[^\W\d]\w*{_FIELDS}")
_TOPIC = re.compile(rf"(?:/[^\W\d]\w*)+(?::[^\W\d]\w*)?{_FIELDS}")
_SIGN = re.compile(r"\*\*|==|!=|<=|>=|[-+*/%<>(),]")
_COMPARISONS = ("==", "!=", "<", "<=", ">", ">=")


def parse(text: str, language: Language, known: Iterable[str] = ()) -> Tree:
    """Return the tree of `text`.

    known: names with other characters than words have, such as `faults.lossy-link`, or topics with hyphens. Raises
    ExpressionError.
    """
    if len(text) > LONGEST:
        raise ExpressionError(f"is {len(text)} characters long; {LONGEST} is the limit, so split it")
    odd = sorted((name for name in known if not (_NAME.fullmatch(name) or _TOPIC.fullmatch(name))), key=len)[::-1]
    parser = _Parser(text, language, odd)
    tree = parser.disjunction()
    parser.finish()
    return tree


def names_in(tree: Tree) -> Iterator[str]:
    """Paths of all names in order, with repetitions."""
    for node in nodes(tree):
        if isinstance(node, Name):
            yield node.path


def functions_in(tree: Tree) -> set[str]:
    return {node.function for node in nodes(tree) if isinstance(node, Call)}


def nodes(tree: Tree) -> Iterator[Tree]:
    yield tree
    below: Collection[Tree] = ()
    match tree:
        case Prefix(operand=operand):
            below = (operand,)
        case Arithmetic(left=left, right=right):
            below = (left, right)
        case ComparisonChain(sides=sides):
            below = sides
        case Junction(parts=parts):
            below = parts
        case Call(arguments=arguments):
            below = arguments
    for node in below:
        yield from nodes(node)


class _Parser:
    """Recursive descent, one method per level of precedence, the lowest first."""

    def __init__(self, text: str, language: Language, odd: list[str]) -> None:
        self._text, self._language, self._odd = text, language, odd
        self._depth = 0
        self._ended = 0
        self._token = _Token("start", "", 0, 0)
        self._next(operand=True)

    def finish(self) -> None:
        if self._token.kind != "end":
            self._unexpected()

    def disjunction(self) -> Tree:
        return self._junction("or", lambda: self._junction("and", self._negation))

    def _junction(self, sign: str, part: Callable[[], Tree]) -> Tree:
        parts: list[Tree] = [part()]
        while self._is(sign):
            self._next(operand=True)
            parts.append(part())
        return parts[0] if len(parts) == 1 else Junction(parts[0].begin, parts[-1].end, sign, tuple(parts))

    def _negation(self) -> Tree:
        return self._prefixed(("not",), self._negation, self._comparison)

    def _comparison(self) -> Tree:
        sides, signs = [self._sum()], []
        while self._token.kind == "sign" and self._token.text in _COMPARISONS:
            signs.append(self._token.text)
            self._next(operand=True)
            sides.append(self._sum())
        if not signs:
            return sides[0]
        return ComparisonChain(sides[0].begin, sides[-1].end, tuple(signs), tuple(sides))

    def _sum(self) -> Tree:
        return self._chain(("+", "-"), lambda: self._chain(("*", "/", "%"), self._signed))

    def _chain(self, signs: tuple[str, ...], part: Callable[[], Tree]) -> Tree:
        left = part()
        many = 0
        while self._token.kind == "sign" and self._token.text in signs:
            sign, many = self._token.text, many + 1
            if many > DEEPEST:
                self._too_deep()
            self._next(operand=True)
            right = part()
            left = Arithmetic(left.begin, right.end, sign, left, right)
        return left

    def _signed(self) -> Tree:
        return self._prefixed(("-", "+"), self._signed, self._power)

    def _prefixed(self, signs: tuple[str, ...], again: Callable[[], Tree], below: Callable[[], Tree]) -> Tree:
        if self._token.text not in signs or self._token.kind not in ("sign", "word"):
            return below()
        token = self._token
        self._next(operand=True)
        self._deeper()
        operand = again()
        self._depth -= 1
        return Prefix(token.begin, operand.end, token.text, operand)

    def _power(self) -> Tree:
        base = self._operand()
        if not self._is("**"):
            return base
        self._next(operand=True)
        self._deeper()
        exponent = self._signed()
        self._depth -= 1
        return Arithmetic(base.begin, exponent.end, "**", base, exponent)

    def _operand(self) -> Tree:
        token = self._token
        if token.kind == "number":
            self._next(operand=False)
            value = float(token.text)
            whole = token.text.isdigit() and value < 2**62
            return Number(token.begin, token.end, int(token.text) if whole else value)
        if token.kind == "text":
            self._next(operand=False)
            return TextLiteral(token.begin, token.end, token.text[1:-1])
        if token.kind == "name":
            self._next(operand=False)
            if token.text in _WORDS:
                if _WORDS[token.text] is None and not self._language.null:
                    self._refuse(f"contains {token.text}, which is not allowed here")
                return Word(token.begin, token.end, _WORDS[token.text])
            if not self._is("("):
                if "[" in token.text and not self._language.elements:
                    self._refuse(f"contains {token.text}, but no value here has elements")
                return Name(token.begin, token.end, token.text)
            if token.text not in self._language.functions:
                there = ", ".join(self._language.functions)
                self._refuse(f"calls {token.text}, which is not a function here; choose from {there}")
            self._next(operand=True)
            self._deeper()
            arguments: list[Tree] = []
            while not self._is(")"):
                arguments.append(self.disjunction())
                if not self._is(","):
                    break
                self._next(operand=True)
            self._depth -= 1
            self._close()
            least, most = self._language.functions[token.text]
            if len(arguments) < least or (most is not None and len(arguments) > most):
                wanted = f"{least} or more" if most is None else str(least) if most == least else f"{least} to {most}"
                shown = self._text[token.begin : self._ended]
                noun = "value" if wanted == "1" else "values"
                self._refuse(f"contains {shown}, but {token.text} takes {wanted} {noun}")
            return Call(token.begin, self._ended, token.text, tuple(arguments))
        if self._is("("):
            self._next(operand=True)
            self._deeper()
            inner = self.disjunction()
            self._depth -= 1
            self._close()
            return inner
        return self._unexpected()

    def _close(self) -> None:
        if not self._is(")"):
            self._unexpected()
        self._next(operand=False)

    def _deeper(self) -> None:
        self._depth += 1
        if self._depth > DEEPEST:
            self._too_deep()

    def _too_deep(self) -> NoReturn:
        self._refuse(f"is nested more than {DEEPEST} levels deep; simplify it")

    def _is(self, text: str) -> bool:
        return self._token.kind in ("sign", "word") and self._token.text == text

    def _next(self, *, operand: bool) -> None:
        """Move to the next token. If an operand is expected, a / begins a topic."""
        self._ended = self._token.end
        space = _SPACE.match(self._text, self._token.end)
        assert space is not None
        begin = space.end()
        if begin == len(self._text):
            self._token = _Token("end", "", begin, begin)
            return
        for name in self._odd:
            if self._text.startswith(name, begin) and (operand or not name.startswith("/")):
                fields = re.compile(rf"{re.escape(name)}{_FIELDS}(?!\w)").match(self._text, begin)
                if fields is not None:
                    self._token = _Token("name", _unspaced(fields[0]), begin, fields.end())
                    return
        kinds = [("number", _NUMBER), ("text", _TEXT), *([("name", _TOPIC)] if operand else []), ("name", _NAME)]
        for kind, pattern in [*kinds, ("sign", _SIGN)]:
            if match := pattern.match(self._text, begin):
                word = kind == "name" and (match[0] in ("and", "or", "not") or match[0] in _FOREIGN)
                text = match[0] if kind != "name" else _unspaced(match[0])
                self._token = _Token("word" if word else kind, text, begin, match.end())
                return
        letter = self._text[begin]
        if letter in "[]{}" or (letter == "." and operand):
            self._refuse(f"contains {letter!r} in a wrong place; use {self._language.allowed}")
        if letter == "=":
            self._broken("= does not compare; write ==")
        self._broken(f"{letter!r} at its character {begin + 1}")

    def _unexpected(self) -> NoReturn:
        token = self._token
        if token.kind == "end":
            self._broken("it is incomplete")
        if token.text == "in" or token.text == "is":
            self._refuse(f"contains `{token.text}`, but `in` and `is` do not exist here; use {self._language.allowed}")
        if token.kind == "sign":
            self._broken(f"{token.text!r} at its character {token.begin + 1}")
        self._refuse(f"contains {self._text[token.begin : token.end]} in a wrong place; use {self._language.allowed}")

    def _broken(self, why: str) -> NoReturn:
        self._refuse(f"is not a valid {self._language.kind} ({why}); write, for example, {self._language.example}")

    def _refuse(self, sentence: str) -> NoReturn:
        raise ExpressionError(sentence)


def _unspaced(name: str) -> str:
    return re.sub(r"\s", "", name)
