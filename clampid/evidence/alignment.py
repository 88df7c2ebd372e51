"""Whether the angle errors of several joints follow one shared curve, shifted in phase and perhaps mirrored.

The input is a fit in which each joint has a curve of its own. The likelihood of the curves' coefficients is then
Gaussian, with the rest of the model integrated out. Each hypothesis "these joints share a curve" is linear in its free
coefficients, so its evidence is exact (:mod:`clampid.evidence.of_size`, with B'LB and B'h where the coefficients are
c = B z).

Joints are added to the shared curve one by one. Circular cross-correlation proposes phases for each sense; the evidence
chooses among them and decides whether the joint is added. A phase costs the factor by which the rows narrow it from a
whole revolution; a sense costs a factor of 2. Source: Kass, Raftery, Bayes Factors, J. Am. Stat. Assoc. 90, 1995;
MacKay, Information Theory, Inference, and Learning Algorithms, 2003, ch. 28 (Laplace's method and Occam factors).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import optimize

from clampid.display import odds_text, readable
from clampid.effect import Effect
from clampid.evidence.curves import CurvePart, Curves, coefficient_names, curves_of, turned, without_curves
from clampid.evidence.of_size import evidence
from clampid.fitting.solve import Estimate
from clampid.slots import Slot
from clampid.stages.rows import Array

__all__ = ["VERY_STRONG_LOG_ODDS", "Alignment", "align", "alignment_of", "simpler"]


VERY_STRONG_LOG_ODDS = float(np.log(150.0))
"""Log odds from which evidence is very strong (Kass and Raftery). With less, joints keep curves of their own."""

STEPS_PER_TURN = 1440  # a step is a quarter of a degree: thirty for each period of the 48th harmonic
PEAKS_PER_SENSE = 10  # correlation peaks tried: where curves overlap little, the right one is not the highest
REFINED_WITHIN = np.pi / 360.0  # rad: a phase is refined within half a degree
# Each joint's deviation from the shared curve, as a share of the curves' size: first value, and bounds of the search.
DEVIATION_START, DEVIATION_MIN, DEVIATION_MAX = 0.3, 0.01, 0.999
LOG_CURVE_SIZES = (float(np.log(1e-6)), float(np.log(1e-2)))  # ln(rad): bounds of the curves' size


@dataclass(frozen=True)
class Alignment:
    """Joints that share one curve g.

    Attributes
    ----------
    joints
        Joint numbers from 0; empty if no two joints share a curve.
    sense
        ``(j,)``: +1 or -1 (mirrored).
    phase
        ``(j,)``, rad, in (-pi, pi]: the joint's angle error is ``s g(s q - phase)``. The first joint's phase is 0.
    curve
        ``(2K - 2L,)``, rad: sine and cosine coefficients of g.
    own
        ``(j, 2K)``: coefficients of each joint's own; the first 2L in rad, the others in units of ``deviation``.
    deviation
        rad, rms over a turn: how much a joint's error differs from the shared curve.
    log_odds
        Natural logarithm of the odds of one shared curve against a curve for each of these joints.
    refused
        Each joint that was not added → natural logarithm of the odds that it shares the curve.
    """

    joints: tuple[int, ...]
    sense: Array
    phase: Array
    curve: Array
    own: Array
    deviation: float
    log_odds: float
    refused: Mapping[int, float]

    def values(self, effect: Effect) -> dict[Slot, float]:
        """Initial values of the slots of ``effect`` at these joints, SI; ``effect`` is one that aligns curves."""
        shared, low, high = coefficient_names(effect)
        out = {Slot(effect.name, "deviation", effect.at): self.deviation}
        for k, j in enumerate(self.joints):
            place = f"joint{j + 1}"
            out[Slot(effect.name, "sense", place)] = float(self.sense[k])
            out[Slot(effect.name, "phase", place)] = float(self.phase[k])
            own = zip((*low, *high), self.own[k].tolist(), strict=True)
            out |= {Slot(effect.name, f"own_{a}", place): v for a, v in own}
        return out | {Slot(effect.name, a, effect.at): v for a, v in zip(shared, self.curve.tolist(), strict=True)}


def alignment_of(estimate: Estimate, effect: Effect, places: Sequence[str] | None = None) -> Alignment | None:
    """Which joints of an estimate share a curve; None if the estimate has fewer than two curves.

    Parameters
    ----------
    estimate
        A fit with curves of single joints.
    effect
        The effect that aligns these curves (:attr:`clampid.effect.Effect.aligns`).
    places
        Joints that may share a curve (``joint3`` …); all by default.
    """
    curves = curves_of(estimate, effect, places)
    return align(curves) if len(curves.joints) > 1 else None


def simpler(estimate: Estimate) -> list[dict[str, Any]]:
    """Effects that describe several of the estimate's curves by one shared curve, as diagnosis reports them.

    Each entry has the joints, their senses and phases (rad), the deviation (rad rms), the natural logarithm of the
    odds, and a sentence.
    """
    effects, active = estimate.problem.effects, {slot.effect for slot in estimate.slots}
    out = []
    for effect in effects.values():
        if effect.aligns not in active or effect.name in active:
            continue
        found = alignment_of(estimate, effect)
        if found is not None and found.joints:
            out.append(
                {
                    "effect": effect.family,
                    "name": effect.name,
                    "instead_of": effect.aligns,
                    "where": [f"joint{j + 1}" for j in found.joints],
                    "sense": found.sense.tolist(),
                    "phase": found.phase.tolist(),
                    "deviation": found.deviation,
                    "log_odds": found.log_odds,
                    "summary": _summary(found),
                }
            )
    return out


def _summary(found: Alignment) -> str:
    """Which joints share a curve, the phase of each, and the odds, as a sentence."""
    names = [f"joint{j + 1}" for j in found.joints]
    turns = [
        f"{name} by {np.degrees(phase) % 360:.1f} degrees{' and mirrored' if sense < 0 else ''}"
        for name, sense, phase in list(zip(names, found.sense, found.phase, strict=True))[1:]
    ]
    return (
        f"the angle errors of {', '.join(names)} follow one curve, that of {names[0]}, turned: {', '.join(turns)}; the "
        f"odds of one shared curve against a curve for each joint are {odds_text(found.log_odds)}, and the joints "
        f"differ from it by {readable(found.deviation, 'rad')} rms"
    )


@dataclass(frozen=True)
class _Turn:
    """Sense and phase (rad) of a joint on the shared curve, and the logarithm of their Occam factor."""

    sense: float = 1.0
    phase: float = 0.0
    cost: float = 0.0


class _Group:
    """Members share one curve, other joints keep their own: the evidence for adding one more member.

    A member's coefficients are those of the shared curve, shifted in phase, plus deviations of its own. The prior of
    this sum is as wide as that of a joint with a curve of its own, so only the likeness of the curves is evidence.
    """

    def __init__(self, curves: Curves, size: float, deviation: float, members: Mapping[int, _Turn]) -> None:
        self.curves, self.low, self.width = curves, curves.low, len(curves.share)
        self.harmonics = np.asarray(1.0 + self.low / 2 + np.arange(self.width // 2), dtype=np.float64)
        self.members = dict(members)
        self.size, self.deviation = size, deviation

    @property
    def shared(self) -> Array:
        """``(2K - 2L,)``, rad: prior standard deviations of the shared curve; with the deviations they add to size."""
        return np.asarray(float(np.sqrt(self.size**2 - self.deviation**2)) * self.curves.share)

    def own(self, size: float) -> Array:
        """``(2K,)``, rad: prior standard deviations of a joint's own coefficients, for curves of that size."""
        return np.concatenate([self.curves.seat, size * self.curves.share])

    def with_deviation(self, deviation: float) -> _Group:
        """The same members with another deviation from the curve, rad."""
        return _Group(self.curves, self.size, deviation, self.members)

    def with_members(self, members: Mapping[int, _Turn]) -> _Group:
        """The same with other members."""
        return _Group(self.curves, self.size, self.deviation, members)

    def without_member(self, joint: int) -> _Group:
        """The same without one member."""
        return self.with_members({j: t for j, t in self.members.items() if j != joint})

    def marginal(self, joint: int | None) -> CurvePart:
        """The shared curve's coefficients, then those of ``joint`` (None: of no joint); all others integrated out."""
        c = self.curves
        count, own = len(c.joints), self.low + self.width
        by_joint = np.zeros((count, own, self.width))
        for j, turn in self.members.items():
            by_joint[j, self.low :] = turned(turn.sense, turn.phase, self.harmonics)
        B = by_joint.reshape(count * own, -1)
        L, h = c.information.reshape(count * own, -1), c.score.ravel()
        LB = L @ B
        prior = [self.shared, *(self.own(self.deviation if j in self.members else self.size) for j in range(count))]
        whole = CurvePart(np.block([[B.T @ LB, LB.T], [LB, L]]), np.r_[B.T @ h, h], np.concatenate(prior))
        gone = np.ones(len(whole.prior), dtype=bool)
        gone[: self.width] = False
        if joint is not None:
            gone[self.width + own * joint : self.width + own * (joint + 1)] = False
        return without_curves(whole, gone)

    def best(self, joint: int) -> tuple[float, _Turn]:
        """Log odds that a joint which is no member shares the curve, and its best sense and phase."""
        part = self.marginal(joint)
        prior = np.r_[self.shared, self.own(self.deviation)]
        high = slice(self.width + self.low, None)

        def joined(sense: float, phase: float) -> float:
            B = np.eye(len(prior))
            B[high, : self.width] = turned(sense, phase, self.harmonics)
            return part.evidence + evidence(B.T @ part.information @ B, B.T @ part.score, prior)[0]

        mean = part.mean()
        value, sense, phase = max(
            (joined(s, phase), s, phase)
            for s in (1.0, -1.0)
            for phase in self.proposed(mean[: self.width], mean[high], s).tolist()
        )
        value, phase, cost = _peak(
            lambda x: joined(sense, x), (phase - REFINED_WITHIN, phase + REFINED_WITHIN), 2 * np.pi
        )
        cost -= float(np.log(2.0))
        return value - part.total() + cost, _Turn(sense, phase, cost)

    def proposed(self, curve: Array, own: Array, sense: float) -> Array:
        """Phases (rad) at which the shared curve correlates best with a joint's own, by circular cross-correlation."""
        # dq = Re sum c_k exp(ikq), c = b - ia; of s g(s q - phase) that is g exp(-ik phase), or -conj(g exp(-ik phase))
        g, c = curve[1::2] - 1j * curve[::2], own[1::2] - 1j * own[::2]
        c = c if sense > 0 else -np.conj(c)
        spectrum = np.zeros(STEPS_PER_TURN, dtype=complex)
        spectrum[self.harmonics.astype(int)] = g * np.conj(c)
        match = np.real(np.fft.fft(spectrum))  # at phase 2 pi m / STEPS_PER_TURN: Re sum g conj(c) exp(-ik phase)
        peaks = np.flatnonzero((match >= np.roll(match, 1)) & (match > np.roll(match, -1)))
        return np.asarray(2 * np.pi / STEPS_PER_TURN * peaks[np.argsort(-match[peaks])][:PEAKS_PER_SENSE])


def _peak(f: Callable[[float], float], span: tuple[float, float], prior: float) -> tuple[float, float, float]:
    """The maximum of ``f`` within a span, its position, and its Occam factor by Laplace's method.

    The Occam factor is the logarithm of the peak's width over ``prior``, the width of the prior.
    """
    found = optimize.minimize_scalar(lambda x: -f(x), bounds=span, method="bounded")
    x, value, step = float(found.x), -float(found.fun), 0.01 * (span[1] - span[0])
    bend = (2 * value - f(x + step) - f(x - step)) / step**2
    width = np.sqrt(2 * np.pi / bend) if bend > 0 else prior
    return value, x, float(np.log(min(width / prior, 1.0)))


def align(curves: Curves) -> Alignment:
    """The joints that share a curve, tested against a curve for each joint.

    The pair of joints with the largest odds comes first. The size of the curves and the deviation of the joints from
    the shared curve are those with the largest evidence.
    """
    count = len(curves.joints)
    own, x, _ = _peak(lambda x: _Group(curves, float(np.exp(x)), 0.0, {}).marginal(None).total(), LOG_CURVE_SIZES, 1.0)
    size = float(np.exp(x))
    first = _Group(curves, size, DEVIATION_START * size, {})
    pairs = {(i, j): first.with_members({i: _Turn()}).best(j) for i in range(count) for j in range(i + 1, count)}
    (i, j), (odds, turn) = max(pairs.items(), key=lambda p: p[1][0])
    if odds < VERY_STRONG_LOG_ODDS:
        left: dict[int, float] = {}
        for (a, b), (value, _) in pairs.items():
            left |= {k: max(value, left.get(k, -np.inf)) for k in (a, b)}
        return _no_alignment(curves, left)
    group, refused = _settled(first.with_members({i: _Turn(), j: turn}))
    span = (float(np.log(DEVIATION_MIN * size)), float(np.log(DEVIATION_MAX * size)))
    total = 0.0
    for _ in range(2):
        if len(group.members) < 2:
            return _no_alignment(curves, refused)
        evidence, x, cost = _peak(_by_deviation(group), span, span[1] - span[0])
        group = group.with_deviation(float(np.exp(x)))
        total = evidence - own + cost + sum(t.cost for t in group.members.values())
        group, refused = _settled(group)
    if len(group.members) < 2 or total < VERY_STRONG_LOG_ODDS:
        return _no_alignment(curves, refused | dict.fromkeys(group.members, total))
    return _alignment(group, refused, total)


def _by_deviation(group: _Group) -> Callable[[float], float]:
    """The evidence as a function of the logarithm of the deviation."""
    return lambda x: group.with_deviation(float(np.exp(x))).marginal(None).total()


def _settled(group: _Group) -> tuple[_Group, dict[int, float]]:
    """Add and remove members one by one until none changes; also the log odds of the joints outside."""
    for _ in range(3):
        before = set(group.members)
        group, refused = _grown(group)
        for joint in [*group.members][1:] if len(group.members) > 2 else []:
            odds, turn = group.without_member(joint).best(joint)
            group = group.with_members(
                group.without_member(joint).members | ({joint: turn} if odds >= VERY_STRONG_LOG_ODDS else {})
            )
        first = next(iter(group.members))
        if len(group.members) > 2:  # the first member is tested too: the next one then gives the phases' origin
            other = group.without_member(first)
            odds, turn = other.best(first)
            group = other.with_members(other.members | ({first: turn} if odds >= VERY_STRONG_LOG_ODDS else {}))
        if set(group.members) == before:
            break
    return group, refused


def _grown(group: _Group) -> tuple[_Group, dict[int, float]]:
    """The group with all joints that share its curve, those with the largest odds first; also the others' log odds."""
    while True:
        odds = {j: group.best(j) for j in range(len(group.curves.joints)) if j not in group.members}
        joint = max(odds, key=lambda j: odds[j][0], default=-1)
        if joint < 0 or odds[joint][0] < VERY_STRONG_LOG_ODDS:
            return group, {j: value for j, (value, _) in odds.items()}
        group = group.with_members(group.members | {joint: odds[joint][1]})


def _no_alignment(curves: Curves, left: Mapping[int, float]) -> Alignment:
    empty = np.zeros(0)
    refused = {curves.joints[j]: odds for j, odds in left.items()}
    return Alignment((), empty, empty, empty, np.zeros((0, len(curves.seat) + len(curves.share))), 0.0, 0.0, refused)


def _alignment(group: _Group, refused: Mapping[int, float], total: float) -> Alignment:
    """The group as an alignment whose phases count from its first joint."""
    curves, turns = group.curves, group.members
    order = sorted(turns)
    # s1 g(s1 q - p1) of the first joint is the curve itself: g'(u) = s1 g(s1 u - p1), and the others follow.
    s1, p1 = turns[order[0]].sense, turns[order[0]].phase
    curve = turned(s1, p1, group.harmonics) @ group.marginal(None).mean()
    sense = np.array([turns[j].sense * s1 for j in order])
    phase = np.array([s1 * (turns[j].phase - p1) for j in order])
    own = np.array([group.marginal(j).mean()[group.width :] for j in order])
    own[:, group.low :] /= group.deviation
    return Alignment(
        joints=tuple(curves.joints[j] for j in order),
        sense=sense,
        phase=np.pi - np.mod(np.pi - phase, 2 * np.pi),
        curve=curve,
        own=own,
        deviation=group.deviation,
        log_odds=total,
        refused={curves.joints[j]: odds for j, odds in refused.items()},
    )
