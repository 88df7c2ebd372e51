"""The signals and parameters of a row as casadi symbols, and what stations offer to the later ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from clampid.chain.stage_chain import StageChain
from clampid.effect import SIGNALS, STATIONS, Effect, EffectError, signal
from clampid.roles import WEIGHTS, Role
from clampid.slots import Layout, Slot

__all__ = ["RowSymbols", "load_of", "offer_friction_state", "offer_torque", "symbols_of"]

Array = npt.NDArray[np.float64]
MOMENTS = ("base_moment", "transverse_moment", "link_moment", "link_force")

_INTERNAL: Mapping[str, tuple[str | int, ...]] = {
    "gravity_torque": ("n",),
    "sag_torque": ("n",),
    "rest_direction": ("n",),
    "wrench_map": (6, "n"),
    "base_moment_regressor": (3, "4n"),
    "transverse_moment_regressor": ("3n", "4n"),
    "link_moment_regressor": ("3n", "4n"),
    "link_force_regressor": ("3n", "4n"),
}


def size_of(shape: tuple[str | int, ...], layout: Layout) -> tuple[int, ...]:
    """The shape in numbers, where a layout says how many joints, targets, anchors and sessions there are."""
    counts = {
        "n": layout.joints,
        "2n": 2 * layout.joints,
        "3n": 3 * layout.joints,
        "4n": 4 * layout.joints,
        "6n": 6 * layout.joints,
        "m": len(layout.targets),
        "a": len(layout.anchors),
        "s": len(layout.sessions),
    }
    return tuple(counts[k] if isinstance(k, str) else k for k in shape)


def symbol_of(name: str, shape: tuple[int, ...]) -> tuple[Any, Any]:
    """A symbol to be filled from a row-major block, and the expression of that shape."""
    flat = ca.SX.sym(name, int(np.prod(shape, dtype=int)))
    if len(shape) < 2:
        return flat, flat
    return flat, ca.reshape(flat, shape[1], shape[0]).T


class RowSymbols:
    """The signals of a row as symbols, made when they are first read, and the sums of deviations at stations."""

    def __init__(
        self,
        layout: Layout,
        constants: Mapping[str, Array],
        parameters: Mapping[str, SimpleNamespace],
        active: Sequence[Effect],
    ) -> None:
        self.layout, self.parameters = layout, parameters
        self.constants = {name: ca.DM(value) for name, value in constants.items()}
        self.flats: dict[str, Any] = {}
        self.offered: dict[str, Any] = {}
        self.shift = weight_shift(active, parameters)

    def recorded(self, name: str) -> Any:
        """A signal as it comes with the row."""
        if name not in self.offered:
            known = signal(name)
            shape = _INTERNAL[name] if known is None else known.shape
            self.flats[name], self.offered[name] = symbol_of(name, size_of(shape, self.layout))
        return self.offered[name]

    def read(self, name: str) -> Any:
        """A signal as effects see it: loads on base, bearings and links follow the masses as they are now."""
        if name not in MOMENTS or self.shift is None:
            return self.recorded(name)
        by_mass = self.recorded(f"{name}_regressor") @ self.shift
        shape = size_of(SIGNALS[name].shape, self.layout)
        return self.recorded(name) + (by_mass if len(shape) == 1 else ca.reshape(by_mass, shape[1], shape[0]).T)

    def total(self, station: str, only: Sequence[Effect]) -> Any:
        """The sum of the effects' deviations at a station."""
        value = ca.SX(*_matrix(size_of(STATIONS[station][0], self.layout)))
        for effect in only:
            if station in effect.acts:
                x = SimpleNamespace(**self.constants, **{name: self.read(name) for name in effect.needs})
                try:
                    value = value + effect.acts[station](self.parameters[effect.name], x)
                except AttributeError as error:
                    raise EffectError(f"effect {effect.name} reads what it does not declare: {error}") from error
                except (IndexError, RuntimeError) as error:  # casadi says the latter
                    raise EffectError(
                        f"effect {effect.name} does not fit a robot of {self.layout.joints} joints: {error}"
                    ) from error
        return value


def symbols_of(
    slots: Sequence[Slot], active: Sequence[Effect], layout: Layout, constants: Mapping[str, Array]
) -> tuple[Any, RowSymbols]:
    """The values of slots ``(P,)`` as symbols, and the row that the ``active`` effects, theirs, read with these."""
    theta, index = ca.SX.sym("theta", len(slots)), {slot: k for k, slot in enumerate(slots)}
    parameters = {effect.name: parameter_columns(effect, layout, index, theta) for effect in active}
    return theta, RowSymbols(layout, constants, parameters, active)


def offer_friction_state(row: RowSymbols, stage: StageChain, active: Sequence[Effect]) -> None:
    """Let the motors' dry friction follow the state that effects give it, instead of the sign of the last motion."""
    acting = [e for e in active if "friction_state" in e.acts]
    if stage.moving and acting:
        row.offered["motor_motion"] = row.recorded("motor_motion") + row.total("friction_state", acting)


def offer_torque(row: RowSymbols, stage: StageChain, active: Sequence[Effect]) -> None:
    """Offer joint torques, the flank they press on, and the wrench on a clamp, to the effects that read them."""
    if stage.solved:
        torque = row.recorded("torque")
        # Inside the gap the torque is nearly zero and the flank undecided: a smooth sign whose width is far below
        # the noise keeps the equilibrium solvable by Newton's method.
        row.offered["flank"] = torque / ca.sqrt(torque**2 + row.recorded("rest_direction") ** 2)
        if any("wrench" in effect.needs for effect in active):
            row.offered["wrench"] = row.recorded("wrench_map") @ torque
    elif any({"torque", "flank"} & set(effect.needs) for effect in active):
        row.offered["torque"] = load_of(row, stage, active)
        on_load = [e for e in active if "joint_torque" in e.acts and "torque" in e.needs]
        if stage.resting and on_load:  # friction on a load holds against it, and winds up springs as any other does
            row.offered["torque"] = row.offered["torque"] + row.total("joint_torque", on_load)


def load_of(row: RowSymbols, stage: StageChain, active: Sequence[Effect]) -> Any:
    """The torque ``(n,)`` that each joint bears outside of clamps, before effects that act on it."""
    load = [e for e in active if "joint_torque" in e.acts and "torque" not in e.needs]
    if stage.moving:  # friction acts on the load, not on itself
        load = [e for e in load if not any(known.sided for known in map(signal, e.needs) if known)]
    weight = row.recorded("gravity_torque")
    if stage.resting:  # of the arm where it stands, not where it was commanded
        weight = weight + row.recorded("sag_torque")
    if stage.moving:
        weight = weight + row.recorded("inertia_torque")
    return weight + row.total("joint_torque", load)


def _matrix(shape: tuple[int, ...]) -> tuple[int, int]:
    return (shape[0], shape[1]) if len(shape) == 2 else (shape[0], 1)


_WEIGHT_ORDER: tuple[tuple[Role, str], ...] = (("mass", ""), *(("first_moment", a) for a in "xyz"))


def weight_shift(active: Sequence[Effect], parameters: Mapping[str, SimpleNamespace]) -> Any:
    """How far the links' (m, m c) ``(4n,)`` are from the description's, or None if they are as described."""
    shift = None
    for effect in active:
        named = {(p.role, p.axis): p.name for p in effect.parameters if p.role in WEIGHTS and p.per == "link"}
        if named:
            columns = [getattr(parameters[effect.name], named[key]) for key in _WEIGHT_ORDER]
            own = ca.vec(ca.horzcat(*columns).T)
            shift = own if shift is None else shift + own
    return shift


def parameter_columns(effect: Effect, layout: Layout, index: Mapping[Slot, int], theta: Any) -> SimpleNamespace:
    """An effect's parameters as columns; where a slot is not active its amplitude is zero, its shape the start."""
    found = {}
    for parameter in effect.parameters:
        places = layout.places(effect, parameter)
        column = ca.SX(len(places), 1)
        if parameter.shape:
            column = ca.SX(ca.DM.ones(len(places), 1) * parameter.grid[0])
        for i, place in enumerate(places):
            slot = Slot(effect.name, parameter.name, place)
            if slot in index:
                column[i] = theta[index[slot]]
        found[parameter.name] = column
    return SimpleNamespace(**found)
