"""Rows that look like outliers but cluster in a recorded variable: a missing effect, not wrong measurements.

Wrong measurements occur anywhere. If the rows that a fit would reject cluster in a recorded variable (an angle, a load,
a temperature, the time, a place), or belong to one target, direction or session, then something that these rows share
has moved them. They agree, and are not rejected: no row is dropped for what a model lacks.

Null hypothesis: the K visits with rows to be rejected ("bad" visits) are a random sample of all V visits. The visits
are sorted by the variable. For every stretch from one bad visit to another, the likelihood ratio for more bad visits
inside than outside is computed; the largest one is compared with those of K visits drawn at random. For categories the
hypergeometric tail is used. The chance of a false agreement is :data:`AGREEING_FALSE_ALARMS` over all variables
(Bonferroni). Source: Kulldorff, A spatial scan statistic, Communications in Statistics 26, 1997. Visits are counted,
not rows, because one cause may move all points of a visit.
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

# Chance that rejected rows of a clean table are reported as agreeing; the same as that of any rejection.
AGREEING_FALSE_ALARMS = 0.01
MIN_VISITS = 4  # visits that agree: fewer could be fitted exactly by a height, a middle and a width
NULL_DRAWS = 9999
NUMBERS_AT_ONCE = 2_000_000  # random numbers in memory at once
WRONG_AMONG_AGREEING = 4.0  # times the median size of agreeing rows: a row farther off is an outlier nevertheless


@dataclass(frozen=True)
class Agreement:
    """Rows that cluster in a variable or a category.

    Attributes
    ----------
    rows
        ``(N,)``: which rows.
    variable
        Name of the column without its unit, or ``target`` or ``session``.
    low, high
        Range of the variable, SI; NaN for a category.
    label
        Which target, session or direction; empty for a variable.
    p
        p-value of the agreement, corrected for all variables.
    visits
        Number of visits among these rows.
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
        """What was found, as a sentence."""
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
        """For JSON; SI."""
        span = {} if np.isnan(self.low) else {"low": self.low, "high": self.high}
        label = {"which": self.label} if self.label else {}
        count = int(self.rows.sum())
        return {"variable": self.variable, **span, **label, "p": self.p, "rows": count, "visits": self.visits}


def agreement(rows: Rows, bad: Bools, size: Array) -> list[Agreement]:
    """Which of the rows marked as outliers agree with each other, and in which variable; smallest p-value first.

    Agreeing rows are set aside, and the search is repeated on the others.

    Parameters
    ----------
    rows
        Rows of poses.
    bad
        ``(N,)``: which of them would be rejected.
    size
        ``(N,)``: size of their errors. A row much farther off than those it agrees with stays an outlier.
    """
    left = bad.copy()
    found: list[Agreement] = []
    while True:
        best = _clearest(rows, left)
        if best is None or best.p > AGREEING_FALSE_ALARMS:
            return found
        off = size[best.rows]
        mine = best.rows.copy()
        mine[np.flatnonzero(mine)[off > WRONG_AMONG_AGREEING * np.median(off)]] = False
        found.append(Agreement(mine, best.variable, best.low, best.high, best.label, best.p, best.visits))
        left &= ~best.rows


def _clearest(rows: Rows, bad: Bools) -> Agreement | None:
    """The variable or category with the smallest p-value; None if too few visits are marked."""
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
        # The first row of a visit gives its value: targets of one visit lie in different places.
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
    """p-value of so many rejected rows of one target. Rows are counted here, because targets share visits."""
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
        if np.ptp(s["motor"][:, j]) > 2.0 * turn:  # else it orders rows as the joint's angle does
            yield f"motor{j + 1}", np.remainder(s["motor"][:, j], turn)
        yield f"temp_link{j + 1}", s["link_temperature"][:, j]
        yield f"temp_motor{j + 1}", s["motor_temperature"][:, j]
    yield "time", s["elapsed"]
    for k, axis in enumerate("xyz"):
        yield axis, np.where(rows.ranged, np.nan, rows.measured[:, k]) if not rows.ranged.any() else np.zeros(len(rows))


def _categories(rows: Rows) -> Iterator[tuple[str, str, Bools]]:
    """Categories of rows: name, label, and which rows ``(N,)``."""
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
    """Numbers of bad visits in the stretches that are tried: every number up to twelve, then in steps of a quarter."""
    out = list(range(MIN_VISITS, min(K, 12) + 1))
    while out and out[-1] < K:
        out.append(min(K, int(np.ceil(1.25 * out[-1]))))
    return out


def _largest(place: Array | Integers, V: int) -> tuple[Array, Integers, Integers]:
    """The largest log likelihood ratio over stretches ``(D,)``, and the first and last bad visit of that stretch.

    Parameters
    ----------
    place
        ``(D, K)``: positions of the bad visits among the V sorted ones, ascending; one line for each draw.
    V
        Number of visits.
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
    """Largest log likelihood ratios ``(NULL_DRAWS,)`` under the null: K visits drawn at random from V."""
    rng = np.random.default_rng([V, K])
    out, step = [], max(1, NUMBERS_AT_ONCE // V)
    for start in range(0, NULL_DRAWS, step):
        count = min(step, NULL_DRAWS - start)
        drawn = np.argpartition(rng.random((count, V)), K - 1, axis=1)[:, :K] if K < V else np.arange(V)[None, :]
        out.append(_largest(np.sort(drawn, axis=1), V)[0])
    return np.concatenate(out)
