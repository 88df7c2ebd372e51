"""Fit a campaign while it is measured, and show after each block which parameters are identified."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from clampid.catalogue import catalogue
from clampid.display import counted, number, scale_for, with_std
from clampid.effect import EffectError
from clampid.fitting.solve import FitError
from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import on_campaign
from clampid.loop.known_here import known_before, known_here
from clampid.loop.until import Until
from clampid.models.model import Model, StageModel
from clampid.role_slots import has_role
from clampid.roles import FRAMES
from clampid.stages.rows import Bools
from clampid.stages.stage_kind import stage_of_table
from experiments.campaign import Campaign, read_campaign, write_campaign
from experiments.checks.check import check_campaign
from experiments.errors import CampaignError
from experiments.outputs import temporary_folder
from experiments.plans.model import Plan
from experiments.runs.context import Block
from experiments.runs.folder import header_of, tables_of

__all__ = ["LiveFit", "campaign_so_far", "fit_of"]

Entries = Sequence[Mapping[str, Any]]
LEAST_ROW_RATIO = 1.4  # rows now over rows of the last fit: with fewer there is no new fit
FIT_TIME_SHARE = 0.2  # share of the time that fits may take
ODD_ERROR_RATIO = 1.3  # error over noise floor, from which on the residuals are called odd
MAX_PARAMETER_LINES = 10
MAX_UNKNOWN_SHOWN = 4


def campaign_so_far(plan: Plan, entries: Entries, before: Campaign | None) -> Campaign:
    """The campaign of the rows recorded so far and of those that its folder contained before.

    Raises
    ------
    CampaignError
        There are no rows yet, or they do not make a valid campaign.
    """
    tables = {} if before is None else dict(before.tables)
    with temporary_folder() as place:
        folder = Path(place) / "so_far"
        write_campaign(folder, header_of(plan.cell, folder), tables | tables_of(entries))
        return read_campaign(folder)


def fit_of(campaign: Campaign) -> Model:
    """Fit the standard effects, as ``clampid identify`` does.

    Raises
    ------
    CampaignError
        The rows are not enough, such as too few poses for the geometry. A fit would then only repeat its priors.
    FitError, EffectError
        The fit cannot be made.
    """
    wrong = [f"{f.table}: {f.message}" for f in check_campaign(campaign, fits=True) if f.severity == "error"]
    if wrong:
        raise CampaignError("; ".join(wrong))
    return identify(campaign)


class LiveFit:
    """Called after every block: fits if there are enough new rows, and shows which parameters are known.

    Parameters
    ----------
    plan
        The plan that is run.
    entries
        Returns the entries of the journal.
    before
        What the campaign's folder contained before the run.
    say
        Called with each line for the user.
    until
        Conditions that end the run when all of them hold.
    """

    def __init__(
        self,
        plan: Plan,
        entries: Callable[[], Entries],
        before: Campaign | None,
        say: Callable[[str], None],
        until: Sequence[Until] = (),
    ) -> None:
        self._plan, self._entries, self._before, self._say, self._until = plan, entries, before, say, until
        self._rows, self._took, self._last = 0, 0.0, time.monotonic()
        self._std: dict[str, float] = {}
        self._refused = ""
        self.model: Model | None = None

    def finished(self, block: Block) -> str | None:
        """Fit, if it is time. Returns why the run may end, or None if it goes on."""
        rows = sum(len(frame) for frame in tables_of(self._entries()).values())
        waited = time.monotonic() - self._last
        if rows < LEAST_ROW_RATIO * self._rows or (waited < self._took / FIT_TIME_SHARE and not self._until):
            return None
        start = time.monotonic()
        try:
            campaign = campaign_so_far(self._plan, self._entries(), self._before)
            self.model = fit_of(campaign)
        except (FitError, EffectError, CampaignError) as error:
            if str(error) != self._refused:
                self._say(f"After {block.name}: no fit yet: {error}")
            self._rows, self._refused = rows, str(error)
            return None
        self._rows, self._took, self._last = rows, time.monotonic() - start, time.monotonic()
        for line in self._lines(self.model, campaign, block, rows):
            self._say(line)
        return self._enough(self.model)

    def _enough(self, model: Model) -> str | None:
        if not self._until:
            return None
        reached = [(condition, *condition.reached(model)) for condition in self._until]
        for condition, value, _ in reached:
            self._say(f"  until {condition.text}: now {condition.shown(value)}")
        if all(enough for _, _, enough in reached):
            conditions = " and ".join(condition.text for condition in self._until)
            return f"Stopped early, as asked: {conditions}."
        return None

    def _lines(self, model: Model, campaign: Campaign, block: Block, rows: int) -> list[str]:
        name = stage_of_table(block.table)
        stage = None if name is None else model.stages.get(name)
        if stage is None:
            return []
        opened = on_campaign(model, campaign)
        before = {s: m for s, m in model.stages.items() if s != stage.stage}
        own = opened.rows(stage.stage)
        known = known_here(stage, before, own, opened.effects)
        earlier = known_before(stage, before, own, opened.effects) & ~known
        head = (
            f"After {block.name}: {counted(rows, 'row')}; {known.sum()} of {len(stage.slots)} parameters of {name} are "
            "known from them"
        )
        head += f", {earlier.sum()} from earlier tables or the description." if earlier.any() else "."
        lines = [head, *self._parameters(stage, known)]
        last = next((entry for entry in reversed(model.ledger) if entry.stage == name), None)
        if last is not None and last.noise_floor > 0 and last.rms > ODD_ERROR_RATIO * last.noise_floor:
            lines.append(
                f"  odd: residuals are {last.rms / last.noise_floor:.1f} times the noise: an effect may be missing"
            )
        if stage.outliers:
            lines.append(f"  odd: {len(stage.outliers)} rows do not fit the others")
        unknown = [slot.label for slot, yes in zip(stage.slots, known | earlier, strict=True) if not yes]
        if unknown:
            rest = len(unknown) - MAX_UNKNOWN_SHOWN
            more = f" and {rest} more" if rest > 0 else ""
            lines.append(f"  still unknown, to be measured next: {', '.join(unknown[:MAX_UNKNOWN_SHOWN])}{more}")
        return lines

    def _parameters(self, stage: StageModel, known: Bools) -> list[str]:
        """A line for each identified parameter, with its standard error before; one line for all of the geometry."""
        units = {(e.name, p.name): p.unit for e in catalogue().values() for p in e.parameters}
        std = np.sqrt(np.diag(stage.covariance))
        lines, shrunk = [], []
        for k, slot in enumerate(stage.slots):
            if not known[k]:
                continue
            before = self._std.get(slot.label)
            self._std[slot.label] = float(std[k])
            if has_role(slot, *FRAMES):
                shrunk.append(1.0 if before is None else std[k] / before)
                continue
            unit = units.get((slot.effect, slot.parameter), "")
            scale = scale_for(unit, [float(stage.theta[k]), float(std[k])])
            fell = "" if before is None else f"  (standard error was {_text(before, unit)})"
            lines.append(f"  {slot.label}  {with_std(float(stage.theta[k]), float(std[k]), scale)}{fell}")
        if shrunk:
            lines.insert(0, f"  geometry: {len(shrunk)} known, standard errors {np.median(shrunk):.2f} of those before")
        rest = len(lines) - MAX_PARAMETER_LINES
        return lines if rest <= 0 else [*lines[:MAX_PARAMETER_LINES], f"  … and {rest} more"]


def _text(value: float, unit: str) -> str:
    if not np.isfinite(value):
        return "not known"
    scale = scale_for(unit, [value])
    return f"{number(value * scale.factor)} {scale.unit}"
