"""XML files as trees of elements, with limits of size and errors that name the line, the element and the value.

A file with a DOCTYPE is refused, so there are no entities. A file that exceeds `MAX_BYTES`, `MAX_TAGS` or
`MAX_ATTRIBUTES` (about 35,000 circles) is refused before it is parsed. A compressed file is refused while it is
decompressed. libxml2 counts lines exactly up to 65,535; a higher line number may be off by one. This module checks the
form of files itself, because libxml2's messages from RelaxNG name neither attribute nor value.

Tests: tests/io/test_state_xml.py, tests/io/test_segments_files.py
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
"""Largest size of a file that is read or written, bytes. For a compressed file it holds before and after
decompression."""

MAX_TAGS = 750_000
"""Largest number of '<' in a file. With `MAX_ATTRIBUTES` it limits the memory of the parsed tree to less than 1 GB."""

MAX_ATTRIBUTES = 1_500_000
"""Largest number of '=' in a file."""

_MAX_QUOTED = 80
INTEGER = re.compile(r"-?[0-9]{1,18}")
_NUMBER_TEXT = re.compile(r"[0-9.eE+\-]{1,1000}")
_NOT_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_ENCODING = re.compile(rb"\s*<\?xml[^>]*?\sencoding\s*=\s*[\"'](?!(?i:utf-?8|(?:us-)?ascii)[\"'])([^\"'>]*)")


class StateFileError(FileError):
    """Error: a file cannot be read, or a state cannot be stored. The message names file, line, element and value."""


def refuse_too_large(data: bytes) -> None:
    """Raise StateFileError if a file of these bytes exceeds the limits."""
    counts = {"bytes": len(data), "'<'": data.count(b"<"), "'='": data.count(b"=")}
    for (what, count), most in zip(counts.items(), (MAX_BYTES, MAX_TAGS, MAX_ATTRIBUTES)):
        if count > most:
            raise StateFileError(f"line 1: expected at most {most} {what}, got {count}: too large for a file")


def parse_tree(data: bytes):
    """Parse the bytes of a file. Returns the root element.

    The error messages of this function, and of the functions below, do not name the file.
    """
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
    # The encoding is fixed, so that no declaration can make the parser see a DOCTYPE where the search above saw none.
    # By default lxml loads no DTD, and refuses deep trees and long texts.
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
    """Return the error about an element. Its message names the line, and the body or contact to which the element
    belongs.
    """
    owner, got = "", "" if value is None else f", got {quote(value)}"
    for each in (element.getparent(), element):
        if each is not None and each.tag in ("body", "contact") and "index" in each.attrib:
            owner = f"{'' if each is element else f' of {each.tag}'} {quote(each.get('index'))}"
    return StateFileError(f"line {element.sourceline or 1}, <{element.tag[:_MAX_QUOTED]}>{owner}: {message}{got}")


def expect(condition, element, message: str, value=None) -> None:
    """Raise `fault(element, message, value)` unless the condition is true."""
    if not condition:
        raise fault(element, message, value)


def _fault_at(data: bytes, start: int, message: str, end: int | None = None) -> StateFileError:
    """Return the error about the bytes from `start` on.

    Its message names the line, and quotes the bytes up to `end`.
    """
    line = data.count(b"\n", 0, start) + 1
    return StateFileError(f"line {line}: {message}, got {quote(data[start:end])}")


def quote(value) -> str:
    """Return a text of a file in quotes, shortened to a length that a message can show."""
    if isinstance(value, bytes):
        value = value[: 4 * _MAX_QUOTED].decode("utf-8", "backslashreplace")
    return repr(value if len(value) <= _MAX_QUOTED else value[:_MAX_QUOTED] + "…")


# ---- reading: elements and attributes ----


def refuse_attributes(element, known) -> None:
    """Raise StateFileError for the first attribute of an element that is not in `known`."""
    for name in element.keys():  # not items(), which searches all attributes for every value
        if name not in known:
            message = f"{name[:_MAX_QUOTED]}: no such attribute, expected {', '.join(sorted(known))}"
            raise fault(element, message, element.get(name))


def refuse_attributes_of(parts: dict, tags: dict[str, str]) -> None:
    """Raise StateFileError for the first attribute that is not allowed for its element.

    parts: tag -> element, from `children`. tags: tag -> its attributes, such as "x y".
    """
    for tag, child in parts.items():
        refuse_attributes(child, tags[tag].split())


def children(element, tags) -> dict:
    """Return tag -> child of an element.

    Raises StateFileError for a tag that is not in `tags`, or that occurs twice.
    """
    parts = {}
    for child in element:
        if child.tag not in tags:
            raise fault(child, f"expected one of {', '.join(sorted(tags))}", child.tag)
        expect(child.tag not in parts, child, "expected this element once, got a second")
        parts[child.tag] = child
    return parts


def elements_of(container, tag: str, attributes=("count",)) -> list:
    """Return the children of a container, which all need to have one tag. Without a container there are none."""
    if container is None:
        return []
    refuse_attributes(container, attributes)
    count = container.get("count", str(len(container)))  # a claim of the file, which is checked
    expect(count == str(len(container)), container, f"count: expected {len(container)}, as there are", count)
    for child in container:
        expect(child.tag == tag, child, f"expected a <{tag}> here", child.tag)
    return list(container)


def by_index(elements) -> dict:
    """Return index -> element, by the attribute `index`. Raises StateFileError if an index occurs twice."""
    numbered = {}
    for element in elements:
        index = read_integer(element, "index")
        expect(index not in numbered, element, "index: expected each once, got a duplicate of", str(index))
        numbered[index] = element
    return numbered


class XmlRows:
    """Elements of one kind as rows, whose children are read column by column.

    tags: tag of a child -> its attributes, such as "x y". Other tags and attributes are refused.
    """

    def __init__(self, elements, tags: dict[str, str]):
        self.elements = list(elements)
        self.parts = [children(element, tags) for element in self.elements]
        for parts in self.parts:
            refuse_attributes_of(parts, tags)

    def texts(self, tag: str, name: str) -> list[str]:
        """Return one attribute of the child `tag` of every row, as texts."""
        for row, parts in zip(self.elements, self.parts):
            expect(tag in parts, row, f"element <{tag}> is missing")
        return [read_text(parts[tag], name) for parts in self.parts]

    def numbers(self, tag: str, names: str) -> np.ndarray:
        """Return attributes of the child `tag` as finite float64: (rows,) of one attribute, (rows, k) of several, such
        as "x y".
        """
        columns = []
        for name in names.split():
            columns.append(np.array([to_float(text) for text in self.texts(tag, name)], dtype=np.float64))
            self.refuse(~np.isfinite(columns[-1]), tag, name, "a finite number")
        return columns[0] if len(columns) == 1 else np.column_stack(columns)

    def refuse(self, bad: np.ndarray, tag: str, names: str, expected: str) -> None:
        """Raise StateFileError for the first row for which `bad` is true. The message quotes the attributes of its
        child `tag`.
        """
        if bad.any():
            element = self.parts[np.argmax(bad)][tag]
            got = ", ".join(element.get(name) for name in names.split())
            raise fault(element, f"{names}: expected {expected}", got)


def to_float(text: str) -> float:
    """Return the number in a text: NaN if the text is no number, infinity if the number overflows."""
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
    """Return a text in quotes, as an attribute has it. Raises ValueError, which names the attribute, if XML cannot
    store it.
    """
    if not isinstance(text, str) or _NOT_XML.search(text):
        raise ValueError(f"{name}: expected text without control characters, got {text!r}")
    return quoteattr(text)


def text_of(opening: str, children: dict[str, str], last: str = "") -> str:
    """Return the template (%-format) of an element: its opening tag, and its children with numbers as attributes.

    opening: tag and attributes of the element. children: tag -> attributes, such as "x y". last: a further line inside.
    """
    attributes = {tag: " ".join(f'{name}="%r"' for name in names.split()) for tag, names in children.items()}
    lines = [f"<{tag} {texts}/>" for tag, texts in attributes.items()] + ([last] if last else [])
    inner = "".join(f"      {line}\n" for line in lines)
    return f"    <{opening}>\n{inner}    </{opening.split()[0]}>\n"


def fill(template: str, rows: int, columns) -> str:
    """Return the template once for each row, filled with the row's values.

    One call for all rows, on Python numbers, makes writing fast. columns: values of each placeholder, (rows,) each.
    """
    lists = [column.tolist() if isinstance(column, np.ndarray) else column for column in columns]
    return template * rows % tuple(itertools.chain.from_iterable(zip(*lists)))
