"""A stream of XML documents: split by parsing, and written with every element.

Between documents, blanks, line ends and NUL bytes are skipped. A DTD, a processing instruction, deep nesting and
whatever is no XML end the stream; so does a document larger than the channel's buffer.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from xml.parsers import expat

import numpy as np

from experiments.virtual_controller.config import Config
from experiments.virtual_controller.errors import DocumentError

__all__ = ["Splitter", "Value", "Writer"]

Value = int | float | bool | str
MAX_DEPTH = 8  # levels of elements: no channel here has more than three
BYTES_AT_ONCE = 4096  # bytes given to the parser at once
SEPARATORS = b" \t\r\n\0"
MAX_NUMBER = 64  # characters of a value: longer ones are no number
INTEGERS = range(-(2**31), 2**31)


class Splitter:
    """Takes bytes as they come and gives whole documents: the values of the elements that the config names.

    Parameters
    ----------
    config
        The channel; elements that it does not name are skipped, as EthernetKRL does.
    """

    def __init__(self, config: Config) -> None:
        self._config = config
        self._types = {tag.path: tag.type for tag in config.receive}
        self._start()

    def feed(self, data: bytes) -> list[dict[str, Value]]:
        """Give the documents that are whole now.

        Raises
        ------
        DocumentError
            Something came that EthernetKRL would not take; ``whole`` has the documents before it.
        """
        whole: list[dict[str, Value]] = []
        try:
            for begin in range(0, len(data), BYTES_AT_ONCE):
                self._take(data[begin : begin + BYTES_AT_ONCE], whole)
        except DocumentError as error:
            error.whole = whole
            raise
        return whole

    def _start(self) -> None:
        """Wait for the first byte of a document."""
        self._parser: expat.XMLParserType | None = None
        self._bytes = 0  # of this document that the parser has
        self._path: list[str] = []
        self._texts: dict[str, str] = {}
        self._end: int | None = None  # where the root's closing tag begins, in bytes of this document
        self._empty = False  # the root was an empty tag, and ``_end`` is behind it

    def _take(self, piece: bytes, whole: list[dict[str, Value]]) -> None:
        rest = piece
        while rest:
            if self._parser is None:
                rest = rest.lstrip(SEPARATORS)
                if not rest:
                    return
                if not rest.startswith(b"<"):
                    raise DocumentError("no XML: a document begins with '<'")
                self._parser = self._new_parser()
            before = self._bytes
            self._bytes += len(rest)
            try:
                self._parser.Parse(rest, False)
            except expat.ExpatError as error:
                if self._end is None:  # else it is the next document, which is junk to this one's parser
                    raise DocumentError(f"no XML: {expat.errors.messages.get(error.code, error)}") from None
            if self._end is None and self._bytes <= self._config.buffer:
                return
            end = self._bytes if self._end is None else self._end - before
            if self._end is not None and not self._empty:
                end = rest.index(b">", max(end, 0)) + 1
            if before + end > self._config.buffer:
                raise DocumentError(f"a document beyond BUFFSIZE ({self._config.buffer} bytes)")
            whole.append(self._values())
            rest = rest[end:]
            self._start()

    def _new_parser(self) -> expat.XMLParserType:
        parser = expat.ParserCreate(encoding="UTF-8")
        if hasattr(parser, "SetReparseDeferralEnabled"):  # else the end of a document may wait for the next one
            parser.SetReparseDeferralEnabled(False)
        parser.StartElementHandler = self._open
        parser.EndElementHandler = self._close
        parser.CharacterDataHandler = self._text
        parser.StartDoctypeDeclHandler = _no_doctype
        parser.ProcessingInstructionHandler = _no_instruction
        return parser

    def _open(self, name: str, attributes: Mapping[str, str]) -> None:
        if self._end is not None:
            return
        if len(self._path) >= MAX_DEPTH:
            raise DocumentError(f"elements nested deeper than {MAX_DEPTH}")
        if not self._path and name != self._config.root:
            raise DocumentError(f"a document {name[:40]!r} where {self._config.root!r} was expected")
        self._path.append(name)
        path = "/".join(self._path)
        if path in self._types:
            self._texts.setdefault(path, "")
        for key, value in attributes.items():
            self._put(f"{path}/@{key}", value)

    def _close(self, name: str) -> None:
        self._path.pop()
        if not self._path and self._parser is not None:
            self._end = self._parser.CurrentByteIndex
            # Behind an empty tag, expat's place is behind it; of a closing tag it is where that begins.
            self._empty = not (self._parser.GetInputContext() or b"").startswith(b"</")

    def _text(self, text: str) -> None:
        self._put("/".join(self._path), text)

    def _put(self, path: str, text: str) -> None:
        if path not in self._types:
            return
        joined = self._texts.get(path, "") + text
        if len(joined) > MAX_NUMBER and self._types[path] != "STRING":
            raise DocumentError(f"{path}: a value of more than {MAX_NUMBER} characters")
        self._texts[path] = joined

    def _values(self) -> dict[str, Value]:
        return {path: _value(path, self._types[path], text) for path, text in self._texts.items()}


def _no_doctype(*_: object) -> None:
    raise DocumentError("a DOCTYPE, which could declare entities")


def _no_instruction(*_: object) -> None:
    raise DocumentError("a processing instruction")


def _value(path: str, kind: str, text: str) -> Value:
    """The value as KRL stores it; REAL is a four-byte float."""
    found = text.strip(" \t\r\n")
    try:
        if kind == "STRING":
            return found
        if "_" in found or not found.isascii():
            raise ValueError(found)
        if kind == "BOOL":
            return {"1": True, "0": False, "true": True, "false": False}[found.lower()]
        if kind == "INT":
            number = int(found)
            if number not in INTEGERS:
                raise ValueError(found)
            return number
        with np.errstate(over="ignore"):
            real = float(np.float32(float(found)))
        if not math.isfinite(real):
            raise ValueError(found)
        return real
    except (ValueError, KeyError):
        raise DocumentError(f"{path}: expected {kind}, found {found[:20]!r}") from None


class Writer:
    """Writes a channel's documents; made once, because answers are many.

    Parameters
    ----------
    paths
        Elements and attributes of one document, in order; those of one child stand together.
    """

    def __init__(self, paths: Sequence[str]) -> None:
        self._paths = tuple(paths)
        root = paths[0].partition("/")[0]
        parts, child, root_open = [f"<{root}"], "", True
        for path in paths:
            *above, last = path.split("/")[1:]
            parent = above[0] if above else ""
            if child and (parent != child or not last.startswith("@")):
                parts.append(f"></{child}>")
                child = ""
            if root_open and (parent or not last.startswith("@")):
                parts.append(">")
                root_open = False
            if not last.startswith("@"):
                parts.append(f"<{last}>%s</{last}>")
                continue
            if parent != child:
                parts.append(f"<{parent}")
                child = parent
            parts.append(f' {last[1:]}="%s"')
        parts.append(f"></{child}>" if child else ">" if root_open else "")
        parts.append(f"</{root}>")
        self._form = "".join(parts)

    def __call__(self, values: Mapping[str, Value]) -> bytes:
        """Write one document; ``values`` by path, numbers and truth values only."""
        return (self._form % tuple(_text(values[path]) for path in self._paths)).encode("ascii")


def _text(value: Value) -> str:
    if isinstance(value, bool):
        return "1" if value else "0"
    return f"{value:.9g}" if isinstance(value, float) else str(value)
