"""The problem of a fit: rows and their active effects, as one function of one parameter vector."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import linalg

from clampid.chain.chain import Chain, build_chain
from clampid.chain.loads import joint_loads
from clampid.effect import WEAK_SPREAD, Effect, Parameter, Per, Stage
from clampid.role_slots import numbers_of_role
from clampid.roles import Role
from clampid.slots import Slot, find_parameter, fixed_slots, unit_of
from clampid.stages import poses
from clampid.stages.rows import Array, Rows
from clampid.stages.stage_kind import StageKind
from clampid.stages.statements import stated_equations
from kinematics.description import RobotDescription
from kinematics.masses import own_moment

__all__ = ["FIXED_STD", "FitProblem", "fit_problem", "parameter_in", "parameter_of"]


FIXED_STD = 1e-9  # sizes: as tightly as numbers allow


@dataclass(frozen=True)
class FitProblem:
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
        """The name of the stage."""
        return self.rows.stage

    @property
    def kind(self) -> StageKind:
        """The stage as a value."""
        return self.rows.kind

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """The parameters of the slots ``(P,)``, with sizes and bounds for this robot's gears and its known friction."""
        return tuple(parameter_in(self.rows, slot, self.effects) for slot in self.slots)

    def numbers_of(self, *roles: Role, per: Per | None = None) -> list[int]:
        """Which slots, counted from 0, are numbers of one of these roles (and one for each of such places)."""
        return numbers_of_role(self.slots, *roles, per=per, effects=self.effects)

    def _parts(self, theta: Array) -> tuple[Rows, Chain, Array, Array]:
        """Rows, chain, the slots' values ``(P,)`` and the offsets ``(K,)``."""
        return self.rows, self.chain, theta[: len(self.slots)], theta[len(self.slots) :]

    def residual(self, theta: Array) -> tuple[Array, Array]:
        """Measured less predicted ``(N, m)``, and the prediction's derivative ``(N, m, P + K)``, SI."""
        return self.kind.residual(*self._parts(theta))

    @property
    def affine(self) -> bool:
        """Whether the prediction's derivative is the same at all parameters."""
        return self.kind.linear and self.chain.affine

    def error(self, theta: Array) -> Array:
        """Measured less predicted ``(N, m)`` alone, SI."""
        return self.kind.error(*self._parts(theta))

    def derivative(self, theta: Array, first: int) -> Array:
        """The prediction's derivative by the slots from the ``first`` on, ``(N, m, P - first)``, SI."""
        return self.kind.derivative(*self._parts(theta), first)

    def moved(self, theta: Array, steps: Array) -> Array:
        """Change of the prediction ``(N, m, k)`` by steps ``(P + K, k)``, to first order."""
        return self.kind.moved(*self._parts(theta), steps)

    def by_joint(self, theta: Array) -> Array:
        """In poses, the derivative of the prediction by the joint angles ``(N, m, n)``, m/rad and rad/rad."""
        deviations = poses.evaluate(self.rows, self.chain, theta[: len(self.slots)])
        return poses.by_station(self.rows, deviations)[1][:, :, : self.rows.robot.n]

    def loads(self, theta: Array) -> Array:
        """Torques ``(N, n)``, Nm, that joints of an arm in motion bear, without friction."""
        rows = self.rows
        constants = poses.constants_of(rows.robot)
        return joint_loads(self.chain, self.effects, rows.layout, constants, theta[: len(self.slots)], rows.signals)

    def with_rows(self, rows: Rows) -> FitProblem:
        """The same effects on other rows of the same layout."""
        return replace(self, rows=rows)

    def leaning(self, lean: Array | None) -> FitProblem:
        """The same on a robot that leans: see :attr:`clampid.chain.chain.Chain.lean`."""
        return replace(self, chain=replace(self.chain, lean=lean))

    def with_flanks(self, theta: Array) -> FitProblem:
        """The same with flanks and loads frozen where these parameters put them; only poses have any."""
        if self.kind.frozen is None:
            return self
        signals = self.kind.frozen(self.rows, self.chain, theta[: len(self.slots)])
        return replace(self, rows=replace(self.rows, signals=signals))

    def with_slots(self, slots: Sequence[Slot]) -> FitProblem:
        """The same rows with other slots active."""
        return fit_problem(self.rows, self.effects, slots, self.chain.lean)

    def start(self) -> Array:
        """Initial values, which are also the prior mean: amplitudes zero, shapes and shares as declared.

        In ``poses`` springs start at their nominal stiffness. Friction has no effect through an infinitely stiff
        spring, so at an unloaded joint clearance and friction would falsely look distinguishable.
        """
        share = self.kind.spring_start
        own = [p.start if share is None or p.role != "compliance" else share * p.size for p in self.parameters]
        return np.array([*own, *([0.0] * self.offsets)])

    def sizes(self) -> Array:
        """Plausible size of each parameter ``(P + K,)``."""
        return np.array([*(p.size for p in self.parameters), *self._offset_sizes[0]])

    def prior_std(self) -> Array:
        """Standard deviations ``(P + K,)`` of each parameter's prior."""
        std = np.array([*(p.prior_std for p in self.parameters), *self._offset_sizes[1]])
        std = np.where(self.fixed(), FIXED_STD * self.sizes(), std)
        for k, slot in enumerate(self.slots):
            if self.effects[slot.effect].event == slot.parameter:  # somewhere between two rows
                share = self.rows.signals["sweep_progress"] % 1.0
                std[k] = float(np.min(share[share > 0.0], initial=1.0)) / np.sqrt(12.0)
        return std

    @cached_property
    def _offset_sizes(self) -> tuple[list[float], list[float]]:
        """Reasonable sizes of the offsets, and standard deviations of their priors ``(K,)`` each."""
        size: list[float] = []
        prior: list[float] = []
        for _, joint in self.rows.offset_keys:
            kept = joint - self.rows.robot.n
            size.append(self.kind.offset_size if kept < 0 else float(self.rows.sweep.loop_friction[kept]))
            prior.append(WEAK_SPREAD * size[-1] if kept < 0 else size[-1])  # friction at rest is no more than in motion
        return size, prior

    def prior(self) -> tuple[Array, Array]:
        """Precision ``(P + K, P + K)`` and mean ``(P + K,)`` of the prior."""
        precision, mean = np.diag(1.0 / self.prior_std() ** 2), self.start()
        if self.kind.prior is not None:
            precision, mean = self.kind.prior(self.rows, len(self.slots), precision, mean)
        return self._with_statements(precision, mean)

    def _with_statements(self, precision: Array, mean: Array) -> tuple[Array, Array]:
        """A prior combined with the campaigns' statements: for independent errors precisions and their means add."""
        index = {slot: k for k, slot in enumerate(self.slots)}
        at, matrix, value = stated_equations(self.rows.constants.stated, index)
        if len(value):
            weighted = precision[np.ix_(at, at)] @ mean[at] + matrix.T @ value
            precision[np.ix_(at, at)] += matrix.T @ matrix
            mean[at] = linalg.solve(precision[np.ix_(at, at)], weighted, assume_a="pos")
        return precision, mean

    def fixed(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Which parameters ``(P + K,)`` a fit keeps fixed at their initial values."""
        return np.array([*fixed_slots(self.slots, self.effects), *([False] * self.offsets)], dtype=bool)

    def centred(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Which parameters ``(P + K,)`` have a prior about their initial values: those kept there, and orders.

        Of an order, its declared size is how near a search among all orders comes to it.
        """
        orders = [self.effects[slot.effect].order == slot.parameter for slot in self.slots]
        return np.logical_or(self.fixed(), [*orders, *([False] * self.offsets)])

    def own(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Which parameters ``(P + K,)`` belong to single runs or sweeps: their offsets, and what happened in one."""
        events = [self.effects[slot.effect].event is not None for slot in self.slots]
        return np.array([*events, *([True] * self.offsets)], dtype=bool)

    def clear(self) -> Array:
        """Standard errors ``(P + K,)`` below which a parameter counts as identified by the rows, not by its prior."""
        return np.array([*(p.clear for p in self.parameters), *self._offset_sizes[0]])

    def clearances(self, theta: Array) -> Array:
        """Clearances of the joints ``(n,)``, rad, at the slots' values ``theta`` ``(P,)``."""
        out = np.zeros(self.rows.robot.n)
        for k in self.numbers_of("clearance"):
            out[self.slots[k].number] += abs(float(theta[k]))
        return out

    def bounds(self) -> tuple[Array, Array]:
        """Physical limits ``(P + K,)`` each."""
        pairs = [p.bounds for p in self.parameters]
        pairs += [(-np.inf, np.inf)] * self.offsets
        return np.array([a for a, _ in pairs]), np.array([b for _, b in pairs])

    def shapes(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Which parameters ``(P + K,)`` are shapes, not amplitudes."""
        own = [p.shape for p in self.parameters]
        return np.array([*own, *([False] * self.offsets)], dtype=bool)

    def bounded(self) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
        """Which parameters ``(P + K,)`` a fit keeps within their bounds.

        Shapes, shares, and all parameters of a clamped arm, which has no equilibrium otherwise. Other amplitudes may
        leave their physical bounds: that reveals another error, such as negative friction from a mirrored angle.
        """
        own = [p.shape or p.share or self.kind.solved for p in self.parameters]
        return np.array([*own, *([self.kind.solved] * self.offsets)], dtype=bool)


def parameter_of(slot: Slot, effects: Mapping[str, Effect], robot: RobotDescription) -> Parameter:
    """The parameter that a slot is a value of, with unit, size and bounds for this robot's weight and gear there."""
    parameter = replace(find_parameter(slot, effects), unit=unit_of(slot, effects, robot))
    if parameter.moment:
        carries = slot.number if parameter.per in ("joint", "link") else 1
        parameter = parameter.of_weight(own_moment(robot), own_moment(robot, carries))
    if not parameter.gearing:
        return parameter
    joint = slot.number
    own = abs(float(np.asarray(robot.transmission)[joint, joint]))
    return parameter.geared(1.0 / own if own > 0 else 1.0)


def parameter_in(rows: Rows, slot: Slot, effects: Mapping[str, Effect]) -> Parameter:
    """The parameter of a slot in some rows; the arm's part of a friction is hardly larger than all of it in a log."""
    parameter = parameter_of(slot, effects, rows.robot)
    if parameter.role != "arm_friction" or not rows.kind.points or rows.pose.log_friction is None:
        return parameter
    return parameter.no_larger(float(rows.pose.log_friction[slot.number]))


def fit_problem(
    rows: Rows, effects: Mapping[str, Effect], slots: Sequence[Slot], lean: Array | None = None
) -> FitProblem:
    """Rows with the given slots active, on a robot that leans: see :attr:`clampid.chain.chain.Chain.lean`.

    Raises
    ------
    clampid.effect.EffectError
        An effect does not act in the rows' stage.
    """
    chain = build_chain(rows.kind, slots, effects, rows.layout, poses.constants_of(rows.robot))
    return FitProblem(rows, effects, tuple(slots), replace(chain, lean=lean))
