"""The stream of documents: any pieces, nothing hostile, bounded memory."""

from __future__ import annotations

import itertools
import random
import tracemalloc
from collections.abc import Iterable

import pytest

from experiments.links.rsi import cycle_of
from experiments.links.schema import MOTION, STATE, document
from experiments.links.splitter import MAX_DOCUMENT, Splitter, StreamError, values_of

MOVE = document(MOTION.receive, {e.tag: k + 1 for k, e in enumerate(MOTION.receive)})
ROBOT = document(STATE.send, {e.tag: 1 for e in STATE.send})
ROB = (
    b'<Rob Type="KUKA"><AIPos A1="1.0" A2="-90.0" A3="90.0" A4="0" A5="0" A6="0"/>'
    b'<Delay D="0"></Delay><IPOC>4208163634</IPOC></Rob>'
)


@pytest.mark.parametrize("between", [b"", b"\n", b"\0", b" \r\n\0\0\t"])
def test_a_stream_may_be_cut_anywhere_and_coalesced(between: bytes) -> None:
    stream = between + MOVE + between + MOVE
    (one,) = Splitter().feed(MOVE)
    for cut in range(len(stream) + 1):
        splitter = Splitter()
        assert [*splitter.feed(stream[:cut]), *splitter.feed(stream[cut:])] == [one, one]
    splitter = Splitter()
    assert [found for byte in stream for found in splitter.feed(bytes([byte]))] == [one, one]
    assert splitter.between


def test_every_value_of_a_document_comes_back() -> None:
    for elements, data in ((MOTION.receive, MOVE), (STATE.send, ROBOT)):
        ((root, texts),) = Splitter().feed(data)
        assert root == elements[0].root
        assert set(texts) == {e.tag for e in elements}
        assert document(elements, values_of(elements, texts)) == data


def test_a_float_survives_as_the_controller_stores_it() -> None:
    import numpy as np

    for value in np.float32([185.00001, -89.123456, 1e-7, 350.0]):
        data = document(MOTION.receive, {e.tag: float(value) if e.type == "REAL" else 1 for e in MOTION.receive})
        ((_, texts),) = Splitter().feed(data)
        assert np.float32(values_of(MOTION.receive, texts)["Move/Axis/@A3"]) == value


HOSTILE = [
    b"rubbish",
    b'<?xml version="1.0"?>' + MOVE,
    b'<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>',
    b"<Move>&amp;</Move>",
    b'<Move a="&#65;"/>',
    b"<!-- x --><Move/>",
    b"<Move><![CDATA[x]]></Move>",
    b"<a><b><c><d><e/></d></c></b></a>",
    b"<a></b>",
    b"</a>",
    b"<a x='1'/>",
    b'<a x="1" x="2"/>',
    b"<a><b>1</b><b>2</b></a>",
    b"<a>\xff</a>",
    b'<a x="<"/>',
    b"<a>1>2</a>",
    b"< a/>",
    b"<" + b"a" * 100 + b"/>",
    b'<a x="' + b"1" * 300 + b'"/>',
    b"<a>" + b"".join(b"<b%d>1</b%d>" % (k, k) for k in range(600)) + b"</a>",
    b"<a>" + b" " * (MAX_DOCUMENT + 10) + b"</a>",
    b"<" + b"a" * (MAX_DOCUMENT + 10),
]


def fed(pieces: Iterable[bytes]) -> None:
    splitter = Splitter()
    for piece in pieces:
        splitter.feed(piece)


@pytest.mark.parametrize("data", HOSTILE, ids=range(len(HOSTILE)))
@pytest.mark.parametrize("piece", [1_000_000, 1000])
def test_what_is_no_such_stream_is_an_error(data: bytes, piece: int) -> None:
    with pytest.raises(StreamError):
        fed(data[k : k + piece] for k in range(0, len(data), piece))


@pytest.mark.parametrize("text", ["", "x", "nan", "inf", "1e400", "1_0", "0x1", "1" * 40, "2147483648", "1.5"])
def test_a_number_of_another_kind_is_an_error(text: str) -> None:
    ((_, texts),) = Splitter().feed(MOVE)
    with pytest.raises(StreamError, match="Move/Id: expected INT"):
        values_of(MOTION.receive, {**texts, "Move/Id": text})


def test_a_missing_element_is_an_error_and_another_one_is_not() -> None:
    ((_, texts),) = Splitter().feed(MOVE)
    assert values_of(MOTION.receive, {**texts, "Move/New": "x"})["Move/Id"] == 2
    with pytest.raises(StreamError, match="Move/Id: expected it in every document"):
        values_of(MOTION.receive, {k: v for k, v in texts.items() if k != "Move/Id"})


@pytest.mark.parametrize("text", ["0", "1", "TRUE", "false"])
def test_booleans_in_both_spellings(text: str) -> None:
    ((_, texts),) = Splitter().feed(ROBOT)
    found = values_of(STATE.send, {**texts, "Robot/State/@Stopped": text})
    assert found["Robot/State/@Stopped"] == (text in ("1", "TRUE"))


def spoilt(rng: random.Random, data: bytes) -> bytes:
    """A document with something wrong, or with nothing wrong at all."""
    out = bytearray(data)
    for _ in range(rng.randrange(1, 5)):
        kind, at = rng.randrange(6), rng.randrange(len(out) + 1)
        if kind == 0:
            del out[at:]
        elif kind == 1:
            out[at:at] = rng.randbytes(rng.randrange(1, 20))
        elif kind == 2 and out:
            out[at % len(out)] = rng.randrange(256)
        elif kind == 3:
            out[at:at] = out[: rng.randrange(len(out) + 1)]
        elif kind == 4:
            out[at:at] = rng.choice([b"<a>" * 50, b"&lt;", b"<!ENTITY a 'b'>", b"\0" * 100, b'"', b">", b"</Move>"])
        else:
            del out[at : at + rng.randrange(1, 10)]
        if not out:
            break
    return bytes(out)


def hostile_messages(count: int) -> None:
    """So many spoilt messages, each to a stream and to a datagram's reader: errors, or documents; nothing else."""
    rng, good, bad = random.Random(27), 0, 0
    tracemalloc.start()
    try:
        for k in range(count):
            data = spoilt(rng, (MOVE, ROB)[k % 2])
            splitter = Splitter()
            piece = 1 + rng.randrange(200)
            try:
                for at in range(0, len(data), piece):
                    good += len(splitter.feed(data[at : at + piece]))
            except StreamError:
                bad += 1
            try:
                cycle_of(data)
                good += 1
            except StreamError:
                bad += 1
            assert len(splitter._buffer) <= len(data)
        assert tracemalloc.get_traced_memory()[1] < 2_000_000
    finally:
        tracemalloc.stop()
    assert good > count / 100
    assert bad > count


def test_4000_hostile_messages() -> None:
    hostile_messages(4000)


@pytest.mark.study
def test_100000_hostile_messages() -> None:
    hostile_messages(100_000)


def test_a_sender_that_never_ends_a_document_is_cut_off_with_bounded_memory() -> None:
    for piece in (b"<a>", b" " * 10, b'<b x="'):
        tracemalloc.start()
        try:
            with pytest.raises(StreamError):
                fed(itertools.repeat(b"<a>" + piece if piece == b" " * 10 else piece, 10 * MAX_DOCUMENT))
            assert tracemalloc.get_traced_memory()[1] < 4 * MAX_DOCUMENT + 100_000
        finally:
            tracemalloc.stop()


def test_blanks_between_documents_take_no_memory() -> None:
    splitter = Splitter()
    for _ in range(1000):
        assert splitter.feed(b"\0 \n" * 1000) == []
    assert len(splitter._buffer) == 0
    assert len(splitter.feed(MOVE)) == 1
