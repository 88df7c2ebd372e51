"""Metrics of ISO 9283 over a table of poses, with their uncertainty from few returns.

ISO 9283 has thirty returns to each of five poses. A calibration has many poses and two or three returns, so these
are given beside the standard's formulas:

* an interval for the mean over such poses (Student's t over poses; targets of one pose are averaged first),
* the AP, vAP or drift that the returns' scatter alone would give: the formula's mean over normal errors with the pooled
  covariance, at the same numbers of returns,
* RP as thirty returns would give it. Two returns are equally far from their mean, so S_l is 0 and RP a third of the
  value from thirty. With the pooled covariance Σ of N(0, Σ), E l is (1/√π) ∫ (1 − Π (1 + 2 λ_i s²)^(-1/2)) / s² ds over
  its eigenvalues, and E l² its trace; the interval is that of the trace, chi-square with Satterthwaite's degrees of
  freedom. It holds if the scatter is normal and the same at all places.

Source: the formulas are in :mod:`experiments.measures.metrics`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
import numpy.typing as npt
from scipy import integrate, stats

from experiments.measures.metrics import (
    accuracy,
    angle_accuracy,
    angle_repeatability,
    angle_variation,
    drift,
    repeatability,
    variation,
)

__all__ = ["MEANING", "WANTED", "Metric", "PoseMetrics", "Repeatability", "expected_repeatability", "pose_metrics"]

Array = npt.NDArray[np.float64]
Labels = npt.NDArray[np.int64]
Kind = Literal["position", "orientation"]
WANTED = 30  # returns to a pose that ISO 9283 asks for
FEWEST_FOR_DRP = 4  # returns: two early and two late
SCATTER_DRAWS = 200  # of what scatter alone would show: its mean to some per cent
CONFIDENCE = 0.95
MEANING = {
    "AP": "pose accuracy",
    "RP": "pose repeatability, from one side",
    "RP_bidirectional": "pose repeatability, from all sides together",
    "vAP": "variation with the side of approach",
    "dAP": "drift of the pose accuracy",
    "dRP": "drift of the pose repeatability, later returns against earlier ones",
}


@dataclass(frozen=True)
class Metric:
    """One metric over several places.

    Attributes
    ----------
    places, poses
        How many pairs of pose and target (and side, where the metric is of one) have it, and how many poses these are.
    returns
        The fewest and the most at one of them.
    mean, maximum
        m; rad of orientations, of the worst axis at each place.
    interval
        95 % of the mean over such poses, or None of a single one.
    by_scatter
        Mean that the returns' scatter alone would give; None if it is unknown, and for RP, which is the scatter.
    axes
        Means about x, y and z, rad; None of positions.
    """

    places: int
    poses: int
    returns: tuple[int, int]
    mean: float
    maximum: float
    interval: tuple[float, float] | None
    by_scatter: float | None
    axes: tuple[float, float, float] | None = None

    def to_json(self) -> dict[str, object]:
        """For programs."""
        data: dict[str, object] = {
            "places": self.places, "poses": self.poses, "returns": list(self.returns), "mean": self.mean,
            "max": self.maximum, "interval95": None if self.interval is None else list(self.interval),
            "by_scatter": self.by_scatter,
        }  # fmt: skip
        return data if self.axes is None else {**data, "axes": list(self.axes)}


@dataclass(frozen=True)
class Repeatability:
    """RP as thirty returns would show it, with its 95 % interval and degrees of freedom; m or rad."""

    value: float
    interval: tuple[float, float]
    freedom: float

    def to_json(self) -> dict[str, object]:
        """For programs."""
        return {"value": self.value, "interval95": list(self.interval), "degrees_of_freedom": self.freedom}


@dataclass(frozen=True)
class PoseMetrics:
    """Metrics of a table of poses.

    Attributes
    ----------
    metrics
        Name → metric, those of :data:`MEANING` that there are.
    missing
        Name → why it is not determinable.
    thirty
        RP from one side as thirty returns would show it, or None.
    span
        s, the longest time between returns to one place from one side.
    """

    metrics: dict[str, Metric]
    missing: dict[str, str]
    thirty: Repeatability | None
    span: float

    def to_json(self) -> dict[str, object]:
        """For programs: the metrics by name, ``RP_of_30``, ``span_s``, ``not_determinable``."""
        data: dict[str, object] = {name: metric.to_json() for name, metric in self.metrics.items()}
        if self.thirty is not None:
            data["RP_of_30"] = self.thirty.to_json()
        return data | {"span_s": self.span, "not_determinable": self.missing}


@dataclass(frozen=True)
class _Place:
    """One target at one pose: its rows side by side, each side's in the order of time."""

    pose: int
    sides: tuple[Labels, ...]


def pose_metrics(
    error: Array, place: Labels, pose: Labels, side: Labels, time: Array, kind: Kind = "position"
) -> PoseMetrics:
    """Metrics over a table.

    Parameters
    ----------
    error
        ``(n, 3)``: attained position less the commanded one, m, or small rotation vectors, rad, about axes of one
        frame. A command is the same for all returns to its place.
    place, pose
        ``(n,)``: which pose and target, and which pose.
    side
        ``(n,)``: from which side it was approached; negative where that is not known. If none is known, all returns
        count as from one side.
    time
        ``(n,)`` s.
    """
    sided = bool((side >= 0).any())
    places = _places(place, pose, side if sided else np.zeros_like(side), time)
    groups = [group for one in places for group in one.sides if len(group) > 1]
    spread = _pooled(error, groups)
    values: dict[str, list[tuple[int, int, Array]]] = {}
    alone: dict[str, list[float]] = {}
    rng = np.random.default_rng(0)
    for one in places:
        for name, count, value in _at(error, one.sides, kind):
            values.setdefault(name, []).append((one.pose, count, value))
        if spread is None:
            continue
        drawn = spread.draw(SCATTER_DRAWS, sum(len(s) for s in one.sides), rng)
        ends = np.cumsum([0, *(len(s) for s in one.sides)])
        own = tuple(np.arange(a, b) for a, b in pairwise(ends))
        for name, _, value in _at(drawn, own, kind):
            worst = value if kind == "position" else value.max(axis=-1)
            alone.setdefault(name, []).append(float(worst.mean()))
    metrics = {name: _metric(values[name], alone.get(name), name, kind) for name in MEANING if name in values}
    return PoseMetrics(
        metrics,
        {name: reason for name in MEANING if name not in metrics and (reason := _why_not(name, places, sided))},
        None if spread is None else _of_thirty(spread, _freedom(places), kind),
        max((float(np.ptp(time[group])) for group in groups), default=0.0),
    )


def _places(place: Labels, pose: Labels, side: Labels, time: Array) -> list[_Place]:
    order = np.lexsort((time, side, place))
    order = order[side[order] >= 0]
    out = []
    for here in np.split(order, np.flatnonzero(np.diff(place[order])) + 1):
        if len(here):
            sides = np.split(here, np.flatnonzero(np.diff(side[here])) + 1)
            out.append(_Place(int(pose[here[0]]), tuple(sides)))
    return out


def _at(error: Array, sides: Sequence[Labels], kind: Kind) -> Iterator[tuple[str, int, Array]]:
    """Each metric of one place: its name, of how many returns it is, and its value ``(...)``, about axes ``(..., 3)``.

    ``error`` ``(..., n, 3)``.
    """
    position, zero = kind == "position", np.zeros(3)
    parts = [error[..., group, :] for group in sides]
    if len(parts) > 1:
        together = np.concatenate(parts, axis=-2)
        yield "vAP", together.shape[-2], variation(parts) if position else angle_variation(parts)
        yield "RP_bidirectional", together.shape[-2], _spread(together, position)
    for part in parts:
        count = part.shape[-2]
        if count < 2:
            continue
        yield "AP", count, accuracy(part, zero) if position else angle_accuracy(part, zero)
        yield "RP", count, _spread(part, position)
        cycles = [part[..., k : k + 1, :] for k in range(count)]
        yield "dAP", count, drift(cycles, zero)[0] if position else _angle_drift(cycles)
        if count >= FEWEST_FOR_DRP:
            halves = part[..., : count // 2, :], part[..., count // 2 :, :]
            d_rp = drift(halves, zero)[1] if position else np.abs(np.subtract(*(_spread(h, False) for h in halves)))
            yield "dRP", count, d_rp


def _spread(part: Array, position: bool) -> Array:
    return repeatability(part) if position else angle_repeatability(part)


def _angle_drift(cycles: Sequence[Array]) -> Array:
    accuracies = np.array([angle_accuracy(cycle, np.zeros(3)) for cycle in cycles])
    return np.asarray(np.abs(accuracies - accuracies[0]).max(axis=0))


def _metric(values: list[tuple[int, int, Array]], alone: list[float] | None, name: str, kind: Kind) -> Metric:
    pose = np.array([p for p, _, _ in values])
    returns = [count for _, count, _ in values]
    found = np.array([value for _, _, value in values])
    worst = found if kind == "position" else found.max(axis=1)
    numbers = np.unique(pose)
    by_pose = np.array([worst[pose == p].mean() for p in numbers])
    interval = None
    if len(by_pose) > 1:
        middle, error = float(by_pose.mean()), float(by_pose.std(ddof=1) / np.sqrt(len(by_pose)))
        half = error * float(stats.t.isf((1 - CONFIDENCE) / 2, len(by_pose) - 1))
        interval = max(middle - half, 0.0), middle + half
    axes = None
    if kind == "orientation":
        x, y, z = (float(v) for v in found.mean(axis=0))
        axes = x, y, z
    by_scatter = None if alone is None or name.startswith("RP") else float(np.mean(alone))
    return Metric(
        len(values), len(numbers), (min(returns), max(returns)), float(by_pose.mean()), float(worst.max()), interval,
        by_scatter, axes,
    )  # fmt: skip


def _why_not(name: str, places: Sequence[_Place], sided: bool) -> str:
    if all(sum(len(s) for s in one.sides) < 2 for one in places):
        return "no pose was visited twice"
    if name in ("vAP", "RP_bidirectional"):
        if not sided:
            return "the table does not say from which side poses were approached"
        return "no pose was visited from two sides"
    return f"no pose was visited {'four times' if name == 'dRP' else 'twice'} from the same side"


@dataclass(frozen=True)
class _Scatter:
    """Pooled covariance of returns about their barycentres ``(3, 3)``."""

    covariance: Array

    def draw(self, draws: int, count: int, rng: np.random.Generator) -> Array:
        """Errors ``(draws, count, 3)`` that have it."""
        size, turn = np.linalg.eigh(self.covariance)
        return np.asarray(rng.standard_normal((draws, count, 3)) * np.sqrt(np.maximum(size, 0.0)) @ turn.T)


def _pooled(error: Array, groups: Sequence[Labels]) -> _Scatter | None:
    if not groups:
        return None
    total, freedom = np.zeros((3, 3)), 0
    for group in groups:
        off = error[group] - error[group].mean(axis=0)
        total += off.T @ off
        freedom += len(group) - 1
    return _Scatter(total / freedom)


def _freedom(places: Sequence[_Place]) -> int:
    """Degrees of freedom of the returns; targets of one pose, which share where the robot has stopped, count once."""
    most: dict[int, int] = {}
    for one in places:
        most[one.pose] = max(most.get(one.pose, 0), sum(len(group) - 1 for group in one.sides))
    return sum(most.values())


def _of_thirty(spread: _Scatter, freedom: int, kind: Kind) -> Repeatability:
    if kind == "orientation":  # of one axis S² is chi-square
        value, own = 3 * float(np.sqrt(np.diag(spread.covariance).max())), float(freedom)
    else:
        value = expected_repeatability(spread.covariance)
        if value == 0.0:
            return Repeatability(0.0, (0.0, 0.0), float(freedom))
        own = freedom * np.trace(spread.covariance) ** 2 / float(np.sum(spread.covariance**2))
    low, high = (float(np.sqrt(own / stats.chi2.ppf(p, own))) for p in ((1 + CONFIDENCE) / 2, (1 - CONFIDENCE) / 2))
    return Repeatability(value, (value * low, value * high), own)


def expected_repeatability(covariance: Array) -> float:
    """RP, m, that thirty returns show on average whose positions are normal with a covariance ``(3, 3)``, m²."""
    size = np.maximum(np.linalg.eigvalsh(covariance), 0.0)
    trace = float(size.sum())
    if trace == 0.0:
        return 0.0
    mean = _mean_length(size / trace)
    share = (WANTED - 1) / WANTED  # of a return's variance is about the returns' own middle
    return float(np.sqrt(share * trace) * (mean + 3 * np.sqrt(max(1.0 - mean**2, 0.0))))


def _mean_length(variances: Array) -> float:
    """Mean length of a normal vector with these variances ``(3,)`` along its axes, which sum to 1."""

    def integrand(s: float) -> float:
        return float((1.0 - np.prod(1.0 + 2.0 * variances * s**2) ** -0.5) / s**2)

    near, far = (integrate.quad(integrand, *ends)[0] for ends in ((1e-6, 1.0), (1.0, np.inf)))
    return float((near + far) / np.sqrt(np.pi))
