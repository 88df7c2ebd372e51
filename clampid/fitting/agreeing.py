"""Rows that would be rejected as outliers, but agree with each other: no outliers, but what the model lacks.

An instrument's wrong numbers come anywhere. Where the rows that a fit would reject crowd together in a recorded
variable (an angle, a load, a temperature, the time, a place) or belong to one target, direction or session, something
that these rows share moves them, and no row is dropped for what a model lacks.

The null says that the V visits of which rows would be rejected, K of them, are any K of all. Along a variable the
visits are put in order, and for every stretch from one bad visit to another the likelihood ratio is taken of bad visits
being more frequent inside than outside; the largest is compared with those of K visits drawn at random. Of categories,
the hypergeometric tail says the same. The chance that anything is called agreement where nothing agrees is
:data:`AGREEING_FALSE_ALARMS`, over all variables (Bonferroni). Source: Kulldorff, A spatial scan
statistic, Communications in Statistics 26, 1997. Visits are counted, not rows, for what moves one point of a visit may
move all of them: what is wrong in one visit alone agrees with nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from scipy import special, stats

from clampid.stages.rows import Array, Bools, Integers, Rows

__all__ = ["AGREEING_FALSE_ALARMS", "MIN_VISITS", "Agreement", "agreement"]

# Chance that rejected rows of clean tables are said to agree; the same as of a row to be rejected at all.
AGREEING_FALSE_ALARMS = 0.01
MIN_VISITS = 4  # visits that agree: of fewer a model with a height, a middle and a width would say anything
NULL_DRAWS = 9999
NUMBERS_AT_ONCE = 2_000_000  # numbers drawn at once, for the memory they take
FARTHER = 4.0  # than the rows that agree are off in the median: what is, is wrong beside


@dataclass(frozen=True)
class Agreement:
    """Rows that agree.

    Attributes
    ----------
    rows
        ``(N,)``.
    variable
        In what they agree, as a column is called without its unit; ``target`` or ``session``.
    low, high
        Between which values, SI; NaN of a target or session.
    label
        Which target, session or direction.
    p
        Chance of as much agreement, over all variables.
    visits
        How many visits they are of.
    """

    rows: Bools
    variable: str
    low: float
    high: float
    label: str
    p: float
    visits: int

    @property
    def sentence(self) -> str:
        """For people."""
        where = f"in {self.variable}"
        if self.variable in ("target", "session"):
            where = f"of {self.variable} {self.label}"
        elif self.label:
            where = f"in the approach {self.label} of joint {self.variable.removeprefix('dir')}"
        elif self.variable.startswith(("q", "motor")):
            where += f" ({np.degrees(self.low):.4g} to {np.degrees(self.high):.4g} degrees)"
        else:
            where += f" ({self.low:.4g} to {self.high:.4g}, SI)"
        return (
            f"{int(self.rows.sum())} rows of {self.visits} visits lie as far off as outliers, but agree {where}: they "
            f"are not outliers and stay in the fit (by chance in {100 * self.p:.2g} % of clean tables)."
        )

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        span = {} if np.isnan(self.low) else {"low": self.low, "high": self.high}
        label = {"which": self.label} if self.label else {}
        count = int(self.rows.sum())
        return {"variable": self.variable, **span, **label, "p": self.p, "rows": count, "visits": self.visits}


def agreement(rows: Rows, bad: Bools, size: Array) -> list[Agreement]:
    """Which of the rows marked as outliers agree with each other, and in what; the clearest first.

    What has been found is set aside, and the rest looked at again.

    Parameters
    ----------
    rows, bad
        Of poses, and which of them ``(N,)`` would be rejected.
    size
        ``(N,)``: how far they are off. One that is much farther off than those it agrees with is wrong beside.
    """
    left = bad.copy()
    found: list[Agreement] = []
    while True:
        best = _clearest(rows, left)
        if best is None or best.p > AGREEING_FALSE_ALARMS:
            return found
        off = size[best.rows]
        mine = best.rows.copy()
        mine[np.flatnonzero(mine)[off > FARTHER * np.median(off)]] = False
        found.append(Agreement(mine, best.variable, best.low, best.high, best.label, best.p, best.visits))
        left &= ~best.rows


def _clearest(rows: Rows, bad: Bools) -> Agreement | None:
    """The variable or category in which marked rows agree most; None of too few."""
    known = rows.used.any(axis=1) | bad
    _, first, visit = np.unique(rows.unit[known], return_index=True, return_inverse=True)
    wrong = np.bincount(visit, bad[known], minlength=len(first)) > 0
    V, K = len(wrong), int(wrong.sum())
    if K < MIN_VISITS or K == V:
        return None
    at = np.flatnonzero(known)[first]
    found = []
    tests = 0
    for name, values in _variables(rows):
        x = values[at]
        if not np.ptp(x) > 0.0:
            continue
        tests += 1
        order = np.argsort(x, kind="stable")
        place = np.flatnonzero(wrong[order])
        ratio, i, j = _largest(place[None, :], V)
        if not ratio[0] > 0.0 or j[0] - i[0] + 1 < MIN_VISITS:
            continue
        null = _null(V, K)
        p = float((1 + np.sum(null >= ratio[0])) / (len(null) + 1))
        low, high = float(x[order[place[i[0]]]]), float(x[order[place[j[0]]]])
        # Of a visit its first row's value counts: targets of one visit lie in different places.
        inside = bad.copy()
        inside[known] &= (x[visit] >= low) & (x[visit] <= high)
        found.append(Agreement(inside, name, low, high, "", p, int(j[0] - i[0] + 1)))
    for name, label, member in _categories(rows):
        tests += 1
        row = member & known
        of = np.bincount(visit, row[known], minlength=V) > 0
        hit = np.bincount(visit, (bad & row)[known], minlength=V) > 0
        k = int(hit.sum())
        if k < MIN_VISITS or (of.all() and name != "target"):
            continue
        p = _of_target(rows, bad, member) if name == "target" else float(stats.hypergeom.sf(k - 1, V, K, int(of.sum())))
        found.append(Agreement(bad & member, name, float("nan"), float("nan"), label, p, k))
    if not found:
        return None
    best = min(found, key=lambda a: a.p)
    return Agreement(best.rows, best.variable, best.low, best.high, best.label, min(best.p * tests, 1.0), best.visits)


def _of_target(rows: Rows, bad: Bools, member: Bools) -> float:
    """Chance that so many of the rejected rows are of one target: targets share visits, so that rows are counted."""
    known = rows.used.any(axis=1) | bad
    k, K, n = int((bad & member).sum()), int(bad.sum()), int((member & known).sum())
    return float(stats.hypergeom.sf(k - 1, int(known.sum()), K, n))


def _variables(rows: Rows) -> Iterator[tuple[str, Array]]:
    """Recorded variables ``(N,)`` by name, angles within a turn."""
    s, turn = rows.signals, 2.0 * np.pi
    for j, joint in enumerate(rows.robot.joints):
        q = s["q"][:, j]
        yield f"q{j + 1}", q if joint.kind != "revolute" else np.remainder(q + np.pi, turn) - np.pi
        yield f"tau{j + 1}", s["gravity_torque"][:, j]
        if np.ptp(s["motor"][:, j]) > 2.0 * turn:  # else it says what the joint's angle says
            yield f"motor{j + 1}", np.remainder(s["motor"][:, j], turn)
        yield f"temp_link{j + 1}", s["link_temperature"][:, j]
        yield f"temp_motor{j + 1}", s["motor_temperature"][:, j]
    yield "time", s["elapsed"]
    for k, axis in enumerate("xyz"):
        yield axis, np.where(rows.ranged, np.nan, rows.measured[:, k]) if not rows.ranged.any() else np.zeros(len(rows))


def _categories(rows: Rows) -> Iterator[tuple[str, str, Bools]]:
    """Kinds of rows: name, which, and the rows ``(N,)``."""
    s = rows.signals
    for j in range(rows.robot.n):
        for side in (-1.0, 1.0):
            member = s["direction"][:, j] == side
            if member.any() and not member.all():
                yield f"dir{j + 1}", f"{side:+.0f}", member
    for k, name in enumerate(rows.layout.targets):
        member = s["target_is"][:, k] == 1.0
        if member.any() and not member.all():
            yield "target", name, member
    sessions = np.unique(rows.session)
    for number in sessions if len(sessions) > 1 else ():
        yield "session", rows.layout.sessions[int(number)], rows.session == number


def _counts(K: int) -> list[int]:
    """How many bad visits stretches hold that are tried: every number up to twelve, then every fourth part more."""
    out = list(range(MIN_VISITS, min(K, 12) + 1))
    while out and out[-1] < K:
        out.append(min(K, int(np.ceil(1.25 * out[-1]))))
    return out


def _largest(place: Array | Integers, V: int) -> tuple[Array, Integers, Integers]:
    """The largest logarithm of the likelihood ratio over stretches ``(D,)``, and its first and last bad visit.

    Parameters
    ----------
    place
        ``(D, K)``: where bad visits stand among the V, ascending.
    """
    D, K = place.shape
    best, first, last = np.zeros(D), np.zeros(D, dtype=np.int64), np.zeros(D, dtype=np.int64)
    whole = K * np.log(K / V) + special.xlogy(V - K, (V - K) / V)
    for k in _counts(K):
        width = place[:, k - 1 :] - place[:, : K - k + 1] + 1.0  # (D, K - k + 1)
        rest = V - width
        inside = special.xlogy(k, k / width) + special.xlogy(width - k, (width - k) / width)
        bad, good = K - k, rest - (K - k)
        safe = np.maximum(rest, 1.0)
        outside = special.xlogy(bad, bad / safe) + special.xlogy(good, np.maximum(good, 0.0) / safe)
        ratio = np.where(k / width > bad / safe, inside + outside - whole, 0.0)
        i = np.argmax(ratio, axis=1)
        value = ratio[np.arange(D), i]
        better = value > best
        best, first, last = np.where(better, value, best), np.where(better, i, first), np.where(better, i + k - 1, last)
    return best, first, last


@lru_cache(maxsize=256)
def _null(V: int, K: int) -> Array:
    """The same ``(NULL_DRAWS,)`` of K visits drawn at random from V."""
    rng = np.random.default_rng([V, K])
    out, step = [], max(1, NUMBERS_AT_ONCE // V)
    for start in range(0, NULL_DRAWS, step):
        count = min(step, NULL_DRAWS - start)
        drawn = np.argpartition(rng.random((count, V)), K - 1, axis=1)[:, :K] if K < V else np.arange(V)[None, :]
        out.append(_largest(np.sort(drawn, axis=1), V)[0])
    return np.concatenate(out)
