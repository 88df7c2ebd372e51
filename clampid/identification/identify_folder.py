"""Identification of gravity and friction from logs in Parquet files that are read in windows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from clampid.catalogue import with_user_effects
from clampid.effect import EffectError
from clampid.identification.identify import (
    LEAST_STEADY_SHARE,
    effects_in,
    held_out_folds,
    session_of,
)
from clampid.identification.identify_log import LogStage
from clampid.models.model import Model, Round
from clampid.slots import Term, parse_term
from clampid.stages.counting import needs_whole_log
from clampid.stages.layout import layout_of
from clampid.stages.log_facts import LogPart
from clampid.stages.stage_kind import acts_with
from clampid.stages.steady_share import steady_share
from clampid.standard_sets import DYNAMICS, STANDARD
from clampid.threads import single_threaded
from experiments.campaign import Campaign, CampaignError
from experiments.columns import LOGS, table_format
from experiments.errors import fault
from experiments.fingerprint import fingerprint
from experiments.header import read_header
from experiments.log_windows import LogTable

__all__ = ["identify_folder"]


@single_threaded
def identify_folder(
    folder: str | Path,
    effects: Sequence[str] | None = None,
    *,
    holdout: float = 0.0,
    seed: int = 0,
    user_effects: Path | None = None,
) -> Model:
    """Fit the stage free air of a campaign folder with logs in Parquet files; memory does not grow with their length.

    The result is that of `clampid.identification.identify.identify` for these tables. Other tables are not read.

    Parameters
    ----------
    folder
        The campaign folder.
    effects
        Names of effects (``effect`` or ``effect@joint3``); None for the standard set.
    holdout
        Share of whole runs that are held out, 0 to below 1.
    seed
        For the choice of held-out runs and cross-validation.
    user_effects
        File or folder of the user's own effects.

    Raises
    ------
    CampaignError
        The folder deviates from the contract, has no log, or a log is not a Parquet file.
    EffectError
        An effect is unknown, does not act in free air, or depends on a friction state over the whole run.
    FitError
        The rows do not allow the fit.
    """
    path = Path(folder)
    header = read_header(path)
    files = {name: path / header.tables[name] for name in LOGS if name in header.tables}
    if not files:
        raise CampaignError(f"{path}: expected a table free_air or wrist, found none")
    if header.at_joints:
        raise CampaignError(f"{path}: expected torques of motors, found side joint; read the campaign whole to fit it")
    tables = {name: _table(file, name, header.robot.n) for name, file in files.items()}
    campaign = Campaign(
        name=path.resolve().name,
        path=path,
        robot=header.robot,
        gravity=header.gravity,
        tool=header.tool,
        targets=header.targets,
        instrument=header.instrument,
        tables=MappingProxyType({}),
        fingerprint=fingerprint(header.raw, files),
        header=header.raw,
        stated=header.stated,
    )
    parts = [LogPart(campaign, 0, name, table.steadied()) for name, table in tables.items()]
    catalogue, layout = with_user_effects(user_effects), layout_of([campaign])
    terms = tuple(Term(name) for name in STANDARD["free_air"])
    if effects is not None:
        terms = tuple(dict.fromkeys(parse_term(name, catalogue, layout) for name in effects if name.strip()))
        for term in terms:
            if not acts_with(catalogue[term.effect], "moving"):
                acts = ", ".join(catalogue[term.effect].stages)
                raise EffectError(f"effect {term.effect} does not act in free_air; it does in: {acts}")
    elif steady_share(parts) < LEAST_STEADY_SHARE:
        terms = (*terms, *map(Term, DYNAMICS))
    if needs_whole_log(effects_in(terms, catalogue)):
        raise EffectError(
            f"effects {', '.join(t.label for t in terms)}: expected none that needs the whole log, as a state of "
            "friction or an order that is sought do, found one; read the campaign whole to fit it"
        )
    stage = LogStage(parts, layout, catalogue, terms)
    fitted = stage.fit(held_out_folds(stage.folds, holdout, seed), seed=seed)
    errors = fitted.errors(None, seed)
    ledger = Round("free_air", tuple(t.label for t in terms), (), errors.rms, errors.heldout_rms, errors.noise_floor)
    table = parts[0].name
    warmth = _temperatures(tables[table]) if table == "free_air" else None
    session = replace(session_of(campaign, None), temperature=warmth)
    source = None if user_effects is None else str(user_effects)
    name, file = campaign.robot.name, campaign.robot_file
    return Model(name, layout, {"free_air": fitted.model}, (session,), (ledger,), seed, holdout, source, False, file)


def _table(file: Path, name: str, n: int) -> LogTable:
    """The table ``name`` of a robot with n joints; raises :class:`CampaignError` if it cannot be used."""
    if file.suffix != ".parquet":
        raise fault(file, expected="a table ending in .parquet, to be read in pieces", found=file.suffix or "no ending")
    table = LogTable.of(file)
    for column in table_format(name, n).required:
        if column.name not in table.names:
            raise fault(file, expected=f"a column {column.name}", found="no such column")
    if not table.rows:
        raise fault(file, expected="at least one row", found="a header and no rows")
    return table


def _temperatures(table: LogTable) -> tuple[float, float] | None:
    """The lowest and highest temperature of a log, degC; None if it has no temperatures."""
    names = [name for name in table.names if name.startswith("temp_")]
    if not names:
        return None
    ends = [(np.nanmin(v), np.nanmax(v)) for chunk in table.chunks(names) for v in chunk.values()]
    return float(np.nanmin([low for low, _ in ends])), float(np.nanmax([high for _, high in ends]))
