"""Where the base is in a cell, from features that a known tip has touched, less what the arm's weight bends.

Where the tip is for the robot follows from the joint angles and a model of the arm: its links, springs, clearances and
loads. A model that was fitted to points knows where its targets are and not where the flange is, and its last link may
be off by as much: a tip with the name of one of its targets is where the model has it, and another one where it was
declared, to within the standard error that was stated with it. The touches then say where the base must be, see
:mod:`clampid.base_frames.touches`. The share of each source of error in the result is given, and how far off the base
would be if nothing were put back.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from clampid.base_frames.touches import Touches, descend, starts_of, touches_of
from clampid.base_frames.yielding import Yielding, gives_way, what_yields
from clampid.fitting.noise import MAD_TO_STD
from clampid.models.model import Model, ModelError
from clampid.models.own_effects import effects_of
from clampid.role_slots import has_role
from clampid.stages.layout import layout_of
from clampid.stages.pose_rows import pose_rows
from clampid.stages.rows import Array, Integers
from experiments.touched import Touched
from kinematics.poe import forward
from kinematics.screws import inverse, log_se3

__all__ = ["TouchedFrame", "base_from_touches"]

OUTLIER_DEVIATIONS = 6.0  # robust standard deviations beyond which a touch is wrong
MOST_WRONG = 0.1  # of the touches: more are no errors of single ones, and none is left out
WEIGHTING_ROUNDS = 3  # how errors are weighed depends on the base a little


@dataclass(frozen=True)
class TouchedFrame:
    """A base frame from touches.

    Attributes
    ----------
    base
        ``(4, 4)``: the base in the cell's frame.
    covariance
        ``(6, 6)``: of its small motion in its own axes, (w, v), rad and m.
    sources
        Standard errors ``(6,)`` that touches, features, tip and arm each have in it, before ``scale``.
    bias
        ``(6,)``: where the base would stand if the arm were nominal and stiff, seen from ``base``, (w, v).
    put_back
        m, the largest way from the nominal stiff arm to the model's.
    rms
        m, of the misfits.
    chi2, freedom
        Of the misfits against what they should be, and of how many numbers.
    scale
        By how much the covariance was raised: chi2 / freedom, where that is above 1.
    features
        Name → touches that counted and their rms, m.
    outliers
        Touches, rows of the table from 1, that were left out.
    arm
        Where links and springs are from, in words.
    """

    base: Array
    covariance: Array
    sources: Mapping[str, Array]
    bias: Array
    put_back: float
    rms: float
    chi2: float
    freedom: int
    scale: float
    features: Mapping[str, tuple[int, float]]
    outliers: tuple[int, ...]
    arm: str

    @property
    def std(self) -> Array:
        """Standard errors ``(6,)`` of the base's motion in its own axes, (w, v)."""
        return np.sqrt(np.diag(self.covariance))

    def interval(self, level: float = 0.95) -> Array:
        """Half widths ``(6,)`` of intervals: normal, or Student's where the covariance was raised by the misfits."""
        tail = (1 - level) / 2
        quantile = stats.t.isf(tail, self.freedom) if self.scale > 1.0 else stats.norm.isf(tail)
        return np.asarray(self.std * quantile)

    def to_json(self) -> dict[str, Any]:
        """For programs; SI."""
        return {
            "base": self.base.tolist(),
            "std_w_v": self.std.tolist(),
            "interval95_w_v": self.interval().tolist(),
            "sources_std_w_v": {name: std.tolist() for name, std in self.sources.items()},
            "uncorrected_w_v": self.bias.tolist(),
            "largest_put_back_m": self.put_back,
            "arm": self.arm,
            "rms_m": self.rms,
            "chi2": self.chi2,
            "degrees_of_freedom": self.freedom,
            "covariance_raised_by": self.scale,
            "features": {name: {"touches": n, "rms_m": rms} for name, (n, rms) in self.features.items()},
            "outliers": list(self.outliers),
        }


def base_from_touches(
    touched: Touched, model: Model | None = None, *, rigid: bool = False, user_effects: Path | None = None
) -> TouchedFrame:
    """The base frame from touches.

    Parameters
    ----------
    model
        Whose links, springs, clearances and loads say where the tip is: those of its stage ``poses``; without springs
        there, springs of ``clamped`` and loads of ``free_air`` on nominal links. Without a model, nominal links with
        the springs and masses of the robot's description, taken as exact.
    rigid
        The nominal arm, stiff.

    Raises
    ------
    CampaignError
        The touches do not determine the base; the message names the motions that they leave open.
    ModelError
        Nothing is known of springs or weights, or the model is of another robot.
    """
    campaign = touched.campaign
    if model is not None and model.robot != campaign.robot.name:
        raise ModelError(f"the model is of the robot {model.robot}, the touches of {campaign.robot.name}")
    effects = effects_of(model, user_effects)
    layout = layout_of([campaign])
    yielding = what_yields(campaign.robot, model, rigid=rigid, tips=layout.targets)
    rows = pose_rows([campaign], layout, "poses", {0: np.eye(4)})
    chain_q = rows.signals["q"] @ np.asarray(campaign.robot.linkage).T
    pose = forward(campaign.robot.screws, campaign.robot.flange, chain_q)
    stiff = np.einsum("nij,nj->ni", pose[:, :3, :3], rows.pose.target) + pose[:, :3, 3]
    way, by = (np.zeros_like(stiff), np.zeros((*stiff.shape, 0))) if rigid else gives_way(rows, effects, yielding)
    sigma = float(campaign.instrument.position_std or 0.0)
    everything = touches_of(touched, stiff + way)
    shared = _Shared(touched, by, yielding.covariance, pose[:, :3, :3], sigma)
    fitted, kept = _fitted(everything, shared, touched.start)
    plain, _ = descend(touches_of(touched, stiff).take(kept), fitted.base)
    counts = {}
    for k, feature in enumerate(touched.features):
        mine = fitted.misfit[touched.feature[kept][fitted.touches.touch] == k]
        if len(mine):
            counts[feature.name] = (int(np.sum(touched.feature[kept] == k)), float(np.sqrt(np.mean(mine**2))))
    freedom = len(fitted.misfit) - 6
    scale = max(fitted.chi2 / freedom, 1.0) if freedom > 0 else 1.0
    return TouchedFrame(
        base=fitted.base,
        covariance=scale * fitted.covariance,
        sources=fitted.sources(shared, kept),
        bias=log_se3(inverse(fitted.base) @ plain),
        put_back=float(np.linalg.norm(way, axis=1).max()),
        rms=float(np.sqrt(np.mean(fitted.misfit**2))),
        chi2=fitted.chi2,
        freedom=freedom,
        scale=scale,
        features=counts,
        outliers=tuple(int(k) + 1 for k in np.setdiff1d(np.arange(len(rows)), kept)),
        arm="nominal and stiff; the frame is biased by deflection and by the links" if rigid else _said(yielding),
    )


def _said(yielding: Yielding) -> str:
    known = dict.fromkeys(s.place for s in yielding.slots if has_role(s, "target_point"))
    where = f"where the model has {', '.join(known)}" if known else "where it was declared"
    return f"{yielding.said}; the tip is {where}"


@dataclass(frozen=True)
class _Shared:
    """What touches have errors of: themselves, their feature's place, the tip's place, the model of the arm."""

    touched: Touched
    by: Array  # (N, 3, P), how the tip's middle follows the model's parameters, base frame
    spread: Array  # (P, P)
    turned: Array  # (N, 3, 3), flange to base
    sigma: float

    def parts(self, touches: Touches, along: Array, base: Array, kept: Integers) -> dict[str, Array]:
        """Covariance ``(m, m)``, m², of the misfits by each source."""
        of = kept[touches.touch]
        out = {"touches": self.sigma**2 * np.eye(len(of))}
        feature = self.touched.feature[of]
        same = (feature[:, None] == feature[None]).astype(float)
        std = np.array([f.std for f in self.touched.features])[feature]
        out["features"] = same * (along @ along.T) * np.outer(std, std)
        own = along @ base[:3, :3]
        tip = self.touched.tip_std * np.einsum("mi,mij->mj", own, self.turned[of])
        names = self.touched.campaign.tables["poses"]["target"].astype(str).to_numpy()[of]
        out["tip"] = (names[:, None] == names[None]).astype(float) * (tip @ tip.T)
        arm = np.einsum("mi,mip->mp", own, self.by[of])
        out["arm"] = arm @ self.spread @ arm.T
        return out


@dataclass(frozen=True)
class _Fitted:
    touches: Touches
    base: Array
    misfit: Array
    chi2: float
    gain: Array  # (6, m), how the base follows the misfits
    covariance: Array

    def sources(self, shared: _Shared, kept: Integers) -> dict[str, Array]:
        """Standard errors ``(6,)`` of the base by each source."""
        parts = shared.parts(self.touches, self.touches.misfit(self.base)[1], self.base, kept)
        return {name: np.sqrt(np.einsum("im,mn,in->i", self.gain, V, self.gain)) for name, V in parts.items()}


def _fitted(touches: Touches, shared: _Shared, start: Array | None) -> tuple[_Fitted, Integers]:
    """The weighed fit, touches far off left out one by one, the worst first; and which are kept."""
    count = len(touches.kind)
    base = starts_of(touches, start, shared.sigma)
    kept = np.arange(count)
    first = _weighed(touches, shared, base, kept)
    fitted = first
    while True:
        spread = np.sqrt(np.diag(sum(shared.parts(fitted.touches, *_lines(fitted), kept).values())))
        size = np.abs(fitted.misfit) / spread
        limit = OUTLIER_DEVIATIONS * max(MAD_TO_STD * float(np.median(size)), 1.0)
        worst = int(np.argmax(size))
        if size[worst] <= limit:
            return fitted, kept
        left = np.delete(kept, fitted.touches.touch[worst])
        if count - len(left) > MOST_WRONG * count:
            return first, np.arange(count)
        kept = left
        fitted = _weighed(touches.take(kept), shared, fitted.base, kept)


def _lines(fitted: _Fitted) -> tuple[Array, Array]:
    return fitted.touches.misfit(fitted.base)[1], fitted.base


def _weighed(touches: Touches, shared: _Shared, base: Array, kept: Integers) -> _Fitted:
    chi2, V = 0.0, np.eye(len(touches.touch))
    for _ in range(WEIGHTING_ROUNDS):
        V = np.asarray(sum(shared.parts(touches, touches.misfit(base)[1], base, kept).values()))
        base, chi2 = descend(touches, base, V)
    misfit, along = touches.misfit(base)
    J = touches.jacobian(base, along)
    weighed = np.linalg.solve(V, J)
    covariance = np.linalg.inv(J.T @ weighed)
    return _Fitted(touches, base, misfit, chi2, -covariance @ weighed.T, 0.5 * (covariance + covariance.T))
