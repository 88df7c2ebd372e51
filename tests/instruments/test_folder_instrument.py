"""An instrument behind a folder: half-written files, old ones, wrong ones."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from experiments.instruments import (
    InstrumentError,
    InstrumentSilentError,
    LineOfSightError,
    NotStillError,
    connect_instrument,
)
from experiments.instruments import folder as folder_module
from experiments.instruments.folder import FolderInstrument

HEADER = "x,y,z\n"


@pytest.fixture(autouse=True)
def _short_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(folder_module, "QUIET", 0.06)
    monkeypatch.setattr(folder_module, "UNENDED", 0.4)
    monkeypatch.setattr(folder_module, "POLL", 0.01)


@contextmanager
def meanwhile(work: Callable[[], None], after: float = 0.05) -> Iterator[None]:
    """Do something in a thread, a while after the measurement was asked for."""
    timer = threading.Timer(after, work)
    timer.start()
    try:
        yield
    finally:
        timer.join()


def rows(count: int, x: float = 1.0, drift: float = 0.0) -> str:
    """Rows in metres with 10 µm of noise."""
    rng = np.random.default_rng(0)
    found = np.array([x, 2.0, 3.0]) + rng.normal(0, 1e-5, (count, 3))
    found[:, 0] += drift * np.linspace(0, 1, count)
    return "".join(f"{a:.7f},{b:.7f},{c:.7f}\n" for a, b, c in found)


def test_a_new_file_is_a_measurement(tmp_path: Path) -> None:
    instrument = connect_instrument(f"folder:{tmp_path}")
    with meanwhile(lambda: _write(tmp_path / "m1.csv", HEADER + rows(200))):
        sample = instrument.measure("T1", 10, 5.0)
    assert sample.count == 200
    assert sample.point_m == pytest.approx([1, 2, 3], abs=1e-5)
    assert sample.std_m == pytest.approx([1e-5] * 3, rel=0.3)


def test_files_of_before_are_put_aside_and_none_is_read_twice(tmp_path: Path) -> None:
    (tmp_path / "old.csv").write_text(HEADER + rows(200, 5.0))
    instrument = FolderInstrument(tmp_path)
    (tmp_path / "unasked.csv").write_text(HEADER + rows(200, 6.0))
    with meanwhile(lambda: _write(tmp_path / "m1.csv", HEADER + rows(200, 1.0))):
        assert instrument.measure("T1", 10, 5.0).point_m[0] == pytest.approx(1.0, abs=1e-4)
    assert instrument.stray == ["unasked.csv"]
    with pytest.raises(InstrumentSilentError, match=r"no new file \*.csv within 0.2 s"):
        instrument.measure("T1", 10, 0.2)


def test_a_half_written_file_is_waited_for(tmp_path: Path) -> None:
    text = HEADER + rows(200)

    def slowly() -> None:
        with (tmp_path / "m1.csv").open("w") as stream:
            for k in range(0, len(text), 1500):
                stream.write(text[k : k + 1500])
                stream.flush()
                time.sleep(0.1)  # longer than QUIET: the last line is what tells

    with meanwhile(slowly):
        assert connect_instrument(f"folder:{tmp_path}").measure("T1", 10, 10.0).count == 200


def test_a_last_line_without_its_end(tmp_path: Path) -> None:
    instrument = connect_instrument(f"folder:{tmp_path}")
    with meanwhile(lambda: _write(tmp_path / "m1.csv", HEADER + "1,2,3\n1,2,3")):
        sample = instrument.measure("T1", 10, 5.0)
    assert sample.count == 2


def test_a_file_that_stays_half_is_named(tmp_path: Path) -> None:
    instrument = connect_instrument(f"folder:{tmp_path}")
    with (
        meanwhile(lambda: _write(tmp_path / "m1.csv", HEADER + "1,2")),
        pytest.raises(InstrumentSilentError, match=r"m1.csv is not complete"),
    ):
        instrument.measure("T1", 10, 0.25)


def test_a_file_that_grows_is_named(tmp_path: Path) -> None:
    log = tmp_path / "all.csv"
    log.write_text(HEADER)
    instrument = connect_instrument(f"folder:{tmp_path}")
    with (
        meanwhile(lambda: _write(log, HEADER + rows(3))),
        pytest.raises(InstrumentSilentError, match=r"all.csv grew, expected a file for each measurement"),
    ):
        instrument.measure("T1", 10, 0.3)


def test_columns_units_targets_and_temperatures(tmp_path: Path) -> None:
    instrument = connect_instrument(
        f"folder:{tmp_path}?columns=X mm,Y mm,Z mm&unit=mm&targets=T1,T2&target=Name&temperatures=ambient:Air"
        "&separator=;&decimal=,&files=*.txt"
    )
    text = "Name;X mm;Y mm;Z mm;Air\nT1;1000,5;2;3;20,5\nT2;2000;2;3;20,7\nT2;2000,2;2;3;20,7\nT2;;;;\n"
    with meanwhile(lambda: _write(tmp_path / "m1.txt", text)):
        sample = instrument.measure("T2", 10, 5.0)
    assert sample.point_m == pytest.approx([2.0001, 0.002, 0.003])
    assert sample.count == 2
    assert instrument.temperatures() == {"ambient": 20.7}


def test_a_distance_and_a_single_reading(tmp_path: Path) -> None:
    instrument = connect_instrument(f"folder:{tmp_path}?columns=d&unit=mm")
    with meanwhile(lambda: _write(tmp_path / "m1.csv", "d,time\n1250.25,1\n")):
        sample = instrument.measure("T1", 10, 5.0)
    assert sample.point_m[0] == pytest.approx(1.25025)
    assert np.isnan(sample.point_m[1:]).all()
    assert np.isnan(sample.std_m).all()  # nothing is known of the scatter of one


def test_an_unseen_target_is_waited_for(tmp_path: Path) -> None:
    instrument = connect_instrument(f"folder:{tmp_path}")

    def twice() -> None:
        _write(tmp_path / "m1.csv", HEADER + "nan,nan,nan\n,,\n")
        time.sleep(0.2)
        _write(tmp_path / "m2.csv", HEADER + "1,2,3\n")

    with meanwhile(twice):
        assert instrument.measure("T1", 10, 5.0).count == 1
    with (
        meanwhile(lambda: _write(tmp_path / "m3.csv", HEADER + "-,-,-\n")),
        pytest.raises(LineOfSightError, match=r"m3.csv: no reading of T1 in 1 rows"),
    ):
        instrument.measure("T1", 10, 0.5)


def test_readings_of_a_moving_target_are_refused(tmp_path: Path) -> None:
    instrument = connect_instrument(f"folder:{tmp_path}")
    with (
        meanwhile(lambda: _write(tmp_path / "m1.csv", HEADER + rows(200, drift=1e-3))),
        pytest.raises(NotStillError, match=r"moved by (4|5)\d\d µm"),
    ):
        instrument.measure("T1", 10, 0.5)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", None),
        (b"\n\n", "found an empty file"),
        (b"a,b,c\n1,2,3\n", "row 1: expected one column 'x', found a, b, c"),
        (b"x,y,z,x\n1,2,3,4\n", "expected one column 'x', found two of them"),
        (b"x,y,z\n1,2\n", "row 2: expected 3 cells, found 2"),
        (b"x,y,z\n1,2,here\n", "row 2, column z: expected a number, found 'here'"),
        (b"x,y,z\n1,2,inf\n", "row 2, column z: expected a number, found 'inf'"),
        (b"x,y,z\n1,2,3000\n", "is it the right unit"),
        (b"x,y,z\n1,2,\xff\n", "expected UTF-8"),
        (b"x,y,z\n", "no row of T1"),
    ],
)
def test_wrong_files_are_named(tmp_path: Path, content: bytes, said: str | None) -> None:
    instrument = connect_instrument(f"folder:{tmp_path}")
    with meanwhile(lambda: _write(tmp_path / "m1.csv", content)), pytest.raises(InstrumentError) as error:
        instrument.measure("T1", 10, 0.6)
    assert (said or "is not complete") in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("query", "said"),
    [
        ("unit=inch", "unit: expected m, mm, um"),
        ("colums=x", "expected keys columns"),
        ("columns=x,y", "one or three names"),
        ("columns=x,x,z", "one or three names"),
        ("decimal=,", "that differ"),
        ("separator=;;", "separator of one character"),
        ("targets=T1,T1", "different names"),
        ("targets=", "different names"),
        ("files=../*.csv", "a pattern of names"),
        ("temperatures=air", "sensor:column"),
        ("unit=m&unit=mm", "unit twice"),
        ("unit", "key=value"),
    ],
)
def test_wrong_keys_are_named(tmp_path: Path, query: str, said: str) -> None:
    with pytest.raises(InstrumentError) as error:
        connect_instrument(f"folder:{tmp_path}?{query}")
    assert said in str(error.value)


def test_no_such_folder(tmp_path: Path) -> None:
    with pytest.raises(InstrumentError, match="found no such one"):
        connect_instrument(f"folder:{tmp_path}/nowhere")


def _write(path: Path, content: str | bytes) -> None:
    data = content.encode() if isinstance(content, str) else content
    descriptor = os.open(path, os.O_CREAT | os.O_WRONLY | os.O_TRUNC)
    os.write(descriptor, data)
    os.close(descriptor)
