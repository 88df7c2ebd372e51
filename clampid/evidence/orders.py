"""Effects that repeat an unknown number of times in a motor's revolution, tried at every order that a log resolves.

The columns of an order k are sin k m and cos k m, m the motor's angle, after the filter of the noise. What all orders
would explain is a Fourier transform of the residual over the motor's angle, so that thousands cost no more than one:

    sum_t e_t (F c_k)_t = sum_t (F' e)_t c_k(t),    |F c_k|^2 = 1/2 sum_t |A(k w_t dt)|^2 / sigma_t^2

with F the filter, A its frequency response, e the whitened residual, w the motor's speed. The best order of each motor
becomes a candidate, which is scored as all others are. Its p-value is multiplied by the number of independent orders
tried (the union bound), and the order is charged like an amplitude. Source: Lomb, Least-squares frequency analysis of
unequally spaced data, Astrophysics and Space Science 39, 1976.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from clampid.effect import Effect
from clampid.evidence.candidates import Candidate, candidate_of, is_sought
from clampid.evidence.score import Scored, score
from clampid.evidence.space import Space, space_of
from clampid.fitting.further_columns import whitened_columns
from clampid.fitting.solve import Estimate
from clampid.slots import Slot, Term, number_of
from clampid.stages.fit_problem import parameter_of
from clampid.stages.prewhitening import Predictors
from clampid.stages.rows import Array, Integers
from clampid.stages.stage_kind import kind_of

__all__ = ["order_of", "order_scores"]

RESOLVED = np.pi  # rad, by which a wave may advance from one number to the next: beyond, it aliases
SLOW_ENOUGH = 0.75  # of the numbers of a motor, for which that must hold
FEWEST_PERIODS = 2.0  # within the motor's range: a part of a wave is any smooth function
BINS_PER_PERIOD = 16  # of the highest order: the middle of a bin is off by at most a thirty-second of a wave
ORDERS_PER_PEAK = 4  # tried within the width of a peak, so that at most a twentieth of it is missed
SPEEDS, SMOOTH = 64, 512  # speeds and orders for which the filter's response is computed: it changes slowly


@dataclass(frozen=True)
class _Spectrum:
    """What an effect would explain of one motor's residual at each of C orders.

    Attributes
    ----------
    place
        ``joint3`` …
    order
        ``(C,)``: periods per revolution of the motor.
    explained
        ``(C,)``: sum of squares, in units of the noise.
    independent
        Number of orders that the motor's range separates.
    """

    place: str
    order: Array
    explained: Array
    independent: float

    @property
    def best(self) -> float:
        """The order that explains most."""
        return float(self.order[np.argmax(self.explained)])


def order_scores(estimate: Estimate, space: Space, effects: Mapping[str, Effect]) -> list[Scored]:
    """Each effect of unknown order at the best order of each motor that lacks it; p-values allow for all orders.

    Parameters
    ----------
    estimate, space
        A fit of torques, and its residual with the span that it absorbs.
    effects
        All known effects, by name.
    """
    found = []
    for effect in effects.values():
        if effect.order is None or effect.search.opt_in or not kind_of(estimate.problem.stage).has(effect):
            continue
        spectra = _spectra(estimate, space, effect)
        for spectrum, s in zip(spectra, score(space, _candidates(estimate, effect, spectra)), strict=True):
            log_p = s.log_p + float(np.log(max(spectrum.independent, 1.0)))
            found.append(s.of_many(log_p, float(np.log(max(space.rows, 2)))))
    return found


def order_of(estimate: Estimate, effect: Effect, place: str) -> dict[Slot, float]:
    """Shape parameter of an absent effect at the likeliest order of joint ``place``; empty if no order is resolved."""
    found = [s for s in _spectra(estimate, space_of(estimate), effect) if s.place == place]
    return {Slot(effect.name, str(effect.order), place): s.best for s in found}


def _spectra(estimate: Estimate, space: Space, effect: Effect) -> list[_Spectrum]:
    """The spectra of all motors where an effect is not active, and which resolve any order."""
    problem, white = estimate.problem, estimate.whitened
    if not problem.kind.moving or not estimate.noise.autocorrelations:
        return []
    active = {(slot.effect, slot.place) for slot in estimate.slots}
    found = []
    for place in problem.rows.layout.allowed(effect, problem.stage):
        number = number_of(place)
        own = np.flatnonzero(white.channel == number)
        if (effect.name, place) in active or not len(own) or not is_sought(estimate, effect, place):
            continue
        slot = Slot(effect.name, str(effect.order), place)
        bounds = parameter_of(slot, {effect.name: effect}, problem.rows.robot).bounds
        spectrum = _spectrum(estimate, space.residual[own], white.entry[own], place, bounds)
        found += [] if spectrum is None else [spectrum]
    return found


def _spectrum(
    estimate: Estimate, residual: Array, entry: Integers, place: str, bounds: tuple[float, float]
) -> _Spectrum | None:
    """The spectrum of a motor's whitened residual ``(k,)``, whose numbers come from rows ``entry``, between bounds."""
    rows, noise, motor = estimate.problem.rows, estimate.noise, number_of(place)
    angle = rows.signals["motor"][entry, motor]
    reach = float(np.ptp(angle))
    step = noise.together * _row_step(rows.log.time, entry)
    advance = np.abs(rows.signals["motor_speed"][entry, motor]) * step
    fastest = float(np.quantile(advance, SLOW_ENOUGH))
    lower = max(bounds[0], FEWEST_PERIODS * 2.0 * np.pi / max(reach, 1e-300))
    upper = min(bounds[1], RESOLVED / max(fastest, 1e-300))
    if upper <= lower:
        return None
    response = Predictors(noise.autocorrelations[motor]).plain
    sigma = noise.sigma[entry, motor]
    # Beside gaps the filter has other weights: that is left to the score of the order that is chosen.
    back = np.correlate(np.r_[residual, np.zeros(len(response) - 1)], response, "valid") / sigma
    width = 2.0 * np.pi / (BINS_PER_PERIOD * upper)
    bins = np.bincount(((angle - angle.min()) / width).astype(np.int64), back)
    count = 1 << int(np.ceil(np.log2(ORDERS_PER_PEAK * len(bins))))
    order = 2.0 * np.pi / width * np.arange(count // 2 + 1) / count
    inside = (order >= lower) & (order <= upper)
    if not inside.any():
        return None
    product = np.abs(np.fft.rfft(bins, count)[inside]) ** 2
    some = np.linspace(lower, upper, SMOOTH)
    squares = np.interp(order[inside], some, _squares(response, some, advance, sigma))
    return _Spectrum(place, order[inside], product / squares, (upper - lower) * reach / (2.0 * np.pi))


def _row_step(time: Array, entry: Integers) -> float:
    """Usual time between neighbouring rows of the log, s."""
    neighbours = np.flatnonzero(np.diff(entry) > 0)
    gaps = (time[entry[neighbours + 1]] - time[entry[neighbours]]) / np.diff(entry)[neighbours]
    return float(np.median(gaps)) if len(gaps) else 0.0


def _squares(response: Array, order: Array, advance: Array, sigma: Array) -> Array:
    """Squared length ``(C,)`` of the whitened sine, or cosine, of each order ``(C,)``.

    Parameters
    ----------
    response
        Weights of the filter ``(13,)``.
    advance, sigma
        ``(k,)``: by how much the motor turns from one number to the next, rad; standard deviations of the numbers, Nm.
    """
    edges = np.linspace(0.0, float(advance.max()) * (1.0 + 1e-12) + 1e-300, SPEEDS + 1)
    weight, _ = np.histogram(advance, edges, weights=sigma**-2.0)
    phase = np.outer(order, 0.5 * (edges[1:] + edges[:-1]))
    lags = np.arange(len(response))
    autocovariance = np.array([response[k:] @ response[: len(response) - k] for k in lags])
    power = autocovariance[0] + 2.0 * sum(
        r * np.cos(k * phase) for k, r in zip(lags[1:], autocovariance[1:], strict=True)
    )
    return np.asarray(0.5 * np.maximum(power, 1e-12) @ weight)


def _candidates(estimate: Estimate, effect: Effect, spectra: Sequence[_Spectrum]) -> list[Candidate]:
    """The effect at the best order of each motor as candidates."""
    if not spectra:
        return []
    slots = [Slot(effect.name, p.name, s.place) for s in spectra for p in effect.parameters]
    parameters = {slot: parameter_of(slot, {effect.name: effect}, estimate.problem.rows.robot) for slot in slots}
    best = {Slot(effect.name, str(effect.order), s.place): s.best for s in spectra}
    values = [best.get(slot, 0.0) for slot in slots]
    white, index = whitened_columns(estimate, slots, values), {slot: k for k, slot in enumerate(slots)}
    return [
        candidate_of(
            effect,
            (Term(effect.name, s.place),),
            [slot for slot in slots if slot.place == s.place],
            parameters,
            index,
            values,
            white,
        )
        for s in spectra
    ]
