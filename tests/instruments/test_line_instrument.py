"""An instrument on a socket: still, moving, unseen, silent, talking nonsense."""

from __future__ import annotations

import time

import numpy as np
import pytest
from fake_instrument import connected, line, points, serving, usual

from experiments.instruments import (
    InstrumentError,
    InstrumentSilentError,
    LineOfSightError,
    NotStillError,
    connect_instrument,
)
from experiments.instruments import line as line_module
from experiments.instruments.still import MIN_READINGS

LOST = line({"error": "line of sight lost"})


@pytest.fixture(autouse=True)
def _short_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(line_module, "PAUSE_BETWEEN_TRIALS", 0.02)


def test_median_and_scatter_of_one_reading() -> None:
    with connected(usual) as instrument:
        sample = instrument.measure("T1", 500, 2.0)
        assert instrument.targets == ("T1", "T2")
        assert instrument.temperatures() == {"motor1": 30.5, "motor2": 31.0, "ambient": 21.25}
    assert sample.count == 500
    assert sample.time_s == 7.25
    assert np.abs(sample.point_m - [1, 2, 3]).max() < 5 * 1.25 * 2e-5 / np.sqrt(500)
    assert np.all(np.abs(sample.std_m / 2e-5 - 1) < 0.2)


def test_few_readings_are_made_enough_to_tell_motion() -> None:
    with connected(usual) as instrument:
        assert instrument.measure("T1", 5, 2.0).count == MIN_READINGS


def test_a_distance_has_one_axis() -> None:
    with connected(lambda text, _: points(int(text.split()[1]), middle=(1.5,))) as instrument:
        sample = instrument.measure("T1", 200, 2.0)
    assert sample.point_m[0] == pytest.approx(1.5, abs=1e-5)
    assert np.isnan(sample.point_m[1:]).all()
    assert np.isnan(sample.std_m[1:]).all()


def test_waits_until_the_target_is_still() -> None:
    with connected(lambda text, k: points(200, drift=1e-3 if k < 3 else 0.0, seed=k)) as instrument:
        sample = instrument.measure("T1", 200, 5.0)
    assert sample.point_m[0] == pytest.approx(1.0, abs=2e-5)


def test_a_target_that_never_rests_is_named_with_its_motion() -> None:
    def slow(_text: str, k: int) -> bytes:
        time.sleep(0.05)
        return points(200, drift=1e-3, seed=k)

    with connected(slow) as instrument, pytest.raises(NotStillError, match=r"T1 still moved by (4|5)\d\d µm"):
        instrument.measure("T1", 200, 0.4)


def test_line_of_sight_is_looked_for_again() -> None:
    with connected(lambda text, k: LOST if k < 2 else points(200)) as instrument:
        assert instrument.measure("T1", 200, 5.0).count == 200


def test_line_of_sight_lost_for_good() -> None:
    asked = []

    def blind(text: str, _k: int) -> bytes:
        asked.append(text)
        return LOST

    with connected(blind) as instrument, pytest.raises(LineOfSightError, match="line of sight lost"):
        instrument.measure("T1", 200, 5.0)
    assert len(asked) == line_module.AGAIN


@pytest.mark.parametrize("said", [None, b'{"points_m": [[1.0, 2.0', b""], ids=["silence", "half a line", "nothing"])
def test_silence_ends_in_time(said: bytes | None) -> None:
    with connected(lambda *_: said) as instrument:
        begin = time.monotonic()
        with pytest.raises(InstrumentSilentError, match="nothing came"):
            instrument.measure("T1", 200, 0.3)
        assert 0.25 < time.monotonic() - begin < 1.0


def test_a_late_answer_is_not_taken_for_the_next_one() -> None:
    def late(_text: str, k: int) -> bytes:
        if k == 0:
            time.sleep(0.4)
            return points(200, middle=(9.0, 9.0, 9.0))
        return points(200)

    with connected(late) as instrument:
        with pytest.raises(InstrumentSilentError):
            instrument.measure("T1", 200, 0.2)
        time.sleep(0.4)
        assert instrument.measure("T1", 200, 2.0).point_m[0] == pytest.approx(1.0, abs=1e-4)


def test_a_broken_connection_is_made_anew() -> None:
    with connected(lambda text, k: b"HANG UP" if k == 0 else points(200)) as instrument:
        with pytest.raises(InstrumentSilentError, match="hung up"):
            instrument.measure("T1", 200, 2.0)
        assert instrument.measure("T1", 200, 2.0).count == 200


def test_an_answer_too_many_is_refused() -> None:
    with connected(lambda text, k: points(200) * (2 if k == 0 else 1)) as instrument:
        instrument.measure("T1", 200, 2.0)
        with pytest.raises(InstrumentError, match="found more"):
            instrument.measure("T1", 200, 2.0)
        assert instrument.measure("T1", 200, 2.0).count == 200


GOOD = {"target": "T1", "time_s": 1.0, "points_m": [[1.0, 2.0, 3.0]] * 200}


@pytest.mark.parametrize(
    "said",
    [
        b"\xff\xfe\x00\n",
        b"GET / HTTP/1.1\r\n\r\n",
        b"\n",
        b"[1, 2]\n",
        b"[" * 100_000 + b"\n",
        line(GOOD | {"target": "T2"}),
        line(GOOD | {"points_m": []}),
        line(GOOD | {"points_m": [[1.0, 2.0]] * 200}),
        line(GOOD | {"points_m": [[1.0, 2.0, "far"]]}),
        line(GOOD | {"points_m": [[1.0, 2.0, float("nan")]]}),
        line(GOOD | {"points_m": [[1000.5, 2.0, 3.0]] * 200}),
        line(GOOD | {"points_m": GOOD["points_m"] * 2}),  # type: ignore[operator]
        line(GOOD | {"points_m": None}),
        line(GOOD | {"time_s": True}),
        line({k: v for k, v in GOOD.items() if k != "time_s"}),
        line({"error": "laser is off"}),
    ],
)
def test_nonsense_is_refused_in_one_line(said: bytes) -> None:
    with connected(lambda *_: said) as instrument, pytest.raises(InstrumentError) as error:
        instrument.measure("T1", 200, 2.0)
    assert not isinstance(error.value, InstrumentSilentError | LineOfSightError)
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 250


def test_an_endless_line_is_cut(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(line_module, "LONGEST_ANSWER", 100_000)
    with (
        connected(lambda *_: b"x" * 1_000_000) as instrument,
        pytest.raises(InstrumentError, match="at most 100000 bytes"),
    ):
        instrument.measure("T1", 200, 2.0)


@pytest.mark.parametrize(
    "address", ["", "tcp://", "tcp://host", "tcp://host:0", "tcp://host:70000", "http://a:1", "tcp://:80", "tcp://h:-1"]
)
def test_addresses_that_are_none(address: str) -> None:
    with pytest.raises(InstrumentError, match="expected tcp://HOST:PORT or folder:DIR"):
        connect_instrument(address)


def test_nobody_listens() -> None:
    with serving(usual) as port:
        pass
    with pytest.raises(InstrumentSilentError, match=f"127.0.0.1:{port}"):
        connect_instrument(f"tcp://127.0.0.1:{port}")


@pytest.mark.parametrize("named", [{}, [], None, "T1"])
def test_an_instrument_without_targets_is_none(named: object) -> None:
    with (
        serving(usual, line({"targets_m": named})) as port,
        pytest.raises(InstrumentError, match="expected targets_m with the names of targets"),
    ):
        connect_instrument(f"tcp://127.0.0.1:{port}")


def test_an_unknown_target_is_named() -> None:
    with connected(usual) as instrument, pytest.raises(InstrumentError, match="expected one of T1, T2, found 'T9'"):
        instrument.measure("T9", 10, 1.0)
