"""The wire of KUKAVARPROXY: one variable a question, big-endian, answered in order.

::

    question  u16 id, u16 length, u8 mode (0 read, 1 write), u16 n, name[n] [, u16 m, value[m]]
    answer    u16 id, u16 length, u8 mode, u16 m, value[m], 00 01 01 (good) or 00 00 00
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

__all__ = ["Answer", "Answers", "Question", "Questions", "answer_bytes", "question_bytes"]

HEAD = struct.Struct(">HH")
GOOD, BAD = b"\x00\x01\x01", b"\x00\x00\x00"
LONGEST = 4096  # bytes of a message
LONGEST_NAME = 256


@dataclass(frozen=True)
class Question:
    """One variable to be read, or written where there is a value."""

    number: int
    name: str
    value: str | None = None


@dataclass(frozen=True)
class Answer:
    """What came of it; None: the variable is not there, or could not be written."""

    number: int
    value: str | None


def question_bytes(question: Question) -> bytes:
    """Write a question."""
    name = question.name.encode()
    body = struct.pack(">BH", question.value is not None, len(name)) + name
    if question.value is not None:
        value = question.value.encode()
        body += struct.pack(">H", len(value)) + value
    return HEAD.pack(question.number, len(body)) + body


def answer_bytes(number: int, written: bool, value: str | None) -> bytes:
    """Write an answer; None as value: there is none."""
    text = (value or "").encode()
    body = struct.pack(">BH", written, len(text)) + text + (BAD if value is None else GOOD)
    return HEAD.pack(number, len(body)) + body


class _Stream:
    """Messages of a stream, whatever pieces it comes in; after an error it must not be fed again."""

    def __init__(self) -> None:
        self._buffer = b""

    def _bodies(self, data: bytes) -> list[tuple[int, bytes]]:
        self._buffer += data
        found = []
        while len(self._buffer) >= HEAD.size:
            number, length = HEAD.unpack_from(self._buffer)
            if not 3 <= length <= LONGEST:
                raise ValueError(f"variable proxy: expected a message of 3 to {LONGEST} bytes, found {length}")
            if len(self._buffer) < HEAD.size + length:
                break
            found.append((number, self._buffer[HEAD.size : HEAD.size + length]))
            self._buffer = self._buffer[HEAD.size + length :]
        return found


class Questions(_Stream):
    """What a server reads."""

    def feed(self, data: bytes) -> list[Question]:
        """Take a piece; give the questions that are whole.

        Raises
        ------
        ValueError
            It is no such stream.
        """
        return [_question(number, body) for number, body in self._bodies(data)]


class Answers(_Stream):
    """What a client reads."""

    def feed(self, data: bytes) -> list[Answer]:
        """Take a piece; give the answers that are whole; as `Questions.feed`."""
        out = []
        for number, body in self._bodies(data):
            (length,) = struct.unpack_from(">H", body, 1)
            if len(body) < 3 + length:
                raise ValueError("variable proxy: expected a value, found fewer bytes than it says")
            good = body[3 + length :][-1:] == b"\x01"
            out.append(Answer(number, body[3 : 3 + length].decode("utf-8", "replace") if good else None))
        return out


def _question(number: int, body: bytes) -> Question:
    mode, length = struct.unpack_from(">BH", body)
    name, rest = body[3 : 3 + length], body[3 + length :]
    if mode not in (0, 1) or not 0 < length <= LONGEST_NAME or len(name) < length:
        raise ValueError(f"variable proxy: expected a variable to read or write, found {body[:40]!r}")
    try:
        text = name.decode()
        if mode == 0:
            return Question(number, text)
        if len(rest) < 2 or len(rest) < 2 + struct.unpack_from(">H", rest)[0]:
            raise ValueError("variable proxy: expected a value to write, found fewer bytes than it says")
        return Question(number, text, rest[2 : 2 + struct.unpack_from(">H", rest)[0]].decode())
    except UnicodeDecodeError:
        raise ValueError(f"variable proxy: expected UTF-8, found {body[:40]!r}") from None
