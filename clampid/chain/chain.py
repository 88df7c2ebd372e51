"""The chain: the stations in their order, and the one compiled function that says what all effects do there.

For each stage the effects' deviations at a station add. What a station computes (joint torques, the flank on which
they press) is a signal for the later ones, so that a spring can use a torque without knowing whose it is. The result
is one casadi function of a row's signals and of the parameters, with its derivatives.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import casadi as ca
import numpy as np
import numpy.typing as npt

from clampid.chain.compiled import Rowwise
from clampid.chain.piecewise import Piecewise
from clampid.chain.row_symbols import offer_friction_state, offer_torque, symbols_of
from clampid.chain.stage_chain import StageChain
from clampid.chain.steady import Steady, parted
from clampid.effect import SIGNALS, Effect, EffectError
from clampid.slots import Layout, Slot

__all__ = ["FOLLOWING", "Chain", "Deviations", "Gains", "build_chain", "recorded"]


Array = npt.NDArray[np.float64]

FOLLOWING = ("flank", "sag_torque")
"""Signals of a row at rest that follow the parameters."""


@dataclass(frozen=True)
class Deviations:
    """Deviations of all rows at all stations of a stage, with derivatives, sparse over (station, parameter).

    Attributes
    ----------
    values
        ``(N, S)``, the stations' entries in the order of the chain's outputs.
    partials
        ``(N, nonzeros)``: d values / d parameters.
    station, parameter
        ``(nonzeros,)``: which entry of S, in their order, and which parameter each column of ``partials`` belongs to.
    by_torque
        ``(N, S, n)``: d values / d joint torque, where that is unknown of an equilibrium; else None.
    """

    values: Array
    partials: Array
    station: npt.NDArray[np.int64]
    parameter: npt.NDArray[np.int64]
    by_torque: Array | None = None


class Gains(NamedTuple):
    """Gains of torque readings, each of one motor: with L what gain g scales, the deviation is g L.

    Attributes
    ----------
    number, motor
        ``(G,)``: number among the chain's slots, and the motor that is read, from 0.
    loaded
        ``(P,)``: which parameters are part of L, in which each has the derivative that it has at that motor alone.
    """

    number: npt.NDArray[np.int64]
    motor: npt.NDArray[np.int64]
    loaded: npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Chain:
    """The compiled deviations of a set of slots in one stage.

    Attributes
    ----------
    offsets
        Station → slice of the entries S.
    least
        What each slot ``(P,)`` counts as at least where it decides on flanks: see :func:`least_deciding`.
    affine
        Whether the derivatives are the same at all parameters: no slot is a shape, no torque another effect's load.
    scales
        Numbers of the slots that scale what a motor reads (the role ``reading_gain``).
    steady
        In ``poses``: what is apart of ``function`` and ``yield_function``, because no search changes it; or None.
    flank_function
        In ``poses``, where an effect reads flanks: what decides on them. Else None.
    yield_function
        In ``poses``, where an effect reads loads: by how much the joints give way. Else None.
    lean
        ``(n, 3)``, rad: by what the weight's torque at each joint decides on its flank beside its friction, though it
        is no load; see :mod:`clampid.fitting.open_flanks`. None: the robot is level.
    """

    stage: StageChain
    slots: tuple[Slot, ...]
    offsets: Mapping[str, slice]
    signals: tuple[tuple[str, int], ...]
    function: Rowwise | Piecewise
    station: npt.NDArray[np.int64]
    parameter: npt.NDArray[np.int64]
    least: Array
    flank_function: Rowwise | None = None
    yield_function: Rowwise | None = None
    lean: Array | None = None
    affine: bool = False
    steady: Steady | None = None
    scales: tuple[int, ...] = ()

    @cached_property
    def gains(self) -> Gains:
        """The gains of readings; none where the torque that they scale is not linear in parameters."""
        none = Gains(np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(len(self.slots), dtype=bool))
        if not self.scales:
            return none
        number = np.array(self.scales, dtype=np.int64)
        own = np.flatnonzero(np.isin(self.parameter, number))
        motor = self.station[own] - self.offsets["motor_torque"].start
        theta, row = self._symbols()
        loads = ca.densify(self.function.function(theta, row)[1][own.tolist()])
        loaded = np.zeros(len(self.slots), dtype=bool)
        loaded[np.unique(ca.jacobian_sparsity(loads, theta).get_triplet()[1]).astype(np.int64)] = True
        bends = self._bends(number)
        if len(own) != len(number) or np.any(motor < 0) or np.any(loaded & bends) or loaded[number].any():
            return none
        if ca.depends_on(ca.densify(ca.jacobian(loads, theta)), theta):
            return none
        return Gains(self.parameter[own], motor, loaded)

    def _symbols(self) -> tuple[Any, Any]:
        """Parameters and signals of the chain's function as symbols."""
        return ca.SX.sym("theta", len(self.slots)), ca.SX.sym("row", self.function.function.nnz_in(1))

    def _bends(self, zero: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
        """Of which parameters ``(P,)`` derivatives depend on parameters, where those of some numbers are ``zero``."""
        theta, row = self._symbols()
        every = ca.SX(theta)
        every[zero.tolist()] = 0.0
        derivatives = self.function.function(every, row)[1]
        depend = np.unique(ca.jacobian_sparsity(derivatives, theta).get_triplet()[0]).astype(np.int64)
        out = np.zeros(len(self.slots), dtype=bool)
        out[self.parameter[depend]] = True
        out[zero] = False
        return out

    @cached_property
    def moves_one(self) -> npt.NDArray[np.int64]:
        """Which columns of the partials belong to a parameter that moves no other entry of S."""
        _, which, count = np.unique(self.parameter, return_inverse=True, return_counts=True)
        return np.flatnonzero(count[which] == 1)

    @cached_property
    def runs(self) -> list[tuple[int, slice]]:
        """The entries of S that parameters move, and which columns of the partials are of each."""
        edges = [0, *(np.flatnonzero(np.diff(self.station)) + 1).tolist(), len(self.station)]
        return [(int(self.station[i]), slice(i, j)) for i, j in pairwise(edges) if j > i]

    @cached_property
    def bends(self) -> npt.NDArray[np.bool_]:
        """Of which parameters ``(P,)`` derivatives depend on parameters beside `gains`; all others are linear."""
        return self._bends(self.gains.number)

    @cached_property
    def bent(self) -> Chain:
        """The chain of those parameters alone, all others zero; of the stage ``free_air``, which has no flanks."""
        own = np.flatnonzero(self.bends)
        theta = ca.SX.sym("theta", len(own))
        blocks = self._blocks()
        every = ca.SX(len(self.slots), 1)
        every[own.tolist()] = theta
        values, derivatives = self.function.function(every, ca.vertcat(*blocks))
        kept = np.flatnonzero(self.bends[self.parameter])
        outputs = [values, derivatives[kept.tolist()]]
        signals, read = self._read(blocks, ca.vertcat(*outputs))
        return replace(
            self,
            slots=tuple(self.slots[k] for k in own),
            signals=signals,
            function=Piecewise(ca.Function("bent", [theta, read], outputs), self.station[kept]),
            station=self.station[kept],
            parameter=np.searchsorted(own, self.parameter[kept]),
            least=self.least[own],
            affine=False,
            scales=(),
        )

    @property
    def once(self) -> Chain:
        """The same for a single evaluation; of a stage at rest."""
        flank, yields = (None if f is None else f.once for f in (self.flank_function, self.yield_function))
        function = self.function.once if isinstance(self.function, Rowwise) else self.function
        return replace(self, function=function, flank_function=flank, yield_function=yields)

    def derivatives_from(self, first: int) -> Chain:
        """The derivatives by the slots from the ``first`` on, without the deviations."""
        kept = np.flatnonzero(self.parameter >= first)
        theta, blocks = ca.SX.sym("theta", len(self.slots)), self._blocks()
        _, derivatives = self.function.function(theta, ca.vertcat(*blocks))
        wanted = derivatives[kept.tolist()] if len(kept) else ca.SX(0, 1)
        signals, read = self._read(blocks, wanted)
        return replace(
            self,
            signals=signals,
            function=Piecewise(ca.Function("derivatives", [theta, read], [ca.SX(0, 1), wanted]), self.station[kept]),
            station=self.station[kept],
            parameter=self.parameter[kept],
        )

    def _blocks(self) -> list[Any]:
        """The signals as symbols, one by one."""
        return [ca.SX.sym(name, width) for name, width in self.signals]

    def _read(self, blocks: Sequence[Any], wanted: Any) -> tuple[tuple[tuple[str, int], ...], Any]:
        """Which signals some expressions read, and their symbols in one column.

        Regressors of masses are most of a row's numbers, and to copy them takes longer than all else.
        """
        read = [k for k, block in enumerate(blocks) if ca.depends_on(wanted, block)]
        return tuple(self.signals[k] for k in read), ca.vertcat(*(blocks[k] for k in read))

    @cached_property
    def moves_several(self) -> npt.NDArray[np.int64]:
        """The other columns."""
        return np.setdiff1d(np.arange(len(self.parameter)), self.moves_one)

    def evaluate(self, theta: Array, signals: Mapping[str, Array], torque: Array | None = None) -> Deviations:
        """Deviations at parameters ``theta`` ``(P,)`` for rows of signals; ``torque`` ``(N, n)`` in ``clamped``."""
        out = self.function(theta, *self._columns(signals, torque))
        by_torque = None
        if self.stage.solved:
            by_torque = out[2].reshape(len(out[0]), -1, out[0].shape[1]).transpose(0, 2, 1)
        values, partials = out[:2]
        if self.steady is not None:
            apart = self._apart(theta, signals)
            self.steady.add(values, apart, theta)
            partials = self.steady.joined(apart, partials)
        return Deviations(values, partials, self.station, self.parameter, by_torque)

    def pressing(self, theta: Array, signals: Mapping[str, Array]) -> Array | None:
        """Torques ``(N, n)``, Nm, whose signs are the flanks, at ``theta`` ``(P,)``; None where no effect reads any."""
        if self.flank_function is None:
            return None
        level = self.flank_function(np.maximum(theta, self.least), *self._columns(signals, None))[0]
        return level if self.lean is None else level + np.einsum("njx,jx->nj", signals["lean_torque"], self.lean)

    def yields(self, theta: Array, signals: Mapping[str, Array]) -> Array | None:
        """By how much the joints are off what was commanded ``(N, n)``, rad; None where no effect reads loads."""
        if self.yield_function is None:
            return None
        found = self.yield_function(theta, *self._columns(signals, None))[0]
        if self.steady is not None:
            self.steady.add(found, self._apart(theta, signals), theta, self.offsets["joint_angle"].start)
        return found

    def _apart(self, theta: Array, signals: Mapping[str, Array]) -> Array:
        """The steady partials of these rows."""
        if self.steady is None:
            raise ValueError("expected a chain with steady partials, found one without")
        return self.steady.partials(theta, tuple(recorded(signals, name) for name, _ in self.steady.signals))

    def _columns(self, signals: Mapping[str, Array], torque: Array | None) -> list[Array]:
        columns = []
        count = next(len(v) for v in signals.values())
        for name, width in self.signals:
            values = torque if name == "torque" and self.stage.solved else recorded(signals, name)
            if values is None:
                raise ValueError(
                    f"the chain of the stage {self.stage.name} needs the joint torques it is to be evaluated at"
                )
            columns.append(np.reshape(values, (count, width)))
        return columns or [np.zeros((count, 0))]

    @property
    def reads_flanks(self) -> bool:
        """Whether the pose stage's flanks matter to any effect."""
        return self.stage.resting and any(name == "flank" for name, _ in self.signals)


def recorded(signals: Mapping[str, Array], name: str) -> Array:
    """A row's signal of that name.

    Raises
    ------
    EffectError
        It is that of a sensor that no table has.
    """
    if name not in signals and name not in SIGNALS:
        column = f"{name}_C" if name.startswith("temp_") else name
        raise EffectError(f"an effect of the model reads {name}, and these tables have no column {column}")
    return signals[name]


def build_chain(
    stage: StageChain,
    slots: Sequence[Slot],
    effects: Mapping[str, Effect],
    layout: Layout,
    constants: Mapping[str, Array],
) -> Chain:
    """Compile the deviations of ``slots`` in a stage.

    Parameters
    ----------
    constants
        What effects may read of the nominal robot: :func:`clampid.stages.poses.constants_of`.

    Raises
    ------
    EffectError
        A slot's effect does not act in this stage, or reads a signal that it did not declare.
    """
    active = [effects[name] for name in dict.fromkeys(slot.effect for slot in slots)]
    for effect in active:
        if not stage.has(effect):
            raise EffectError(
                f"effect {effect.name} does not act in {stage.name}; it does in: {', '.join(effect.stages)}"
            )
    theta, row = symbols_of(slots, active, layout, constants)
    offer_friction_state(row, stage, active)
    offer_torque(row, stage, active)
    values, offsets, start = [], {}, 0
    for station in stage.outputs:
        value = ca.vec(row.total(station, active).T)
        values.append(value)
        offsets[station] = slice(start, start + value.shape[0])
        start += value.shape[0]
    stacked = ca.densify(ca.vertcat(*values))
    # Of poses no derivative is asked for by what a fit holds: it would keep the sines of angle curves from being apart.
    free = np.array(
        [k for k, slot in enumerate(slots) if not stage.resting or not _held(slot, effects)], dtype=np.int64
    )
    jacobian = ca.jacobian(stacked, theta[free.tolist()] if len(free) < len(slots) else theta)
    station_of, parameter_of = (np.array(v, dtype=np.int64) for v in jacobian.sparsity().get_triplet())
    by_station = np.argsort(station_of, kind="stable")
    station_of, parameter_of = station_of[by_station], free[parameter_of[by_station]]
    partials = jacobian.nz[by_station.tolist()] if jacobian.nnz() else ca.SX(0, 1)
    affine, steady = not ca.depends_on(partials, theta), None
    if stage.resting:
        apart = parted(theta, free, row.flats, FOLLOWING, stacked, partials, station_of, parameter_of)
        if apart is not None:
            stacked, partials, steady = apart
    outputs = [stacked, partials]
    if stage.solved:
        outputs.append(ca.densify(ca.jacobian(stacked, row.flats["torque"])))
    pressing = None
    if stage.resting and "flank" in row.flats:
        # A joint without load rests on the side it came from; any load beyond that decides the flank.
        pressing = ca.densify(row.offered["torque"] + row.recorded("rest_direction"))
    yields = None
    if "sag_torque" in row.flats and ca.depends_on(stacked, row.flats["sag_torque"]):
        yields = ca.densify(stacked[offsets["joint_angle"]])
    inputs = [theta, ca.vertcat(*row.flats.values())]
    function = ca.Function("deviations", inputs, outputs)
    widths = tuple((name, flat.shape[0]) for name, flat in row.flats.items())
    least = least_deciding(slots, effects)
    return Chain(
        stage,
        tuple(slots),
        offsets,
        widths,
        (Piecewise(function, station_of) if stage.moving else Rowwise(function)),
        station_of,
        parameter_of,
        least,
        None if pressing is None else Rowwise(ca.Function("pressing", inputs, [pressing])),
        None if yields is None else Rowwise(ca.Function("yields", inputs, [yields])),
        affine=affine,
        steady=steady,
        scales=tuple(k for k, s in enumerate(slots) if effects[s.effect].by_name[s.parameter].role == "reading_gain"),
    )


def _held(slot: Slot, effects: Mapping[str, Effect]) -> bool:
    return effects[slot.effect].by_name[slot.parameter].fixed == "everywhere"


def least_deciding(slots: Sequence[Slot], effects: Mapping[str, Effect]) -> Array:
    """What each slot ``(P,)`` counts as at least where it decides on which flank a gear rests; -inf: as it is.

    An estimate of dry friction may come out below zero by its error, and does where it is hardly known. Friction may
    not: it would press an unloaded joint on the flank that it has just left, all its flanks at once.
    """
    out = np.full(len(slots), -np.inf)
    for k, slot in enumerate(slots):
        effect = effects[slot.effect]
        if "joint_torque" in effect.acts and "joint_motion" in effect.needs:
            out[k] = effect.by_name[slot.parameter].bounds[0]
    return out
