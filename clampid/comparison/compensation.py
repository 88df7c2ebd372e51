"""Detection of a controller's compensation of deflections, and of mistakes in it, from measured poses.

Poses are recorded with commanded joint values. The springs' twist, q_arm = q - C·tau, is in the points in full if
nothing compensates it, and not at all if the controller compensates it correctly. Factors on the deflection by the
arm's own weight and on that by the tool are fitted to the points (:mod:`clampid.comparison.deflections`). The pair of
factors identifies a mistake: it is 1 - 180/pi for a deflection that was multiplied by 180/pi, or (1, 0) if only the
tool's weight is compensated. If the base is the model's own, its shift is compared with the shift by which a base
absorbs the deflections in a fit without springs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import stats

from clampid.comparison.deflections import deflections_of, factors_with_covariance, fit_factors, shifted_table
from clampid.display import with_error
from clampid.identification.model_on_campaign import ModelOnCampaign
from clampid.role_slots import any_of_role
from clampid.roles import WEIGHTS
from clampid.stages.rows import Array
from clampid.stages.stage_kind import known_of

__all__ = ["Compensation", "compensation_of", "summary_prefix", "with_actual_joint_values"]

FALSE_REJECTIONS = 1e-3  # probability that a true explanation is rejected
DEFLECTION_SHARE = 0.5  # least squared cosine, in the metric of its errors, of a base shift to that by deflections
LARGEST_FACTOR_STD = 0.25  # a factor with a larger standard error is not identified by the poses
LEAST_FACTOR_STD = 1e-9  # a smaller one is rounding: no row depends on the factor, such as that of a massless tool
DEGREES = 180.0 / np.pi
LARGE_FACTOR = 5.0  # deflections times this: small errors of the model are then multiplied to above the noise
EXPLANATIONS: tuple[tuple[float, float, str], ...] = (
    (1.0, 1.0, ""),
    (0.0, 0.0, "the deflections are compensated in full"),
    (1.0, 0.0, "only the tool's weight is compensated: the arm's own weight is left out"),
    (0.0, 1.0, "only the arm's own weight is compensated: the tool's is left out"),
    (1.0 - DEGREES, 1.0 - DEGREES, "the compensation is multiplied by 180/pi: a deflection in degrees went out as rad"),
    (1.0, 1.0 - DEGREES,
     "the compensation is multiplied by 180/pi, and the arm's own weight is left out of it"),
    (2.0, 2.0, "the compensation has the wrong sign: it doubles the deflections"),
)  # fmt: skip
"""Factors on own weight and tool, and their meaning; the first is that of a campaign without any compensation."""
NO_MISTAKE = ("", EXPLANATIONS[1][2])


@dataclass(frozen=True)
class Compensation:
    """The share of the model's deflections in the poses, and what it means.

    Attributes
    ----------
    factors, covariance
        Factors on the deflections by the arm's own weight and by the tool ``(2,)``, and ``(2, 2)``. 1: in full,
        0: none.
    base, base_std
        Shift of the base from the model's, (w, v), ``(6,)``, rad and m, and its standard errors; None if the campaign
        has its own base.
    mistake
        The mistake in words; empty if there is none.
    said
        The finding in a sentence; empty if the deflections are in the poses in full.
    explained
        The factors of the reported explanation; None if none was reported.
    """

    factors: Array
    covariance: Array
    base: Array | None
    base_std: Array | None
    mistake: str
    said: str
    explained: tuple[float, float] | None

    def to_json(self) -> dict[str, Any]:
        """The finding for JSON."""
        std = np.sqrt(np.diag(self.covariance))
        return {
            "own_weight": {"factor": float(self.factors[0]), "std": float(std[0])},
            "tool": {"factor": float(self.factors[1]), "std": float(std[1])},
            "base": None if self.base is None else self.base.tolist(),
            "base_std": None if self.base_std is None else self.base_std.tolist(),
            "mistake": self.mistake or None,
            "summary": self.said,
        }


def summary_prefix(found: Compensation) -> str:
    """Sentences for people before the diagnosis of a campaign :func:`with_actual_joint_values`."""
    said = "With the joint values that the compensation commanded:"
    times = max(abs(factor - 1.0) for factor in found.explained or (1.0,))
    if times > LARGE_FACTOR:
        said = (
            f"The mistake multiplies errors of springs and weights by {times:.0f}; effects named below may be due to "
            f"that. Correct the compensation and measure again. {said}"
        )
    return said


def compensation_of(opened: ModelOnCampaign) -> Compensation | None:
    """Search a campaign's poses for a compensation of deflections, and for mistakes in it.

    Returns
    -------
    Compensation or None
        None if there are no poses, the model has no springs there, nothing is deflected, or the arm's masses are
        unknown.
    """
    model = known_of(opened.stages, "points")
    if (
        model is None
        or "poses" not in opened.campaign.tables
        or not any_of_role(model.slots, "compliance", effects=opened.effects)
    ):
        return None
    if not opened.campaign.robot.has_masses and not any_of_role(
        model.slots, *WEIGHTS, per="link", effects=opened.effects
    ):
        return None
    trial = opened.fit_problem("poses", opened.rows("poses").points)
    deflections = deflections_of(opened, trial)
    if not np.any(deflections.parts):
        return None
    fitted = factors_with_covariance(opened, trial, deflections)
    if not np.isfinite(fitted.theta).all():
        return None
    factors, spread = 1.0 + fitted.theta[:2], fitted.covariance[:2, :2]
    mistake = _explained(factors, spread)
    said = _in_words(factors, spread, mistake)
    explained = next(((own, tool) for own, tool, words in EXPLANATIONS if said and words == mistake), None)
    base = base_std = None
    if opened.session is not None:
        base, base_std = fitted.theta[2:8], np.sqrt(np.diag(fitted.covariance)[2:8])
        biased = "" if mistake else _deflection_like_shift(base, fitted.covariance[2:8, 2:8], fitted.columns)
        if biased:
            mistake = "the base frame is biased by deflection"
            said = f"The base frame differs {biased}: {mistake}, as in a model that was fitted without springs."
    wrong = "" if mistake is None or mistake in NO_MISTAKE else mistake
    return Compensation(factors, spread, base, base_std, wrong, said, explained)


def with_actual_joint_values(opened: ModelOnCampaign, found: Compensation) -> ModelOnCampaign | None:
    """The campaign with the joint values that its compensation commanded, instead of the recorded ones.

    The factors are exactly those of the reported explanation. Springs are fitted to the poses within their covariance
    in the model, since a large factor multiplies their small errors. None if no compensation explains the poses, or if
    there are distances too, whose commanded joint values are then unknown.
    """
    if found.explained is None or "distances" in opened.campaign.tables:
        return None
    less = np.array(found.explained) - 1.0
    tables, rows = dict(opened.campaign.tables), opened.rows("poses")
    trial = opened.fit_problem("poses", rows)
    deflections = deflections_of(opened, trial)
    springs = fit_factors(
        opened,
        trial,
        np.einsum("p,pkni->kni", less, deflections.parts),
        np.ones(deflections.parts.shape[1]),
        deflections.covariance,
    ).theta[: deflections.parts.shape[1]]
    tables["poses"] = shifted_table(tables["poses"], np.einsum("p,k,pkni->ni", less, springs, deflections.parts))
    others = opened.verification()
    if others is not None:
        parts = deflections_of(opened, opened.fit_problem("poses", others)).parts
        tables["verification"] = shifted_table(tables["verification"], np.einsum("p,k,pkni->ni", less, springs, parts))
    campaign = replace(opened.campaign, tables=tables)
    return replace(opened, campaigns=(campaign,), base={0: rows.pose.base_reference[0]})


def _explained(factors: Array, covariance: Array) -> str | None:
    """The likeliest explanation that the factors do not reject, in words; empty for no compensation; None if none."""
    distance = []
    for own, tool, _ in EXPLANATIONS:
        off = factors - np.array([own, tool])
        distance.append(float(off @ np.linalg.pinv(covariance, hermitian=True) @ off))
    limit = float(stats.chi2.isf(FALSE_REJECTIONS, 2))
    if distance[0] <= limit:
        return ""  # the factors agree with no compensation
    best = int(np.argmin(distance))
    return EXPLANATIONS[best][2] if distance[best] <= limit else None


def _in_words(factors: Array, covariance: Array, mistake: str | None) -> str:
    """A sentence on the factors; empty if nothing is compensated, or if the factors are not identified."""
    std = np.sqrt(np.diag(covariance))
    if mistake == "" or std[0] > LARGEST_FACTOR_STD * max(1.0, abs(float(factors[0] - 1.0))):
        return ""
    what = mistake or "no known mistake of a compensation explains this"
    arm, tool = (with_error(float(f), float(s), "") for f, s in zip(factors, std, strict=True))
    known = LEAST_FACTOR_STD < std[1] <= LARGEST_FACTOR_STD * max(1.0, abs(float(factors[1] - 1.0)))
    by_tool = f" and {tool} times those by the tool's" if known else ""
    return (
        f"The measured deflections are {arm} times the modelled ones by the arm's weight{by_tool} "
        f"(1 without compensation, 0 with it): {what}."
    )


def _deflection_like_shift(base: Array, covariance: Array, columns: Array) -> str:
    """The shift of a base in words, if it is like the shift by which a base absorbs deflections; else empty.

    Parameters
    ----------
    base, covariance
        Shift ``(6,)``, (w, v), rad and m, and its covariance ``(6, 6)``.
    columns
        Derivatives of the points as in :class:`FactorFit`.
    """
    flat = columns.reshape(-1, columns.shape[2])
    scale = np.linalg.norm(flat[:, 2:], axis=0)
    scale[scale == 0.0] = 1.0
    taken = (np.linalg.lstsq(flat[:, 2:] / scale, flat[:, 0] + flat[:, 1], rcond=1e-10)[0] / scale)[:6]
    weight = np.linalg.pinv(covariance, rcond=1e-14, hermitian=True)
    size, whole, along = base @ weight @ base, taken @ weight @ taken, base @ weight @ taken
    if size <= stats.chi2.isf(FALSE_REJECTIONS, 6) or along >= 0.0 or along**2 < DEFLECTION_SHARE * size * whole:
        return ""
    std = np.sqrt(np.diag(covariance))
    shift = with_error(float(np.linalg.norm(base[3:])), float(np.linalg.norm(std[3:])), "m")
    turn = with_error(float(np.linalg.norm(base[:3])), float(np.linalg.norm(std[:3])), "rad")
    return f"from the model's by {shift} and {turn}, as if it had absorbed the deflections"
