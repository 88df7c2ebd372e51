"""A sample of rows spread over a long log's design: enough to determine which columns are linearly dependent."""

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

MOST_ROWS = 600  # linear dependence of columns depends on the postures, and more rows add no new ones


def sampled_columns(
    design: LogDesign, parts: Sequence[LogPart], slots: Sequence[Slot], sigma: Array, at_rest: bool
) -> tuple[Array, Array]:
    """The Jacobian of the prediction in the design's sample of rows, over the noise.

    Parameters
    ----------
    design, parts
        The log.
    slots
        The fitted slots, in the order of the columns.
    sigma
        Standard deviation of the motors' noise ``(n,)``, Nm.
    at_rest
        Whether columns of masses and first moments are those of the arm at rest. The small accelerations of steady rows
        would make parameters look separable that gravity cannot separate.

    Returns
    -------
    Array, Array
        Columns of the slots ``(M, P)`` and of the runs' offsets ``(M, K)``.
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
    """Numbers of at most :data:`MOST_ROWS` evenly spread rows of a log that is in memory."""
    usable = np.flatnonzero(rows.used.any(axis=1))
    even = np.linspace(0, len(usable) - 1, min(MOST_ROWS, len(usable)))
    return np.asarray(usable[np.unique(even.astype(int))])


def sampled_postures(design: LogDesign, parts: Sequence[LogPart]) -> tuple[Integers, Integers, Array]:
    """The sample's row numbers in the log ``(M,)``, their motors ``(M,)``, and joint angles ``(M, n)``, rad."""
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
    """Replace the columns of masses and first moments in ``columns`` ``(M, P + K)`` by those of gravity alone."""
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
