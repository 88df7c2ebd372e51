"""The journal: whatever a cut leaves, whole lines stay and nothing comes twice."""

from __future__ import annotations

import json
import random
import zlib
from pathlib import Path

import pytest

from experiments.plans import PlanError
from experiments.runs.journal import Journal, line_of, whole_lines


def written(path: Path, count: int) -> list[dict]:
    with Journal(path) as journal:
        return [journal.add("row", key=["poses", k], row={"x_m": k / 3}) for k in range(count)]


def test_cut_at_200_random_bytes_it_loses_the_broken_line_only(tmp_path: Path) -> None:
    entries = written(tmp_path / "j", 40)
    data = (tmp_path / "j").read_bytes()
    ends = [sum(len(line) for line in data.splitlines(True)[: k + 1]) for k in range(40)]
    rng = random.Random(1)
    for cut in [0, len(data), *(rng.randrange(len(data)) for _ in range(200))]:
        whole = sum(end <= cut for end in ends)
        assert whole_lines(data[:cut]) == (entries[:whole], ends[whole - 1] if whole else 0)
        if rng.random() > 0.1:
            continue  # the disk is slow
        copy = tmp_path / "cut"
        copy.write_bytes(data[:cut])
        with Journal(copy) as journal:
            assert journal.entries == entries[:whole]
            again = journal.add("row", key=["poses", whole])
        with Journal(copy) as journal:
            assert journal.entries == [*entries[:whole], again]
            assert not journal.dropped


@pytest.mark.parametrize("tail", [b"\0" * 4096, b"0000", b"00000000 {}\n", b"garbage\n", b'{"what":"row"}\n'])
def test_what_a_power_cut_leaves_is_dropped(tmp_path: Path, tail: bytes) -> None:
    entries = written(tmp_path / "j", 3)
    with (tmp_path / "j").open("ab") as file:
        file.write(tail)
    with Journal(tmp_path / "j") as journal:
        assert journal.entries == entries
        assert journal.dropped == len(tail)


def test_damage_in_the_middle_is_said_and_nothing_is_cut_off(tmp_path: Path) -> None:
    written(tmp_path / "j", 5)
    data = bytearray((tmp_path / "j").read_bytes())
    data[len(data) // 2] ^= 1
    (tmp_path / "j").write_bytes(data)
    with pytest.raises(PlanError, match="line 3 damaged with whole ones after it"):
        Journal(tmp_path / "j")
    assert (tmp_path / "j").read_bytes() == data


def test_one_process_at_a_time(tmp_path: Path) -> None:
    with Journal(tmp_path / "j"), pytest.raises(PlanError, match="no other run"):
        Journal(tmp_path / "j")
    Journal(tmp_path / "j").close()


def test_a_line_is_found_by_its_checksum() -> None:
    line = line_of({"what": "row", "x": 1.5})
    assert json.loads(line[9:]) == {"what": "row", "x": 1.5}
    assert whole_lines(line + line)[1] == 2 * len(line)
    for k in range(len(line)):
        assert whole_lines(line[:k] + bytes([line[k] ^ 1]) + line[k + 1 :]) == ([], 0)


def signed(text: bytes) -> bytes:
    """A line whose checksum is right, whatever its text is."""
    return b"%08x %s\n" % (zlib.crc32(text), text)


@pytest.mark.parametrize(
    "text",
    [b"[" * 200_000, b"{", b"9" * 6000, b'{"a":"\xff"}', b"[1]", b'{"a":NaN}'],
    ids=["deep", "no JSON", "digits", "no ASCII", "a list", "no number"],
)
def test_a_line_that_only_its_checksum_vouches_for_is_none(tmp_path: Path, text: bytes) -> None:
    entries = written(tmp_path / "j", 2)
    with (tmp_path / "j").open("ab") as file:
        file.write(signed(text))
    with Journal(tmp_path / "j") as journal:
        assert journal.entries == entries


def test_a_file_that_is_no_journal_is_not_cut_off(tmp_path: Path) -> None:
    (tmp_path / "j").write_text("my notes\nof the day\n")
    with pytest.raises(PlanError, match="more than the last one damaged"):
        Journal(tmp_path / "j")
    assert (tmp_path / "j").read_text() == "my notes\nof the day\n"


def test_a_device_is_no_journal(tmp_path: Path) -> None:
    (tmp_path / "j").symlink_to("/dev/null")
    with pytest.raises(PlanError, match="expected a regular file"):
        Journal(tmp_path / "j")


def test_hours_of_swings_do_not_fill_the_memory(tmp_path: Path) -> None:
    """Of motions that follow each other the last one is remembered; on the disk are all, and rows stay."""
    with Journal(tmp_path / "journal.jsonl") as journal:
        for number in range(300):
            for what in ("move", "sent", "moved"):
                journal.add(what, step=f"swing {number}")
            if number == 99:
                journal.add("row", table="poses", key=["poses", 1, 1, "T1"], row={})
        assert [e["what"] for e in journal.entries] == ["move", "sent", "moved", "row", "move", "sent", "moved"]
        assert journal.entries[-1]["step"] == "swing 299"
    assert len(whole_lines((tmp_path / "journal.jsonl").read_bytes())[0]) == 901
    with Journal(tmp_path / "journal.jsonl") as again:
        assert len(again.entries) == 7
