"""XML files as trees of elements, read with limits, and with errors that name the line, the element and the value.

A DOCTYPE is refused, so there are no entities. Files beyond `MAX_BYTES`, `MAX_TAGS` or `MAX_ATTRIBUTES` (about 35,000
circles) are refused before they are parsed, compressed ones while they are unpacked. libxml2 counts lines exactly up to
65,535; beyond, the line may be one off.
"""

from __future__ import annotations

import io
import itertools
import math
import re

import numpy as np
from lxml import etree

MAX_BYTES = 64 * 2**20
"""Largest file that is read or written, unpacked; also the most that is read of a compressed one."""

MAX_TAGS = 750_000
"""Most '<' in a file. With `MAX_ATTRIBUTES` it bounds the memory of the parsed tree to under 1 GB."""

MAX_ATTRIBUTES = 1_500_000
"""Most '=' in a file."""

_MAX_QUOTED = 80
INTEGER = re.compile(r"-?[0-9]{1,18}")
_NUMBER_TEXT = re.compile(r"[0-9.eE+\-]{1,1000}")
_ENCODING = re.compile(rb"\s*<\?xml[^>]*?\sencoding\s*=\s*[\"'](?!(?i:utf-?8|(?:us-)?ascii)[\"'])([^\"'>]*)")


class StateFileError(ValueError):
    """A file that cannot be read, or a state that cannot be stored; names file, line, element and value."""


def refuse_too_large(data: bytes) -> None:
    """Raise StateFileError if a file of these bytes is beyond the limits."""
    for what, count, most in (
        ("bytes", len(data), MAX_BYTES),
        ("'<'", data.count(b"<"), MAX_TAGS),
        ("'='", data.count(b"="), MAX_ATTRIBUTES),
    ):
        if count > most:
            raise StateFileError(f"line 1: expected at most {most} {what}, got {count}: too large for a file")


def parse_tree(data: bytes):
    """The root element. The messages of this function, and of those below, lack the name of the file."""
    refuse_too_large(data)
    if not data.strip():
        raise StateFileError("line 1: expected an XML file, got an empty one")
    try:
        data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise _fault_at(data, error.start, "expected UTF-8", error.start + 1) from None
    declared = _ENCODING.match(data[:1024].removeprefix(b"\xef\xbb\xbf"))
    if declared:
        raise StateFileError(f"line 1: <?xml?> encoding: expected UTF-8, got {quote(declared[1])}")
    for forbidden in (b"\0", b"<!DOCTYPE", b"<!ENTITY"):
        if forbidden in data:
            raise _fault_at(data, data.index(forbidden), "expected no DOCTYPE, entities or NUL")
    # The encoding is fixed: no declaration can make the parser see a DOCTYPE where the search above saw none. By
    # default lxml loads no DTD and refuses deep trees and long texts.
    parser = etree.XMLParser(
        encoding="utf-8",
        resolve_entities=False,
        no_network=True,
        collect_ids=False,
        remove_comments=True,
        remove_pis=True,
    )
    try:
        root = etree.fromstring(data, parser)
    except etree.XMLSyntaxError as error:
        line = error.lineno or 1
        quoted = next(itertools.islice(io.BytesIO(data), line - 1, None), b"").strip()
        message = f"not well-formed XML, {error.msg[:_MAX_QUOTED]}, got {quote(quoted)}"
        raise StateFileError(f"line {line}: {message}") from None
    return root


# ---- messages ----


def fault(element, message: str, value=None) -> StateFileError:
    """The error about an element, naming its line and the body or contact that it is, or belongs to."""
    parent, owner = element.getparent(), ""
    if element.tag in ("body", "contact") and "index" in element.attrib:
        owner = f" {quote(element.get('index'))}"
    elif parent is not None and parent.tag in ("body", "contact") and "index" in parent.attrib:
        owner = f" of {parent.tag} {quote(parent.get('index'))}"
    got = "" if value is None else f", got {quote(value)}"
    return StateFileError(f"line {element.sourceline or 1}, <{element.tag[:_MAX_QUOTED]}>{owner}: {message}{got}")


def expect(condition, element, message: str, value=None) -> None:
    """Raise `fault` unless the condition holds."""
    if not condition:
        raise fault(element, message, value)


def _fault_at(data: bytes, start: int, message: str, end: int | None = None) -> StateFileError:
    """The error about the bytes from `start`, quoting them up to `end`."""
    line = data.count(b"\n", 0, start) + 1
    return StateFileError(f"line {line}: {message}, got {quote(data[start:end])}")


def quote(value) -> str:
    """What a file holds, cut to a length that a message can show."""
    if isinstance(value, bytes):
        value = value[: 4 * _MAX_QUOTED].decode("utf-8", "backslashreplace")
    return repr(value if len(value) <= _MAX_QUOTED else value[:_MAX_QUOTED] + "…")


# ---- reading: elements and attributes ----


def refuse_attributes(element, known) -> None:
    """Raise StateFileError for the first attribute that is not known."""
    for name in element.keys():  # not items(), which looks every value up from the first attribute on
        if name not in known:
            message = f"{name[:_MAX_QUOTED]}: no such attribute, expected {', '.join(sorted(known))}"
            raise fault(element, message, element.get(name))


def children(elements, tags) -> dict:
    """Elements by tag, each of `tags` at most once."""
    parts = {}
    for element in elements:
        if element.tag not in tags:
            raise fault(element, f"expected one of {', '.join(sorted(tags))}", element.tag)
        expect(element.tag not in parts, element, "expected this element once, got a second")
        parts[element.tag] = element
    return parts


class Rows:
    """Elements of one kind with their children by tag, read by columns.

    A column is named "element attribute", with its spellings: "velocity x|velocity vx", the canonical one first.
    """

    def __init__(self, elements, tags):
        self.elements = elements
        self.parts = [children(element, tags) for element in elements]

    def column(self, spelling: str) -> list:
        """(element, attribute, text) of every row, in the first spelling that it has."""
        spellings, found = [each.split() for each in spelling.split("|")], []
        for row, parts in zip(self.elements, self.parts):
            for tag, attribute in spellings:
                text = parts[tag].get(attribute) if tag in parts else None
                if text is not None:
                    found.append((parts[tag], attribute, text))
                    break
            else:
                tag, attribute = next((each for each in spellings if each[0] in parts), spellings[0])
                expect(tag in parts, row, f"element <{tag}> is missing")
                raise fault(parts[tag], f"{attribute}: attribute is missing")
        return found

    def numbers(self, spelling: str) -> np.ndarray:
        """One finite float64 per row."""
        numbers = np.array([to_float(text) for _, _, text in self.column(spelling)], dtype=np.float64)
        self.refuse(~np.isfinite(numbers), spelling, "a finite number")
        return numbers

    def vectors(self, x: str, y: str) -> np.ndarray:
        """(rows, 2) finite float64."""
        return np.column_stack([self.numbers(x), self.numbers(y)])

    def refuse(self, bad: np.ndarray, spelling: str, expected: str) -> None:
        """Raise for the first row that is bad, quoting its text."""
        if bad.any():
            element, attribute, text = self.column(spelling)[np.argmax(bad)]
            raise fault(element, f"{attribute}: expected {expected}", text)

    def have(self, tag: str, required: bool) -> bool:
        """Whether the rows have the child: all or none (all, if required)."""
        lacking = [row for row, parts in zip(self.elements, self.parts) if tag not in parts]
        if lacking and (required or len(lacking) < len(self.parts)):
            others = "" if required else ", though other contacts have it"
            raise fault(lacking[0], f"element <{tag}> is missing{others}")
        return not lacking


def to_float(text: str) -> float:
    """The number in a text, NaN if it is none; infinite if it overflows."""
    try:
        return float(text) if _NUMBER_TEXT.fullmatch(text) else math.nan
    except ValueError:
        return math.nan


def read_text(element, name: str) -> str:
    text = element.get(name)
    expect(text is not None, element, f"{name}: attribute is missing")
    return text


def read_number(element, name: str) -> float:
    text = read_text(element, name)
    number = to_float(text)
    expect(math.isfinite(number), element, f"{name}: expected a finite number", text)
    return number


def read_integer(element, name: str) -> int:
    text = read_text(element, name)
    expect(INTEGER.fullmatch(text), element, f"{name}: expected an integer of at most 18 digits", text)
    return int(text)
