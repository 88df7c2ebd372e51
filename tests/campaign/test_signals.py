"""Speeds and accelerations: exact for cubics, without lag, on the stamps as they are; faults of the clock are found."""

from __future__ import annotations

import time as clock

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from experiments.signals import (
    accelerations,
    choose_window,
    differentiate,
    gaps,
    irregularity,
    low_pass,
    segments,
    speeds,
    stale_rows,
)
from experiments.signals.polynomial import kernel

CUBIC = np.polynomial.Polynomial([0.3, -1.2, 0.7, 0.4])


def one_run(n: int) -> np.ndarray:
    return np.zeros(n, dtype=np.int64)


def stamps(kind: str, n: int = 60, step: float = 0.01) -> np.ndarray:
    rng = np.random.default_rng(3)
    even = 5.0 + step * np.arange(n)
    if kind == "jitter":
        return even + 0.3 * step * rng.uniform(-1.0, 1.0, n)
    if kind == "dropped":
        return np.delete(even, 4 + 3 * rng.permutation(n // 3 - 2)[:10])
    return even


@pytest.mark.parametrize("kind", ["even", "jitter", "dropped"])
@pytest.mark.parametrize("rows", [5, 7, 31])
@pytest.mark.parametrize("order", [0, 1, 2])
def test_cubics_are_exact_everywhere(kind: str, rows: int, order: int) -> None:
    time = stamps(kind)
    local = time - time[0]
    wanted = CUBIC.deriv(order)(local)[:, None] if order else CUBIC(local)[:, None]
    out = differentiate(CUBIC(local)[:, None], time, one_run(len(time)), order, (rows - 1) * 0.01)
    np.testing.assert_allclose(out, wanted, atol=1e-8 if order == 2 else 1e-10)


@settings(deadline=None, max_examples=40)
@example(11733, 0, 10)
@example(3, 1, 17)
@given(st.integers(0, 10**6), st.sampled_from([0, 1, 2]), st.integers(2, 20))
def test_a_mirrored_signal_has_a_mirrored_derivative(seed: int, order: int, half: int) -> None:
    # Zero phase: a filter that lags by ever so little would not commute with turning time round.
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 80))
    time = np.cumsum(rng.uniform(0.2, 1.0, n)) if seed % 2 else np.arange(n) * 1.0
    values, run = rng.normal(size=(n, 2)), one_run(n)
    forth = differentiate(values, time, run, order, 2.0 * half)
    back = differentiate(values[::-1], -time[::-1], run, order, 2.0 * half)
    np.testing.assert_allclose(back[::-1] * (-1.0) ** order, forth, atol=1e-9 * (1.0 + np.abs(forth).max()))


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 10**6), st.sampled_from([0, 1, 2]))
def test_the_filter_is_linear_and_blind_to_the_origins(seed: int, order: int) -> None:
    rng = np.random.default_rng(seed)
    n = 70
    time, run = np.cumsum(rng.uniform(0.5, 1.0, n)), one_run(n)
    a, b = rng.normal(size=(2, n, 2))

    def take(values: np.ndarray, at: np.ndarray) -> np.ndarray:
        return differentiate(values, at, run, order, 8.0)

    np.testing.assert_allclose(take(a - 2.0 * b, time), take(a, time) - 2.0 * take(b, time), atol=1e-9)
    np.testing.assert_allclose(take(a, time + 1000.0), take(a, time), atol=1e-7)
    np.testing.assert_allclose(take(a + 50.0, time), take(a, time) + (50.0 if order == 0 else 0.0), atol=1e-9)


@pytest.mark.parametrize("order", [1, 2])
def test_sines_come_out_with_the_gain_of_the_kernel_and_no_phase(order: int) -> None:
    n, step, half, omega = 2000, 1e-3, 12, 2 * np.pi * 6.0
    time = step * np.arange(n)
    out = differentiate(np.sin(omega * time)[:, None], time, one_run(n), order, 2 * half * step)[half:-half, 0]
    offset = np.arange(-half, half + 1)
    gain = np.abs(np.sum(kernel(half, order) * np.exp(1j * omega * step * offset))) / step**order
    wanted = gain * (np.cos(omega * time) if order == 1 else -np.sin(omega * time))
    np.testing.assert_allclose(out, wanted[half:-half], atol=1e-7 * gain)
    assert gain == pytest.approx(omega**order, rel=0.02)


def test_even_and_general_paths_agree() -> None:
    rng = np.random.default_rng(0)
    n = 300
    even = 0.01 * np.arange(n)
    values = rng.normal(size=(n, 3))
    uneven = even + 1e-7 * rng.normal(size=n)  # too uneven for the convolution, not for the eye
    for order in (0, 1, 2):
        for window in (0.04, 0.3):
            a, b = (differentiate(values, t, one_run(n), order, window) for t in (even, uneven))
            np.testing.assert_allclose(a, b, atol=2e-3 * np.abs(a).max())


def test_nothing_reaches_across_runs_and_long_gaps() -> None:
    time = np.r_[np.arange(40) * 0.1, 10.0 + np.arange(40) * 0.1, np.arange(40) * 0.1]
    run = np.repeat([0, 0, 1], 40)
    level = np.repeat([0.0, 5.0, -3.0], 40)[:, None]
    assert np.abs(differentiate(level, time, run, 1, 1.0)).max() < 1e-9
    slope = level + np.repeat([1.0, -2.0, 0.5], 40)[:, None] * time[:, None]
    np.testing.assert_allclose(speeds(slope, time, run)[:, 0], np.repeat([1.0, -2.0, 0.5], 40), atol=1e-9)


def test_repeated_stamps_and_rows_give_no_infinite_or_zero_speeds() -> None:
    time = 0.01 * np.arange(200)
    q = np.column_stack([time**2 + time, 2.0 * time])
    again = time.copy()
    again[50] = again[49]
    out = speeds(np.column_stack([again**2 + again, 2.0 * again]), again, one_run(200))
    np.testing.assert_allclose(out, np.column_stack([2.0 * again + 1.0, np.full(200, 2.0)]), atol=1e-9)
    q[100:102] = q[99]
    assert np.flatnonzero(stale_rows(q, one_run(200))).tolist() == [100, 101]
    np.testing.assert_allclose(speeds(q, time, one_run(200))[:, 0], 2.0 * time + 1.0, atol=1e-6)


@pytest.mark.parametrize("rows", [0, 1, 2, 3, 4, 5, 6])
def test_few_rows(rows: int) -> None:
    time = 0.1 * np.arange(rows)
    out = speeds(3.0 * time[:, None], time, one_run(rows))
    np.testing.assert_allclose(out[:, 0], 3.0 if rows > 1 else 0.0, atol=1e-9)
    assert np.all(np.abs(accelerations(3.0 * time[:, None], time, one_run(rows))) < 1e-8)


def test_printed_stamps_of_even_steps_count_as_even() -> None:
    even = np.arange(3000) / 300.0
    printed = np.round(even, 3)
    q = np.sin(2.0 * even)[:, None]
    assert irregularity(printed, one_run(3000)) == 0.0
    a, b = (speeds(q, t, one_run(3000), 0.05) for t in (even, printed))
    np.testing.assert_allclose(a, b, atol=1e-3)  # on the stamps as printed it would be 0.1


@pytest.mark.parametrize("seed", range(5))
def test_filtering_both_sides_keeps_parameters(seed: int) -> None:
    # Noise-free torque J·q̈ + F·sign(q̇): unfiltered against blurred accelerations J comes out wrong, filtered right.
    rng = np.random.default_rng(seed)
    time, run = 0.002 * np.arange(4000), one_run(4000)
    rate = rng.uniform(20.0, 40.0)
    q, qd = np.sin(rate * time), rate * np.cos(rate * time)
    tau = 0.7 * -(rate**2) * np.sin(rate * time) + 3.0 * np.sign(qd)
    q = q + 1e-6 * rng.normal(size=q.size)
    window = 0.03
    Y = np.column_stack([accelerations(q[:, None], time, run, window), np.sign(speeds(q[:, None], time, run, window))])
    long = 3 * window
    Yf, tauf = low_pass(Y, time, run, long), low_pass(tau[:, None], time, run, long)
    np.testing.assert_allclose(np.linalg.lstsq(Yf, tauf[:, 0], rcond=None)[0], [0.7, 3.0], rtol=0.03)


class TestWindow:
    def rms(self, noise: float, factor: float, order: int) -> float:
        """Error of a derivative with the chosen window times a factor."""
        rng = np.random.default_rng(1)
        time, run = 1e-3 * np.arange(20000), one_run(20000)
        rates = 2 * np.pi * np.array([0.7, 1.1, 2.3])
        q = np.sum(np.sin(time[:, None] * rates), axis=1)[:, None] + noise * rng.normal(size=(20000, 1))
        window = factor * choose_window(q, time, run, order)
        signs = [1.0, 1.0, -1.0]
        truth = np.sum(signs[order] * rates**order * (np.cos if order == 1 else np.sin)(time[:, None] * rates), axis=1)
        return float(np.sqrt(np.mean((differentiate(q, time, run, order, window)[:, 0] - truth)[500:-500] ** 2)))

    @pytest.mark.parametrize("noise", [1e-6, 1e-4, 1e-2])
    @pytest.mark.parametrize("order", [1, 2])
    def test_it_is_near_the_best(self, noise: float, order: int) -> None:
        errors = [self.rms(noise, factor, order) for factor in np.geomspace(0.4, 2.5, 9)]
        assert self.rms(noise, 1.0, order) < 1.3 * min(errors)

    def test_more_noise_more_window(self) -> None:
        rng = np.random.default_rng(0)
        time = 1e-3 * np.arange(10000)
        q, e = np.sin(3.0 * time)[:, None], rng.normal(size=(10000, 1))
        windows = [choose_window(q + s * e, time, one_run(10000), 2) for s in (0.0, 1e-7, 1e-5, 1e-3)]
        assert windows[0] == pytest.approx(0.004)
        assert np.all(np.diff(windows) > 0.0)

    def test_an_uneven_clock_is_no_noise(self) -> None:
        rng = np.random.default_rng(0)
        time = 1e-3 * np.arange(10000) + 3e-4 * rng.uniform(-1.0, 1.0, 10000)
        assert choose_window(np.sin(3.0 * time)[:, None], time, one_run(10000), 1) < 0.02

    def test_one_still_joint_changes_nothing(self) -> None:
        rng = np.random.default_rng(0)
        time = 1e-3 * np.arange(10000)
        q = np.column_stack([np.sin(3.0 * time) + 1e-5 * rng.normal(size=10000), np.ones(10000)])
        assert choose_window(q, time, one_run(10000), 2) == choose_window(q[:, :1], time, one_run(10000), 2)


def test_bad_arguments_are_named() -> None:
    time = np.arange(10.0)
    with pytest.raises(ValueError, match=r"expected shapes .* found \(10, 1\), \(9,\)"):
        speeds(np.zeros((10, 1)), time[:9], one_run(10))
    with pytest.raises(ValueError, match="order: expected 0, 1 or 2, found 3"):
        differentiate(np.zeros((10, 1)), time, one_run(10), 3)
    with pytest.raises(ValueError, match=r"window_s: expected a positive .* found -1"):
        low_pass(np.zeros((10, 1)), time, one_run(10), -1.0)


class TestClock:
    time = 0.1 * np.arange(400)
    q = np.column_stack([np.sin(0.5 * time), np.cos(0.3 * time)])

    def test_a_good_clock(self) -> None:
        assert gaps(self.q, self.time, one_run(400)) == ()
        assert irregularity(self.time, one_run(400)) == 0.0
        assert not stale_rows(self.q, one_run(400)).any()

    def test_dropped_samples(self) -> None:
        keep = np.delete(np.arange(400), [100, 200, 201])
        found = gaps(self.q[keep], self.time[keep], one_run(len(keep)))
        assert [(g.kind, g.row, g.missing) for g in found] == [("dropped", 100, 1), ("dropped", 199, 2)]

    @pytest.mark.parametrize("jump", [-0.08, 0.25, 0.4, 3.0])
    def test_clock_jumps(self, jump: float) -> None:
        time = self.time + np.where(np.arange(400) >= 150, jump, 0.0)
        (found,) = gaps(self.q, time, one_run(400))
        assert (found.kind, found.row) == ("jump", 150)
        assert found.seconds == pytest.approx(0.1 + jump)

    @pytest.mark.parametrize("share", [0.02, 0.1])
    def test_jitter_is_no_gap(self, share: float) -> None:
        rng = np.random.default_rng(0)
        time = self.time + share * 0.1 * rng.normal(size=400)
        assert gaps(self.q, time, one_run(400)) == ()
        assert irregularity(time, one_run(400)) == pytest.approx(np.sqrt(2.0) * share, rel=0.2)

    def test_a_stop_is_no_repetition(self) -> None:
        rest = np.r_[self.q[:200], np.repeat(self.q[199:200], 30, axis=0), self.q[200:]]
        assert not stale_rows(rest[:231], one_run(231)).any()
        s = np.clip(np.arange(60) - 20, 0, 20) / 20.0
        move = (s**3 * (10 - 15 * s + 6 * s**2))[:, None]
        assert not stale_rows(np.round(move, 4), one_run(60)).any()

    @pytest.mark.parametrize("seed", range(3))
    def test_rounding_is_no_repetition(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        q = np.round(self.q + 2e-4 * rng.normal(size=self.q.shape), 3)
        assert stale_rows(q, one_run(400)).sum() <= 1

    def test_a_slower_source(self) -> None:
        held = self.q[(np.arange(400) // 2) * 2]
        assert stale_rows(held, one_run(400)).mean() > 0.3

    def test_stretches_end_where_the_clock_jumps(self) -> None:
        time = np.r_[np.arange(5.0), 20.0 + np.arange(5.0)]
        used = np.ones(10, dtype=bool)
        used[2] = False
        assert segments(one_run(10), time, used).tolist() == [0, 0, -1, 1, 1, 2, 2, 2, 2, 2]
        assert segments(one_run(0), time[:0], used[:0]).tolist() == []


def test_a_hundred_thousand_rows_take_a_fraction_of_a_second() -> None:
    time = 1e-3 * np.arange(100_000)
    q = np.sin(time[:, None] * np.arange(1.0, 7.0))
    begun = clock.process_time()
    speeds(q, time, one_run(len(time)))
    accelerations(q, time, one_run(len(time)))
    assert clock.process_time() - begun < 2.0  # 0.2 s on an idle core; other work shares this one
