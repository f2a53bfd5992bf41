"""XML files as trees of elements, read with limits, and with errors that name the line, the element and the value.

A DOCTYPE is refused, so there are no entities. Files beyond `MAX_BYTES`, `MAX_TAGS` or `MAX_ATTRIBUTES` (about 35,000
circles) are refused before they are parsed, compressed ones while they are unpacked. libxml2 counts lines exactly up to
65,535; beyond, the line may be one off. Its RelaxNG names neither attribute nor value, so the form is checked here.
"""

from __future__ import annotations

import io
import itertools
import math
import re
from xml.sax.saxutils import quoteattr

import numpy as np
from lxml import etree

from deep_contact.io.files import FileError

MAX_BYTES = 64 * 2**20
"""Most bytes of a file that is read or written, unpacked; a compressed file may not have more either."""

MAX_TAGS = 750_000
"""Most '<' in a file. With `MAX_ATTRIBUTES` it bounds the memory of the parsed tree to under 1 GB."""

MAX_ATTRIBUTES = 1_500_000
"""Most '=' in a file."""

_MAX_QUOTED = 80
INTEGER = re.compile(r"-?[0-9]{1,18}")
_NUMBER_TEXT = re.compile(r"[0-9.eE+\-]{1,1000}")
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_ENCODING = re.compile(rb"\s*<\?xml[^>]*?\sencoding\s*=\s*[\"'](?!(?i:utf-?8|(?:us-)?ascii)[\"'])([^\"'>]*)")


class StateFileError(FileError):
    """A file cannot be read, or a state cannot be stored; the message names file, line, element and value."""


def refuse_too_large(data: bytes) -> None:
    """Raise StateFileError if a file of these bytes is beyond the limits."""
    counts = {"bytes": len(data), "'<'": data.count(b"<"), "'='": data.count(b"=")}
    for (what, count), most in zip(counts.items(), (MAX_BYTES, MAX_TAGS, MAX_ATTRIBUTES)):
        if count > most:
            raise StateFileError(f"line 1: expected at most {most} {what}, got {count}: too large for a file")


def parse_tree(data: bytes):
    """The root element of a file. Messages of this function, and of those below, lack the name of the file."""
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
    options = {"resolve_entities": False, "no_network": True, "collect_ids": False}
    parser = etree.XMLParser(encoding="utf-8", remove_comments=True, remove_pis=True, **options)
    try:
        return etree.fromstring(data, parser)
    except etree.XMLSyntaxError as error:
        line = error.lineno or 1
        got = next(itertools.islice(io.BytesIO(data), line - 1, None), b"").strip()
        message = f"not well-formed XML, {error.msg[:_MAX_QUOTED]}, got {quote(got)}"
        raise StateFileError(f"line {line}: {message}") from None


# ---- messages ----


def fault(element, message: str, value=None) -> StateFileError:
    """The error about an element, naming its line and the body or contact that it is, or belongs to."""
    owner, got = "", "" if value is None else f", got {quote(value)}"
    for each in (element.getparent(), element):
        if each is not None and each.tag in ("body", "contact") and "index" in each.attrib:
            owner = f"{'' if each is element else f' of {each.tag}'} {quote(each.get('index'))}"
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
    """A text of a file in quotes, cut to a length that a message can show."""
    if isinstance(value, bytes):
        value = value[: 4 * _MAX_QUOTED].decode("utf-8", "backslashreplace")
    return repr(value if len(value) <= _MAX_QUOTED else value[:_MAX_QUOTED] + "…")


# ---- reading: elements and attributes ----


def refuse_attributes(element, known) -> None:
    """Raise StateFileError for the first attribute that is not known."""
    for name in element.keys():  # not items(), which looks up every value from the first attribute on
        if name not in known:
            message = f"{name[:_MAX_QUOTED]}: no such attribute, expected {', '.join(sorted(known))}"
            raise fault(element, message, element.get(name))


def refuse_attributes_of(parts: dict, tags: dict[str, str]) -> None:
    """Raise StateFileError for the first attribute of `children` that is not among those of its tag."""
    for tag, child in parts.items():
        refuse_attributes(child, tags[tag].split())


def children(element, tags) -> dict:
    """The children of an element by tag, each of `tags` at most once."""
    parts = {}
    for child in element:
        if child.tag not in tags:
            raise fault(child, f"expected one of {', '.join(sorted(tags))}", child.tag)
        expect(child.tag not in parts, child, "expected this element once, got a second")
        parts[child.tag] = child
    return parts


def elements_of(container, tag: str, attributes=("count",)) -> list:
    """The children of a container, which are all of one kind; none where there is no container."""
    if container is None:
        return []
    refuse_attributes(container, attributes)
    count = container.get("count", str(len(container)))  # a claim to be checked, never to be believed
    expect(count == str(len(container)), container, f"count: expected {len(container)}, as there are", count)
    for child in container:
        expect(child.tag == tag, child, f"expected a <{tag}> here", child.tag)
    return list(container)


def by_index(elements) -> dict:
    """Index -> element, by the attribute `index`. Raises StateFileError for an index that occurs twice."""
    numbered = {}
    for element in elements:
        index = read_integer(element, "index")
        expect(index not in numbered, element, "index: expected each once, got a duplicate of", str(index))
        numbered[index] = element
    return numbered


class XmlRows:
    """Elements of one kind with their children by tag, read by columns.

    tags: tag of a child -> its attributes, such as "x y". Other tags and attributes are refused.
    """

    def __init__(self, elements, tags: dict[str, str]):
        self.elements = list(elements)
        self.parts = [children(element, tags) for element in self.elements]
        for parts in self.parts:
            refuse_attributes_of(parts, tags)

    def texts(self, tag: str, name: str) -> list[str]:
        """An attribute of the child `tag` of every row."""
        for row, parts in zip(self.elements, self.parts):
            expect(tag in parts, row, f"element <{tag}> is missing")
        return [read_text(parts[tag], name) for parts in self.parts]

    def numbers(self, tag: str, names: str) -> np.ndarray:
        """Finite float64: (rows,) of one attribute, or (rows, k) of several, such as "x y"."""
        columns = []
        for name in names.split():
            columns.append(np.array([to_float(text) for text in self.texts(tag, name)], dtype=np.float64))
            self.refuse(~np.isfinite(columns[-1]), tag, name, "a finite number")
        return columns[0] if len(columns) == 1 else np.column_stack(columns)

    def refuse(self, bad: np.ndarray, tag: str, names: str, expected: str) -> None:
        """Raise StateFileError for the first row that is bad, quoting its texts."""
        if bad.any():
            element = self.parts[np.argmax(bad)][tag]
            got = ", ".join(element.get(name) for name in names.split())
            raise fault(element, f"{names}: expected {expected}", got)


def to_float(text: str) -> float:
    """The number in a text; NaN if the text is no number, infinite if the number overflows."""
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


# ---- writing ----


def quoted_attribute(name: str, text: str) -> str:
    """A text in quotes, as an attribute has it. Raises ValueError naming the attribute where XML cannot hold it."""
    if not isinstance(text, str) or _NOT_XML.search(text):
        raise ValueError(f"{name}: expected text without control characters, got {text!r}")
    return quoteattr(text)


def text_of(opening: str, children: dict[str, str], last: str = "") -> str:
    """The template of an element of a list: its children with their attributes, such as "x y", as numbers."""
    attributes = {tag: " ".join(f'{name}="%r"' for name in names.split()) for tag, names in children.items()}
    lines = [f"<{tag} {texts}/>" for tag, texts in attributes.items()] + ([last] if last else [])
    inner = "".join(f"      {line}\n" for line in lines)
    return f"    <{opening}>\n{inner}    </{opening.split()[0]}>\n"


def fill(template: str, rows: int, columns) -> str:
    """The template once per row. One call for all rows, on Python numbers, is what makes writing fast."""
    lists = [column.tolist() if isinstance(column, np.ndarray) else column for column in columns]
    return template * rows % tuple(itertools.chain.from_iterable(zip(*lists)))
