"""An experiment: rows and the effects that are active in them, as one function of one parameter vector."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from clampid.chain import Chain, build_chain
from clampid.effect import DIRECT, WEAK, Effect, Parameter, Stage
from clampid.slots import Slot, find_parameter
from clampid.stages import clamped, poses, torques
from clampid.stages.rows import Array, Rows

__all__ = ["Experiment", "experiment"]


HELD = 1e-9  # sizes: as tightly as numbers allow
OFFSET_SIZE: Mapping[Stage, float] = {"free_air": 0.5, "clamped": 1e-3, "poses": 1.0}  # Nm, rad


@dataclass(frozen=True)
class Experiment:
    """Rows and active slots of one stage.

    The parameter vector is ``(P + K,)``: the slots, then K offsets that belong to single runs or sweeps (in ``clamped``
    the posture at which each sweep was clamped, in ``free_air`` the friction of joints that stood still; in ``poses``
    none).
    """

    rows: Rows
    effects: Mapping[str, Effect]
    slots: tuple[Slot, ...]
    chain: Chain

    @property
    def offsets(self) -> int:
        """K."""
        return self.rows.offsets

    @property
    def stage(self) -> Stage:
        """Which of the three stages this is."""
        return self.rows.stage

    def residual(self, theta: Array) -> tuple[Array, Array]:
        """Measured less predicted ``(N, m)``, and the prediction's derivative ``(N, m, P + K)``, SI."""
        own, extra = theta[: len(self.slots)], theta[len(self.slots) :]
        match self.stage:
            case "poses":
                return poses.residual(self.rows, self.chain, own)
            case "free_air":
                return torques.residual(self.rows, self.chain, own, extra)
            case _:
                return clamped.residual(self.rows, self.chain, own, extra)

    def with_rows(self, rows: Rows) -> Experiment:
        """The same effects on other rows of the same layout."""
        return replace(self, rows=rows)

    def with_flanks(self, theta: Array) -> Experiment:
        """The same with the flanks held where these parameters put them; only poses have any."""
        if self.stage != "poses":
            return self
        found = poses.flanks(self.rows, self.chain, theta[: len(self.slots)])
        if found is None:
            return self
        return replace(self, rows=replace(self.rows, signals={**self.rows.signals, "flank": found}))

    def with_slots(self, slots: Sequence[Slot]) -> Experiment:
        """The same rows with other slots active."""
        return experiment(self.rows, self.effects, slots)

    def start(self) -> Array:
        """A start: amplitudes zero, or in ``clamped`` stiff springs; shape parameters at the first of their grid."""
        theta = np.zeros(len(self.slots) + self.offsets)
        for k, slot in enumerate(self.slots):
            parameter = find_parameter(slot, self.effects)
            if parameter.shape:
                theta[k] = parameter.grid[0]
        return theta

    def sizes(self) -> Array:
        """What each parameter may reasonably amount to ``(P + K,)``."""
        own = self._each(lambda p: p.size)
        return np.array([*own, *([OFFSET_SIZE[self.stage]] * self.offsets)])

    def prior_std(self) -> Array:
        """Standard deviations ``(P + K,)`` of what is assumed of each parameter before any row is seen."""
        own = self._each(lambda p: p.prior_std)
        std = np.array([*own, *([WEAK * OFFSET_SIZE[self.stage]] * self.offsets)])
        return np.where(self.held(), HELD * self.sizes(), std)

    def held(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Which parameters ``(P + K,)`` a fit keeps where they start."""
        out = np.zeros(len(self.slots) + self.offsets, dtype=bool)
        seen: set[tuple[str, str]] = set()
        for k, slot in enumerate(self.slots):
            kind = find_parameter(slot, self.effects).held
            first = (slot.effect, slot.parameter) not in seen
            out[k] = kind == "everywhere" or (kind == "first" and first)
            seen.add((slot.effect, slot.parameter))
        return out

    def clear(self) -> Array:
        """Standard errors ``(P + K,)`` below which the rows, and not what was assumed, tell a parameter."""
        own = self._each(lambda p: p.clear)
        return np.array([*own, *([OFFSET_SIZE[self.stage]] * self.offsets)])

    def bounds(self) -> tuple[Array, Array]:
        """Physical limits ``(P + K,)`` each."""
        lower, upper = self._each(lambda p: p.bounds[0]), self._each(lambda p: p.bounds[1])
        return np.array([*lower, *[-np.inf] * self.offsets]), np.array([*upper, *[np.inf] * self.offsets])

    def _each(self, what: Callable[[Parameter], float]) -> list[float]:
        """A number of each slot's parameter, those of a drive's motor at joints without reduction as at the joint."""
        direct = np.abs(np.diag(np.asarray(self.rows.robot.transmission))) == 1.0
        out = []
        for slot in self.slots:
            parameter = find_parameter(slot, self.effects)
            at_joint = parameter.geared and direct[int(slot.place.removeprefix("joint")) - 1]
            out.append(what(parameter) * (DIRECT if at_joint else 1.0))
        return out

    def shapes(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Which parameters ``(P + K,)`` are shapes, not amplitudes."""
        own = [find_parameter(slot, self.effects).shape for slot in self.slots]
        return np.array([*own, *([False] * self.offsets)], dtype=bool)


def experiment(rows: Rows, effects: Mapping[str, Effect], slots: Sequence[Slot]) -> Experiment:
    """An experiment with the given slots active.

    Raises
    ------
    clampid.effect.EffectError
        An effect does not act in the rows' stage.
    """
    robot = rows.robot
    chain = build_chain(
        rows.stage, slots, effects, rows.layout, np.asarray(robot.transmission), poses.link_vectors(robot)
    )
    return Experiment(rows, effects, tuple(slots), chain)
