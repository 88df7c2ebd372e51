"""Some rows of a long log's design, spread over it: enough to see what depends on what."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from clampid.role_slots import weight_slots
from clampid.slots import Slot
from clampid.stages.loads import gravity_regressors
from clampid.stages.log_design import LogDesign
from clampid.stages.log_facts import LogPart
from clampid.stages.log_motion import joint_columns
from clampid.stages.rows import Array, Integers, Rows

__all__ = ["MOST_ROWS", "sampled_columns", "sampled_postures", "sampled_rows"]

MOST_ROWS = 600  # what depends on what is a matter of postures, not of rows


def sampled_columns(
    design: LogDesign, parts: Sequence[LogPart], slots: Sequence[Slot], sigma: Array, at_rest: bool
) -> tuple[Array, Array]:
    """The derivative of the prediction in the rows of the design's sample, over the noise.

    Parameters
    ----------
    design, parts
        The log.
    sigma
        Standard deviation of the motors' noise ``(n,)``, Nm.
    at_rest
        Masses and first moments as in rest: the little acceleration of steady rows must not blur what gravity cannot
        separate.

    Returns
    -------
    Array, Array
        Of the slots ``(M, P)`` and of the runs' offsets ``(M, K)``.
    """
    row, motor, values = [], [], []
    for part in design.sample():
        wide = np.zeros((len(part.row), design.parameters))
        wide[:, part.columns] = part.values
        row.append(part.row)
        motor.append(np.full(len(part.row), part.motor))
        values.append(wide)
    at, which, columns = np.concatenate(row), np.concatenate(motor), np.concatenate(values)
    if at_rest:
        _weigh(columns, at, which, design, parts, slots)
    columns = columns / sigma[which][:, None]
    return columns[:, : len(slots)], columns[:, len(slots) :]


def sampled_rows(rows: Rows) -> Integers:
    """Numbers of the rows of a log read whole that stand for all."""
    usable = np.flatnonzero(rows.used.any(axis=1))
    even = np.linspace(0, len(usable) - 1, min(MOST_ROWS, len(usable)))
    return np.asarray(usable[np.unique(even.astype(int))])


def sampled_postures(design: LogDesign, parts: Sequence[LogPart]) -> tuple[Integers, Integers, Array]:
    """The sample's rows of the log ``(M,)``, their motors ``(M,)``, and where the joints are ``(M, n)``, rad."""
    found = design.sample()
    row = np.concatenate([part.row for part in found])
    motor = np.concatenate([np.full(len(part.row), part.motor) for part in found])
    q, before = np.zeros((len(row), design.n)), 0
    for part in parts:
        inside = np.flatnonzero((row >= before) & (row < before + part.table.rows))
        wanted, of = np.unique(row[inside] - before, return_inverse=True)
        q[inside] = _postures(part, wanted)[of]
        before += part.table.rows
    return row, motor, q


def _postures(part: LogPart, wanted: Integers) -> Array:
    """Joint angles ``(k, n)``, rad, of some rows of a table, in their order."""
    n = part.campaign.robot.n
    q, done = np.zeros((len(wanted), n)), 0
    for chunk in part.table.chunks(joint_columns("q", "rad", n)):
        found = np.column_stack(list(chunk.values()))
        here = (wanted >= done) & (wanted < done + len(found))
        q[here] = found[wanted[here] - done]
        done += len(found)
    return q


def _weigh(
    columns: Array, row: Integers, motor: Integers, design: LogDesign, parts: Sequence[LogPart], slots: Sequence[Slot]
) -> None:
    """Put the columns of weight alone into ``columns`` ``(M, P + K)``."""
    index = {slot: k for k, slot in enumerate(slots)}
    n, T = design.n, design.T
    before = 0
    for part in parts:
        inside = np.flatnonzero((row >= before) & (row < before + part.table.rows))
        wanted, of = np.unique(row[inside] - before, return_inverse=True)
        gravity = np.asarray(part.campaign.gravity, dtype=float)
        weight = gravity_regressors(part.campaign.robot, gravity, _postures(part, wanted))
        links, tool = T @ weight["regressor"], T @ weight["tool_regressor"]
        for k in range(n):
            for i, own in enumerate(weight_slots(f"link{k + 1}")):
                if own in index:
                    columns[inside, index[own]] = links[of, motor[inside], 4 * k + i]
        for i, own in enumerate(weight_slots("tool")):
            if own in index:
                columns[inside, index[own]] = tool[of, motor[inside], i]
        before += part.table.rows
