"""The rows that a fit rejected as outliers, as one looks for them: by pose and visit, with how far off they are."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from clampid.display import error_text
from clampid.fitting.accuracy import predicted
from clampid.identification.model_on_campaign import on_campaign
from clampid.models.model import Model
from clampid.stages.rows import lengths
from experiments.campaign import Campaign

__all__ = ["rejected_words"]

ROWS_SHOWN = 10


def rejected_words(model: Model, campaigns: Sequence[Campaign], effects_from: Path | None = None) -> dict[str, str]:
    """Stage → its rejected rows in words: points by pose and visit, with their distance from the model; logs by row.

    Parameters
    ----------
    model
        Fitted on these campaigns.
    campaigns
        In their order.
    effects_from
        A file of the user's own effects.
    """
    out: dict[str, str] = {}
    for name, stage in model.stages.items():
        if not stage.outliers:
            continue
        if stage.kind.points:
            listed = _visits(model, campaigns, effects_from)
        else:
            listed = [f"{table} row {row}" for _, table, row in stage.outliers]
        more = f" and {len(listed) - ROWS_SHOWN} more" if len(listed) > ROWS_SHOWN else ""
        count = f"{len(stage.outliers)} {'rows' if len(stage.outliers) > 1 else 'row'}"
        out[name] = f"{count}: {'; '.join(listed[:ROWS_SHOWN])}{more}"
    return out


def _visits(model: Model, campaigns: Sequence[Campaign], effects_from: Path | None) -> list[str]:
    """Visits with rejected points, the worst first."""
    opened = on_campaign(model, campaigns, effects_from)
    rows = opened.rows("poses")
    residual = predicted(opened.fit_problem("poses", rows), model.stages["poses"].theta)
    visits: dict[tuple[int, str, int, int], list[tuple[str, float]]] = {}
    for session, table, row in model.stages["poses"].outliers:
        cells = campaigns[session].tables[table].iloc[row - 1]
        (at,) = np.flatnonzero((rows.session == session) & (rows.table == table) & (rows.row == row))
        off = float(lengths(residual)[at])
        visits.setdefault((session, table, int(cells["pose"]), int(cells["visit"])), []).append((cells["target"], off))
    lines = []
    for (session, table, pose, visit), points in visits.items():
        where = f"{campaigns[session].name}, " if len(campaigns) > 1 else ""
        where += "" if table == "poses" else f"{table} "
        most = max(off for _, off in points)
        off_by = error_text(most, "m") + (" at most" if len(points) > 1 else "")
        lines.append((most, f"{where}pose {pose} visit {visit} ({', '.join(t for t, _ in points)}) off by {off_by}"))
    return [text for _, text in sorted(lines, key=lambda entry: -entry[0])]
