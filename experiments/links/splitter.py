"""Splits a stream of XML documents into single ones, with bounded memory.

EthernetKRL sends one root element after another: no prolog, no length, no terminator; blanks and NULs may stand
between them. Anything else a stream may hold (entities, declarations, comments, CDATA, processing instructions) is an
error, after which the connection is of no use.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence

from experiments.links.schema import Element

__all__ = ["MAX_DOCUMENT", "Splitter", "StreamError", "values_of"]

MAX_DOCUMENT = 65536  # bytes
MAX_DEPTH = 4
MAX_VALUES = 512  # attributes and texts of a document
SEPARATORS = b" \t\r\n\0"
_OPEN = re.compile(rb'<([A-Za-z_][\w.-]{0,63})((?:\s+[A-Za-z_][\w.-]{0,63}\s*=\s*"[^"<&]{0,256}")*)\s*(/?)>')
_CLOSING_TAG = re.compile(rb"</([A-Za-z_][\w.-]{0,63})\s*>")
_ATTRIBUTE = re.compile(rb'([A-Za-z_][\w.-]*)\s*=\s*"([^"]*)"')
MAX_INT = 2**31


class StreamError(ValueError):
    """What came is no stream of such documents."""


class Splitter:
    """One stream. After an error it must not be fed again."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        self._at = 0  # what stands before is read
        self._scanned = 0  # up to here there is no end of the tag that is open
        self._size = 0  # of the document that is read
        self._path: list[bytes] = []
        self._values: dict[str, str] = {}

    def feed(self, data: bytes) -> list[tuple[str, Mapping[str, str]]]:
        """Take a piece of the stream; give the documents that are whole now.

        Parameters
        ----------
        data
            Of any length.

        Returns
        -------
        list of tuple
            Root element, and texts by tag: ``Move/Axis/@A1``, ``Move/Id``.

        Raises
        ------
        StreamError
            Something else came, or a document is too long.
        """
        found: list[tuple[str, Mapping[str, str]]] = []
        self._buffer += data
        while True:
            start = self._buffer.find(b"<", max(self._at, self._scanned))
            if self._scanned > self._at:  # in the middle of a tag whose end had not come
                start = self._at
            elif start < 0:
                self._text(len(self._buffer), whole=False)
                break
            else:
                self._text(start, whole=True)
            end = self._buffer.find(b">", max(start, self._scanned))
            if end < 0:
                self._at, self._scanned = start, len(self._buffer)
                if len(self._buffer) - start + self._size > MAX_DOCUMENT:
                    raise StreamError(f"a document of more than {MAX_DOCUMENT} bytes")
                break
            self._tag(start, end + 1, found)
            self._at, self._scanned = end + 1, 0
        if self._at:
            del self._buffer[: self._at]
            self._scanned = max(self._scanned - self._at, 0)
            self._at = 0
        return found

    @property
    def between(self) -> bool:
        """Whether nothing is open: all that came were whole documents."""
        return not self._path and self._at == len(self._buffer)

    def _text(self, end: int, whole: bool) -> None:
        """What stands between tags, up to ``end``; not ``whole``: more of it may come."""
        text = bytes(self._buffer[self._at : end])
        inner = text.strip(SEPARATORS)
        if inner and not self._path:
            raise StreamError(f"expected <, found {inner[:20]!r}")
        if not self._path:
            self._at = end
            return
        if len(text) + self._size > MAX_DOCUMENT:
            raise StreamError(f"a document of more than {MAX_DOCUMENT} bytes")
        if b"&" in inner or b">" in inner:
            raise StreamError("expected plain text, found a reference or a stray >")
        if not whole:
            return
        self._size += len(text)
        self._at = end
        if inner:
            self._put("/".join(_name(part) for part in self._path), inner)

    def _tag(self, start: int, end: int, found: list[tuple[str, Mapping[str, str]]]) -> None:
        tag = bytes(self._buffer[start:end])
        self._size += len(tag)
        if self._size > MAX_DOCUMENT:
            raise StreamError(f"a document of more than {MAX_DOCUMENT} bytes")
        closing = _CLOSING_TAG.fullmatch(tag)
        if closing is None:
            opening = _OPEN.fullmatch(tag)
            if opening is None:
                raise StreamError(f"expected a tag, found {tag[:40]!r}")
            self._path.append(opening[1])
            if len(self._path) > MAX_DEPTH:
                raise StreamError(f"elements within elements, more than {MAX_DEPTH} deep")
            at = "/".join(_name(part) for part in self._path)
            for attribute in _ATTRIBUTE.finditer(opening[2]):
                self._put(f"{at}/@{_name(attribute[1])}", attribute[2])
            if not opening[3]:
                return
        elif not self._path or self._path[-1] != closing[1]:
            raise StreamError(f"expected an end of {(self._path or [b'nothing'])[-1]!r}, found {tag[:40]!r}")
        name = self._path.pop()
        if not self._path:
            found.append((_name(name), self._values))
            self._values, self._size = {}, 0

    def _put(self, tag: str, value: bytes) -> None:
        if tag in self._values:
            raise StreamError(f"{tag}: expected it once, found it twice")
        if len(self._values) >= MAX_VALUES:
            raise StreamError(f"more than {MAX_VALUES} values in a document")
        try:
            self._values[tag] = value.decode("ascii")
        except UnicodeDecodeError:
            raise StreamError(f"{tag}: expected ASCII, found {value[:20]!r}") from None


def values_of(elements: Sequence[Element], texts: Mapping[str, str]) -> dict[str, float]:
    """Read the values of a document; each of its elements has to be there.

    Parameters
    ----------
    elements
        Of the schema.
    texts
        Of :meth:`Splitter.feed`.

    Returns
    -------
    dict
        Numbers by tag; booleans are 0 or 1. What the schema does not have is left out.

    Raises
    ------
    StreamError
        One is missing, or is no number of its type.
    """
    out = {}
    for element in elements:
        text = texts.get(element.tag)
        if text is None:
            raise StreamError(f"{element.tag}: expected it in every document, found none")
        out[element.tag] = _number(element, text)
    return out


def _number(element: Element, text: str) -> float:
    if element.type == "BOOL":
        flag = {"0": 0, "1": 1, "FALSE": 0, "TRUE": 1}.get(text.strip().upper())
        if flag is not None:
            return flag
    elif len(text) <= 32 and "_" not in text:
        try:
            value = int(text) if element.type == "INT" else float(text)
        except ValueError:
            value = math.nan
        if math.isfinite(value) and abs(value) < (MAX_INT if element.type == "INT" else 1e9):
            return value
    raise StreamError(f"{element.tag}: expected {element.type}, found {text[:40]!r}")


def _name(name: bytes) -> str:
    return name.decode("ascii")
