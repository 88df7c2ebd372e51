"""The wire of KUKAVARPROXY: one variable a question, big-endian, answered in order.

::

    question  u16 id, u16 length, u8 mode (0 read, 1 write), u16 n, name[n] [, u16 m, value[m]]
    answer    u16 id, u16 length, u8 mode, u16 m, value[m], 00 01 01 (good) or 00 00 00
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

__all__ = ["Answer", "Answers", "Question", "question_bytes"]

HEAD = struct.Struct(">HH")
LONGEST_MESSAGE = 4096  # bytes of a message


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


class Answers:
    """What a client reads, in whatever pieces it comes; after an error it must not be fed again."""

    def __init__(self) -> None:
        self._buffer = b""

    def feed(self, data: bytes) -> list[Answer]:
        """Take a piece; give the answers that are whole.

        Raises
        ------
        ValueError
            It is no such stream.
        """
        out = []
        for number, body in self._bodies(data):
            (length,) = struct.unpack_from(">H", body, 1)
            if len(body) < 3 + length:
                raise ValueError("variable proxy: expected a value, found fewer bytes than it says")
            good = body[3 + length :][-1:] == b"\x01"
            out.append(Answer(number, body[3 : 3 + length].decode("utf-8", "replace") if good else None))
        return out

    def _bodies(self, data: bytes) -> list[tuple[int, bytes]]:
        self._buffer += data
        found = []
        while len(self._buffer) >= HEAD.size:
            number, length = HEAD.unpack_from(self._buffer)
            if not 3 <= length <= LONGEST_MESSAGE:
                raise ValueError(f"variable proxy: expected a message of 3 to {LONGEST_MESSAGE} bytes, found {length}")
            if len(self._buffer) < HEAD.size + length:
                break
            found.append((number, self._buffer[HEAD.size : HEAD.size + length]))
            self._buffer = self._buffer[HEAD.size + length :]
        return found
