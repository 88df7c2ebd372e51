"""Whether the angle errors of several joints are one curve, turned and mirrored: found, tested, and as a start.

A fit with a curve of each joint's own says all that its rows know of the curves: a Gaussian in their coefficients, the
rest of the model integrated out. On it every hypothesis is linear in what it leaves free, so that its evidence is exact
(:mod:`clampid.evidence.of_size`, with B'LB and B'h where the coefficients are c = B z).

Joints join a curve one by one: circular cross-correlation proposes turns for either sense, the evidence chooses among
them and decides whether the joint joins. A turn costs what the rows narrow it by from a whole revolution, a sense a
factor of 2. Source: Kass, Raftery, Bayes Factors, J. Am. Stat. Assoc. 90, 1995; MacKay, Information Theory, Inference,
and Learning Algorithms, 2003, ch. 28 (Laplace's method and Occam factors).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import optimize

from clampid.display import readable
from clampid.effect import Effect
from clampid.evidence.curves import CurvePart, Curves, coefficient_names, curves_of, turned, without_curves
from clampid.evidence.of_size import evidence
from clampid.fitting.solve import Estimate
from clampid.slots import Slot
from clampid.stages.rows import Array

__all__ = ["STRONG", "Alignment", "align", "alignment_of", "simpler"]


STRONG = float(np.log(150.0))
"""Log odds from which evidence is very strong (Kass and Raftery): less does not make two joints' curves one."""

STEPS_PER_TURN = 1440  # of a revolution: a quarter of a degree, a fifteenth of the finest harmonic's period at 48
PEAKS = 10  # of the correlation, a sense: where curves overlap little, the right one is not the highest
REFINED_WITHIN = np.pi / 360.0  # rad: a turn is refined within half a degree
# Of the curves' size: deviations with which joints are looked for, and tried.
START, MIN_SIZE, MAX_SIZE = 0.3, 0.01, 0.999
SIZES = (float(np.log(1e-6)), float(np.log(1e-2)))  # rad: curves' sizes


@dataclass(frozen=True)
class Alignment:
    """Joints on one curve.

    Attributes
    ----------
    joints
        From 0; none where no two joints' curves are one.
    sense
        ``(j,)``: +1 or -1.
    phase
        ``(j,)``, rad, in (-pi, pi]: the joint's angle error is ``s g(s q - phase)``; that of the first joint is 0.
    curve
        ``(2K - 2L,)``, rad: sine and cosine coefficients of g.
    own
        ``(j, 2K)``: of the joints alone, the first 2L in rad, the others in units of the deviation.
    deviation
        rad, rms over a turn: by how much parts of one make differ from each other.
    log_odds
        Natural logarithm of the odds of one curve against a curve of each of these joints' own.
    refused
        Joint → the same that it joins, of those that were left.
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
        """Start values of the effect's slots at these joints."""
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
    """The alignment of the curves of an estimate; None where it has fewer than two.

    Parameters
    ----------
    effect
        One that aligns another's curves, which the estimate has (:attr:`clampid.effect.Effect.aligns`).
    places
        Joints that may share a curve; all by default.
    """
    curves = curves_of(estimate, effect, places)
    return align(curves) if len(curves.joints) > 1 else None


def simpler(estimate: Estimate) -> list[dict[str, Any]]:
    """Effects that would say with one curve what the estimate says with several, as diagnosis lists them.

    Each with its joints, their senses and phases (rad), the deviation (rad), the natural logarithm of the odds, and a
    sentence.
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
    """Which joints have one curve, how each is turned, and how sure that is."""
    names = [f"joint{j + 1}" for j in found.joints]
    turns = [
        f"{name} by {np.degrees(phase) % 360:.1f} degrees{' and mirrored' if sense < 0 else ''}"
        for name, sense, phase in list(zip(names, found.sense, found.phase, strict=True))[1:]
    ]
    return (
        f"the angle errors of {', '.join(names)} are one curve, that of {names[0]}, turned: {', '.join(turns)}; the "
        f"odds of that against a curve each are e^{found.log_odds:.0f}, and they differ by "
        f"{readable(found.deviation, 'rad')} rms"
    )


@dataclass(frozen=True)
class _Turn:
    """How a joint stands on the curve, and the logarithm of what sense and phase cost."""

    sense: float = 1.0
    phase: float = 0.0
    cost: float = 0.0


class _Group:
    """Joints on one curve while others keep their own: the evidence of taking in one more.

    A member's coefficients are the curve's, turned, plus deviations of its own; of both together as much is assumed as
    of a joint with a curve of its own, so that nothing but their likeness speaks for one curve.
    """

    def __init__(self, curves: Curves, size: float, deviation: float, members: Mapping[int, _Turn]) -> None:
        self.curves, self.low, self.width = curves, curves.low, len(curves.share)
        self.harmonics = np.asarray(1.0 + self.low / 2 + np.arange(self.width // 2), dtype=np.float64)
        self.members = dict(members)
        self.size, self.deviation = size, deviation

    @property
    def shared(self) -> Array:
        """``(2K - 2L,)``: what is assumed of the curve; with the deviations a joint's error is as large as any."""
        return np.asarray(float(np.sqrt(self.size**2 - self.deviation**2)) * self.curves.share)

    def own(self, size: float) -> Array:
        """``(2K,)``: what is assumed of a joint's own, of a size."""
        return np.concatenate([self.curves.seat, size * self.curves.share])

    def with_deviation(self, deviation: float) -> _Group:
        """The same joints with other deviations from the curve."""
        return _Group(self.curves, self.size, deviation, self.members)

    def with_members(self, members: Mapping[int, _Turn]) -> _Group:
        """The same with other joints."""
        return _Group(self.curves, self.size, self.deviation, members)

    def but(self, joint: int) -> _Group:
        """The same without a joint."""
        return self.with_members({j: t for j, t in self.members.items() if j != joint})

    def without(self, joint: int | None) -> CurvePart:
        """All but the curve and one joint's own coefficients integrated out: the curve's first, then the joint's."""
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
        """Log odds that a joint which is no member joins, and how."""
        part = self.without(joint)
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
        """Phases at which the curve goes best with a joint's own, by circular cross-correlation."""
        # dq = Re sum c_k exp(ikq), c = b - ia; of s g(s q - phase) that is g exp(-ik phase), or -conj(g exp(-ik phase))
        g, c = curve[1::2] - 1j * curve[::2], own[1::2] - 1j * own[::2]
        c = c if sense > 0 else -np.conj(c)
        spectrum = np.zeros(STEPS_PER_TURN, dtype=complex)
        spectrum[self.harmonics.astype(int)] = g * np.conj(c)
        match = np.real(np.fft.fft(spectrum))  # at phase 2 pi m / STEPS_PER_TURN: Re sum g conj(c) exp(-ik phase)
        peaks = np.flatnonzero((match >= np.roll(match, 1)) & (match > np.roll(match, -1)))
        return np.asarray(2 * np.pi / STEPS_PER_TURN * peaks[np.argsort(-match[peaks])][:PEAKS])


def _peak(f: Callable[[float], float], span: tuple[float, float], prior: float) -> tuple[float, float, float]:
    """The largest value within a span, where it is, and ln of the share of the prior's range that is left of it."""
    found = optimize.minimize_scalar(lambda x: -f(x), bounds=span, method="bounded")
    x, value, step = float(found.x), -float(found.fun), 0.01 * (span[1] - span[0])
    bend = (2 * value - f(x + step) - f(x - step)) / step**2
    width = np.sqrt(2 * np.pi / bend) if bend > 0 else prior
    return value, x, float(np.log(min(width / prior, 1.0)))


def align(curves: Curves) -> Alignment:
    """The joints whose curves are one, each against a curve of its own.

    The two joints with the largest odds begin. The curves' size, and what parts of one make differ by, have the values
    of the largest evidence.
    """
    count = len(curves.joints)
    own, x, _ = _peak(lambda x: _Group(curves, float(np.exp(x)), 0.0, {}).without(None).total(), SIZES, 1.0)
    size = float(np.exp(x))
    first = _Group(curves, size, START * size, {})
    pairs = {(i, j): first.with_members({i: _Turn()}).best(j) for i in range(count) for j in range(i + 1, count)}
    (i, j), (odds, turn) = max(pairs.items(), key=lambda p: p[1][0])
    if odds < STRONG:
        left: dict[int, float] = {}
        for (a, b), (value, _) in pairs.items():
            left |= {k: max(value, left.get(k, -np.inf)) for k in (a, b)}
        return _nothing(curves, left)
    group, refused = _settled(first.with_members({i: _Turn(), j: turn}))
    span = (float(np.log(MIN_SIZE * size)), float(np.log(MAX_SIZE * size)))
    total = 0.0
    for _ in range(2):
        if len(group.members) < 2:
            return _nothing(curves, refused)
        evidence, x, cost = _peak(_by_deviation(group), span, span[1] - span[0])
        group = group.with_deviation(float(np.exp(x)))
        total = evidence - own + cost + sum(t.cost for t in group.members.values())
        group, refused = _settled(group)
    if len(group.members) < 2 or total < STRONG:
        return _nothing(curves, refused | dict.fromkeys(group.members, total))
    return _alignment(group, refused, total)


def _by_deviation(group: _Group) -> Callable[[float], float]:
    """The evidence as a function of the logarithm of the deviation."""
    return lambda x: group.with_deviation(float(np.exp(x))).without(None).total()


def _settled(group: _Group) -> tuple[_Group, dict[int, float]]:
    """Take in and let go joints one by one until none moves; and the odds of those outside."""
    for _ in range(3):
        before = set(group.members)
        group, refused = _grown(group)
        for joint in [*group.members][1:] if len(group.members) > 2 else []:
            odds, turn = group.but(joint).best(joint)
            group = group.with_members(group.but(joint).members | ({joint: turn} if odds >= STRONG else {}))
        first = next(iter(group.members))
        if len(group.members) > 2:  # the one that it began with is tested as all others, in another's place
            other = group.but(first)
            odds, turn = other.best(first)
            group = other.with_members(other.members | ({first: turn} if odds >= STRONG else {}))
        if set(group.members) == before:
            break
    return group, refused


def _grown(group: _Group) -> tuple[_Group, dict[int, float]]:
    """The group with all that have strong odds of joining it, the strongest first; and the odds of the others."""
    while True:
        odds = {j: group.best(j) for j in range(len(group.curves.joints)) if j not in group.members}
        joint = max(odds, key=lambda j: odds[j][0], default=-1)
        if joint < 0 or odds[joint][0] < STRONG:
            return group, {j: value for j, (value, _) in odds.items()}
        group = group.with_members(group.members | {joint: odds[joint][1]})


def _nothing(curves: Curves, left: Mapping[int, float]) -> Alignment:
    empty = np.zeros(0)
    refused = {curves.joints[j]: odds for j, odds in left.items()}
    return Alignment((), empty, empty, empty, np.zeros((0, len(curves.seat) + len(curves.share))), 0.0, 0.0, refused)


def _alignment(group: _Group, refused: Mapping[int, float], total: float) -> Alignment:
    """The group with its first joint as the one that phases count from."""
    curves, turns = group.curves, group.members
    order = sorted(turns)
    # s1 g(s1 q - p1) of the first joint is the curve itself: g'(u) = s1 g(s1 u - p1), and the others follow.
    s1, p1 = turns[order[0]].sense, turns[order[0]].phase
    curve = turned(s1, p1, group.harmonics) @ group.without(None).mean()
    sense = np.array([turns[j].sense * s1 for j in order])
    phase = np.array([s1 * (turns[j].phase - p1) for j in order])
    own = np.array([group.without(j).mean()[group.width :] for j in order])
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
