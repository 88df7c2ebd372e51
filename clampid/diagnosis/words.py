"""A verdict in words, with its notes: outliers, and the bias of other parameters by an omission."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from clampid.diagnosis.headline import listed, named
from clampid.diagnosis.result import StageDiagnosis
from clampid.display import count_text, error_text, error_texts, number
from clampid.fitting.solve import Estimate
from clampid.slots import Slot, unit_of
from clampid.stages.rows import Array, Bools, Rows, lengths

__all__ = ["listed_outliers", "more_rows_words", "omission_of", "outliers_of", "summary_of"]


FEW_OUTLIERS = 3  # each table of a clean campaign has one with a chance of 1 %, and this many once in a million
"""From this many rejected rows on the verdict says so."""


def outliers_of(estimate: Estimate) -> list[dict[str, Any]]:
    """The rows that the fit has rejected, and the size of their residual: m of a point, Nm over all motors."""
    return listed_outliers(estimate.problem.rows, estimate.residual, estimate.outliers)


def listed_outliers(rows: Rows, residual: Array, bad: Bools) -> list[dict[str, Any]]:
    """Rows marked ``(N,)``, and the size of their residual ``(N, m)``: m of a point, Nm over all motors."""
    size = lengths(residual) if rows.kind.points else np.linalg.norm(residual[:, : rows.robot.n], axis=1)
    return [{"table": str(rows.table[i]), "row": int(rows.row[i]), "size": float(size[i])} for i in np.flatnonzero(bad)]


def omission_of(before: Estimate, after: Estimate) -> list[dict[str, Any]]:
    """Bias of the other fitted parameters by the omission: shifts beyond their standard error.

    Only of parameters that both fits determine; others have no value that could shift.
    """
    if before is after:
        return []
    std = after.std
    new: dict[Slot, int] = {slot: k for k, slot in enumerate(after.slots)}
    out: list[dict[str, Any]] = []
    for k, slot in enumerate(before.slots):
        if slot not in new or not before.identified[k] or not after.identified[new[slot]]:
            continue
        shift = float(before.theta[k] - after.theta[new[slot]])
        spread = float(std[new[slot]])
        if spread > 0 and abs(shift) > 2 * spread:
            out.append(
                {
                    "name": slot.label,
                    "shift": shift,
                    "std": spread,
                    "unit": unit_of(slot, before.problem.effects, before.problem.rows.robot),
                }
            )
    return sorted(out, key=lambda o: -abs(float(o["shift"])) / float(o["std"]))[:10]


def more_rows_words(before: Rows, after: Rows) -> list[str]:
    """Statement that more torques count than at first, since a friction was found that knows motors at rest."""
    more = int(after.used.sum() - before.used.sum())
    if before is after or more <= 0:
        return []
    return [
        f"With the friction found, {count_text(more)} more torques count, of motors at rest or turning back; the "
        "held-out error without it is that of these torques, too."
    ]


def summary_of(result: StageDiagnosis) -> str:
    """The verdict in a few sentences: missing effects, errors, unexplained structure, and rejected rows."""
    notes = [found.sentence(result.unit, result.noise_floor) for found in result.remains]
    return " ".join([_verdict(result), *notes, *_dropped(result)])


def _dropped(result: StageDiagnosis) -> list[str]:
    """The number of rejected rows, if it is more than chance in a clean table."""
    count = len(result.outliers)
    if count < FEW_OUTLIERS:
        return []
    of = f" of {count_text(result.rows)}" if result.rows >= count else ""
    return [f"{count_text(count)}{of} rows were rejected as outliers; they are not used."]


def _verdict(result: StageDiagnosis) -> str:

    of_noise = "" if result.unit == "m" else " of the motors' noise"

    def shown(x: float) -> str:
        return error_text(x, result.unit) + of_noise

    def words(c: Mapping[str, Any]) -> str:
        said = named(c.get("name", c["effect"]), c["where"])
        when = c.get("when")
        return f"{said}, once, just before row {when['row']} of {when['table']}" if when else said

    confirmed = [words(c) for c in result.candidates if not c["alternative"]]
    floor = f"noise floor {shown(result.noise_floor)}"
    start = ""
    if confirmed:
        what = listed(confirmed, len(confirmed))
        were = "were" if len(confirmed) > 1 else "was"
        ends = [x + of_noise for x in error_texts([result.before, result.after], result.unit)]
        fall = f"Held-out error {ends[0]} → {ends[1]}; {floor}."
        start = f"{what[:1].upper()}{what[1:]} {were} missing. {fall} "
    error = "" if confirmed else f" Held-out error {shown(result.after)}; {floor}."
    match result.verdict:
        case "adequate" | "missing" if result.floor_excess is not None:
            return start + _floor_excess(result.floor_excess, shown(result.after), floor, bool(start))
        case "adequate":
            return (
                f"No missing effect was found. Held-out error {shown(result.before)}; {floor}. An effect above its "
                "detection limit would have been found with 90 % probability."
            )
        case "missing":
            return start + "No further effect was found."
        case "ambiguous":
            return start + _undecided(result, "what is left" if confirmed else "the error", words, error)
        case _:
            beside = ""
            if result.undecided:
                start += _undecided(result, "a part of the error", words, error) + " "
                error, beside = "", " beside any of these"
            if not result.depends_on:
                return (
                    f"{start}No known effect explains what is left{beside}, and it depends on no recorded variable as "
                    f"far as these rows show.{error}"
                )
            next_step = f" To describe it as an effect: {result.shape['command']}" if result.shape else ""
            return (
                f"{start}No known effect explains what is left{beside}; it depends on {', '.join(result.depends_on)}."
                f"{error}{next_step}"
            )


def _undecided(result: StageDiagnosis, what: str, words: Callable[[Mapping[str, Any]], str], error: str) -> str:
    """The sets of candidates that the data do not distinguish, and what distinguishes those of the first.

    ``what`` they explain, ``words`` for one of them, and the ``error`` as a sentence.
    """
    groups: dict[int, list[str]] = {}
    for c in result.candidates:
        if c["alternative"]:
            groups.setdefault(c["group"], []).append(words(c))
    first, *more = ("; ".join(group) for group in groups.values())
    nor = "".join(f" Once one of these is added, these remain indistinguishable: {group}." for group in more)
    return (
        f"The data do not distinguish these explanations of {what}: {first}.{error} "
        f"To distinguish them: {result.next_measurement}.{nor}"
    )


def _floor_excess(excess: Mapping[str, Any], error: str, floor: str, further: bool) -> str:
    """Statement that no effect was found although the error lies above the noise, with figures and possible reasons."""
    unseen = "; ".join(f"{place}: {', '.join(variables)}" for place, variables in excess["unseen"].items())
    blind = f" The model absorbs errors that depend on these variables: {unseen}." if unseen else ""
    return (
        f"No {'further ' if further else 'missing '}effect was confirmed, but the held-out error is {error}: "
        f"{number(excess['times_floor'], 2)} times the {floor}. {100 * excess['share_of_square']:.0f} % of its square "
        f"are not noise. Possible reasons: {'; '.join(excess['reasons'])}.{blind} An effect above its detection limit "
        "would have been found with 90 % probability."
    )
