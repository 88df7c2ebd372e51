"""The result of the diagnosis of one stage, in the form of the contract."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from clampid.diagnosis.candidate_scores import CandidateScores
from clampid.diagnosis.folds import Folds
from clampid.diagnosis.next_measurement import NextPlan, NextPoses
from clampid.diagnosis.remains import Remains
from clampid.diagnosis.residual_excess import OneSided
from clampid.effect import Stage
from clampid.fitting.agreeing import Agreement
from clampid.identification.fitted_stage import FittedStage
from clampid.slots import Term

__all__ = ["StageDiagnosis", "Step", "Verdict"]

Verdict = Literal["adequate", "missing", "ambiguous", "unknown"]


@dataclass(frozen=True)
class Step:
    """Terms that are added to a stage together.

    Attributes
    ----------
    terms
        One effect, at several places if these were tried and confirmed together.
    evidence
        For the ledger, with the names of a candidate of :class:`StageDiagnosis`.
    fitted
        The fit with these and all steps before, where the diagnosis remembers it.
    """

    terms: tuple[Term, ...]
    evidence: Mapping[str, Any] = field(default_factory=dict)
    fitted: FittedStage | None = field(default=None, compare=False, repr=False)

    @property
    def label(self) -> str:
        """For people."""
        return ", ".join(term.label for term in self.terms)

    def fit_with(self, terms: Sequence[Term]) -> FittedStage | None:
        """The fit that it remembers, if that has these terms."""
        return self.fitted if self.fitted is not None and set(self.fitted.model.terms) == set(terms) else None


@dataclass(repr=False)
class StageDiagnosis:
    """The result of one stage; :meth:`to_json` gives the contract's form.

    ``steps``: confirmed steps, each on top of those before it. ``scores``: the last ones, on the residual of the fit
    with all steps. ``remains``: patterns too small to matter. ``agreeing``: rows with large residuals that agree with
    each other, and are therefore no outliers. ``rows``: their number, including outliers. ``folds``: held-out parts of
    runs, if runs were not held out as a whole. ``open``: the fit with one of each group of candidates that these rows
    do not distinguish; later stages use it, because its standard errors include this ambiguity. ``alike``: one of each
    group whose members give the same predictions everywhere, as steps that may be added; ``fitted`` has them.
    ``in_order``: these and ``steps``, in the order in which they were found.
    """

    stage: Stage
    unit: str
    verdict: Verdict = "adequate"
    noise_floor: float = 0.0
    before: float = 0.0
    after: float = 0.0
    candidates: list[dict[str, Any]] = field(default_factory=list)
    considered: list[dict[str, Any]] = field(default_factory=list)
    depends_on: list[str] = field(default_factory=list)
    shape: dict[str, Any] | None = None
    remains: list[Remains] = field(default_factory=list)
    agreeing: list[Agreement] = field(default_factory=list)
    outliers: list[dict[str, Any]] = field(default_factory=list)
    rows: int = 0
    next_measurement: str | None = None
    next_plan: NextPlan | None = None
    next_poses: NextPoses | None = None
    scores: CandidateScores | None = None
    omission: list[dict[str, Any]] = field(default_factory=list)
    exported_shift: list[dict[str, Any]] = field(default_factory=list)
    testability: list[dict[str, Any]] = field(default_factory=list)
    summary: str = ""
    warnings: list[str] = field(default_factory=list)
    floor_excess: dict[str, Any] | None = None
    one_sided: list[OneSided] = field(default_factory=list)
    steps: list[Step] = field(default_factory=list)
    fitted: FittedStage | None = None
    open: FittedStage | None = None
    alike: list[Step] = field(default_factory=list)
    in_order: list[Step] = field(default_factory=list)
    folds: Folds | None = None

    def title(self) -> str:
        """The verdict in a word, and the candidates."""
        names = dict.fromkeys(str(c.get("name", c["effect"])) for c in self.candidates)
        return f"{self.stage}: {self.verdict}" + (f": {', '.join(names)}" if names else "")

    def __repr__(self) -> str:
        return f"<StageDiagnosis: {self.title()}>"

    def records(self) -> list[dict[str, Any]]:
        """The candidates."""
        keys = ("effect", "alternative", "p_value", "p_familywise", "heldout_rms_before", "heldout_rms_after")
        return [
            {"stage": self.stage, "where": ", ".join(c["where"]), **{key: c.get(key) for key in keys}}
            for c in self.candidates
        ]

    def errors(self) -> dict[str, tuple[str, dict[str, float | None]]]:
        """Held-out errors without and with what was missing."""
        errors: dict[str, float | None] = {"before": self.before, "after": self.after, "noise floor": self.noise_floor}
        return {self.stage: (self.unit, errors)}

    @property
    def undecided(self) -> bool:
        """Whether these rows do not distinguish some of the candidates."""
        return any(c["alternative"] for c in self.candidates)

    @property
    def added(self) -> list[Term]:
        """The terms of all steps."""
        return [term for step in self.steps for term in step.terms]

    def forget_fits(self) -> None:
        """Forget the fits of the steps, each of which is as large as its rows."""
        for steps in (self.steps, self.alike, self.in_order):
            steps[:] = [replace(step, fitted=None) for step in steps]

    def ask_for(self, proposed: NextPlan, otherwise: Sequence[str]) -> None:
        """Record the measurements that distinguish the candidates, and other means for pairs that none distinguish."""
        self.next_plan = proposed
        self.next_measurement = "; ".join([proposed.sentence, *dict.fromkeys(otherwise)])

    def to_json(self) -> dict[str, Any]:
        """For programs."""
        return {
            "verdict": self.verdict,
            "unit": self.unit,
            "noise_floor": self.noise_floor,
            "heldout_rms_before": self.before,
            "heldout_rms_after": self.after,
            "candidates": self.candidates,
            "considered": self.considered,
            "depends_on": self.depends_on,
            "shape": self.shape,
            "notes": [found.to_json(self.unit) for found in self.remains],
            "agreeing": [found.to_json() for found in self.agreeing],
            "outliers": self.outliers,
            "warnings": self.warnings,
            "next_measurement": self.next_measurement,
            "next_plan": None if self.next_plan is None else self.next_plan.to_json(),
            "next_poses": None if self.next_poses is None else self.next_poses.to_json(),
            "omission": self.omission,
            "exported_shift": self.exported_shift,
            "testability": self.testability,
            "above_floor": self.floor_excess,
            "one_sided": [found.to_json() for found in self.one_sided],
            **({} if self.folds is None else {"folds": self.folds.to_json()}),
            "summary": self.summary,
        }
