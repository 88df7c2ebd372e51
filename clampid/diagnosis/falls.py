"""Whether the held-out error falls by a candidate, which confirms it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from clampid.diagnosis.confirm import Fall, cross_fitted_fall, event_p, probe_held_out_fall, terms_p
from clampid.diagnosis.held_out import HELD_OUT_RATE, HeldOut, either_p
from clampid.diagnosis.linear_refit import at_fit
from clampid.diagnosis.pruning import pays
from clampid.diagnosis.wandering import known_to_wander
from clampid.effect import Effect
from clampid.evidence.score import Scored
from clampid.fitting.solve import Estimate
from clampid.fitting.wander import Level
from clampid.slots import Term
from clampid.stages.rows import Rows

__all__ = ["MOSTLY", "FallTest", "tested_everywhere"]

MOSTLY = 0.5  # of the evidence of a candidate: above this share it comes from a prior and not from the rows


def tested_everywhere(effect: Effect) -> bool:
    """Whether all held-out rows test an effect, wherever they are: not an event, nor a local error."""
    return effect.event is None and effect.scanned is None


@dataclass(frozen=True)
class FallTest:
    """The test of a fall of the held-out error, beside the noise that the scores had.

    A verification table of a few visits may be too small for a significant fall that all poses show. So half of the
    false-alarm rate is for the table and half for the poses in five-fold cross-validation.

    The same holds for a log whose readings wander: half of the rate is for the errors as they are, and half for the
    errors with the wandering level taken out. Beside a level that walks by several standard deviations, no effect of
    the size of one lowers the plain error significantly.

    The printed error must fall in any case.

    Attributes
    ----------
    effects
        All known effects, by name.
    verification
        Rows of a table that no fit sees, where there is one.
    seed
        Of the sign flips.
    wander
        By how much the readings wander beside the candidates; None if they do not.
    noise_of_fit
        Whether the candidates were scored by the noise that weights the fit.
    """

    effects: Mapping[str, Effect]
    verification: Rows | None
    seed: int
    wander: Level | None = None
    noise_of_fit: bool = True

    def of_step(self, held_out: HeldOut, new: HeldOut, s: Scored, without: Estimate) -> tuple[float, bool]:
        """One-sided p of the fall by a candidate, estimated in one step, and whether it falls significantly."""
        p = held_out.p_above(new, new.noise, self.seed)
        if p > 0.5 * HELD_OUT_RATE:
            if self.verification is not None:
                p = either_p(p, self._crossed(without, s).p)
            else:
                p = self._or_without_level(p, without, s)
        return p, p <= HELD_OUT_RATE and held_out.exceed(new)

    def of_fit(
        self, best: Scored, trial: Estimate, kept: Sequence[Term], held_out: HeldOut, new: HeldOut
    ) -> tuple[float, bool]:
        """One-sided p of the fall of the held-out error by a fitted candidate, and whether that confirms it.

        An event is tested by other blocks of its own sweep, because no other sweep contains it. A local error within a
        few degrees of one joint may have no row in a verification table. It is tested by other visits there, and must
        not raise the table's error.

        The plain error must fall as well: whitened errors of a log emphasise brief effects, and alone they would
        confirm effects that raise the printed error. An effect that only a prior identifies (an undeclared tool, say)
        may leave the held-out error, not raise it. Its parameters must differ clearly from zero.
        """
        effect = self.effects[best.candidate.name]
        raises = new.p_above(held_out, new.noise, self.seed) <= HELD_OUT_RATE
        if not tested_everywhere(effect):
            p = event_p(trial, effect.name, self.seed)
            return p, p <= HELD_OUT_RATE and not (raises and effect.scanned is not None)
        p = held_out.p_above(new, new.noise, self.seed)
        if p > 0.5 * HELD_OUT_RATE:
            if self.verification is not None:
                p = either_p(p, terms_p(trial, kept, self.seed))
            elif (steady := self._without_level(trial)) is not None:
                p = either_p(p, terms_p(steady, kept, self.seed))
        if p <= HELD_OUT_RATE and held_out.exceed(new):
            return p, True
        return p, best.assumed > MOSTLY and not raises and bool(kept) and pays(trial, kept)

    def of_probe(self, probe: Scored, estimate: Estimate) -> Fall:
        """Fall of the held-out error by a probe: as for names.

        It enters no model, so the error of the table need not fall, other than for names. A table that lies beyond the
        poses tests how a smooth function goes on there, not whether they depend on its variables; one measured later
        does not test errors that vary with time.
        """
        if self.verification is not None and probe.candidate.depends_on != ("time",):
            fall = probe_held_out_fall(estimate, self.verification, probe.candidate, self.seed)
            if fall.p <= 0.5 * HELD_OUT_RATE:
                return fall
            crossed = self._crossed(estimate, probe)
            return replace(crossed, p=either_p(fall.p, crossed.p))
        fall = self._crossed(estimate, probe)
        if fall.p <= 0.5 * HELD_OUT_RATE:
            return fall
        return replace(fall, p=self._or_without_level(fall.p, estimate, probe))

    def _crossed(self, estimate: Estimate, s: Scored) -> Fall:
        """Fall of the errors as they are, weighted as the fit is."""
        return cross_fitted_fall(estimate, s if self.noise_of_fit else at_fit(estimate, s), self.seed)

    def _or_without_level(self, p: float, estimate: Estimate, s: Scored) -> float:
        """The p of a test that has been made; of a log that wanders by the better of it and one without the level."""
        steady = self._without_level(estimate)
        return p if steady is None else either_p(p, cross_fitted_fall(steady, at_fit(steady, s), self.seed).p)

    def _without_level(self, estimate: Estimate) -> Estimate | None:
        """The estimate of a log, the wandering level taken out; None if it does not wander."""
        if self.wander is None or estimate.problem.kind.points:
            return None
        return known_to_wander(estimate, self.wander)
