"""The file of an effect of unknown physics: a smooth shape over the variables that a verdict named, to be completed.

What is written works as it stands: Fourier series of angles (of joints with a linear term, for they may turn more than
once), powers of loads, times and temperatures, signs of directions, and the products of these over several variables,
each term with a free factor. It is read back by the same loader as any effect of a user's own.
"""

from __future__ import annotations

import keyword
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType

from clampid.catalogue import catalogue
from clampid.diagnosis.dependence import Dependence, Place, Variable, dependence
from clampid.effect import EffectError, Stage
from experiments.outputs import write_text

__all__ = ["MOST_ORDERS", "effect_module", "effect_new", "effect_text"]

MOST_ORDERS = 12
JOINTS = 6  # axes of a robot, unless stated
ALONE, TOGETHER = 3, 2  # orders of one variable's series, and of each of several

_FILE = '''\
"""{title}: what acts at {at} as a function of {variables}, of a shape that is not known yet.

Written by `clampid effect new {name} --depends-on {comma} --at {at}`.
It works as it stands. Where the physics is known, let `shape` give its few terms, and say below what its parameters
mean, how large they may be, and within which bounds.
"""

from __future__ import annotations

from typing import Any

from clampid.algebra import {imports}
from clampid.effect import Effect, Parameter
{axes}

def shape({arguments}) -> dict[str, Any]:
    """Terms by name, each of order one and none of them constant: zero factors mean that the effect is absent."""
    return {terms}


def deviation(p: Any, x: Any) -> Any:
    """Sum over the terms of factor times term: {formula}."""
    {deviation}


EFFECT = Effect(
    name="{name}",
    family="{name}",
    acts={{"{station}": deviation}},
    parameters={parameters},
    needs=({needs}),
    stages=("{stage}",),
    equation="{formula} = sum_k c_k f_k({comma_space})",
    source=("own measurements",),
    at="{at}",
)
'''
_AXES = '''
AXES = {axes}
"""Turns and shifts, each with factors of its own."""
'''


def effect_new(
    name: str,
    depends_on: Sequence[str],
    at: str,
    *,
    stage: Stage | None = None,
    orders: int | None = None,
    joints: int | None = JOINTS,
    path: str | Path | None = None,
) -> Path:
    """Write the file of an effect with a given dependence, to be completed and handed to any verb.

    Parameters
    ----------
    name
        Of the effect: a Python name that is not in the catalogue.
    depends_on
        Recorded variables by column name without unit, as a verdict gives them: ``q4``, ``dir4``, ``time``.
    at
        Where it acts: ``joint4``, ``motor2``, ``link3``, ``flange``, ``tool``, ``base``, ``fixture``, ``instrument``.
    stage
        ``free_air``, ``clamped`` or ``poses``; by default the first of poses, free_air and clamped that has them all.
    orders
        How fine the shape is: harmonics of an angle, powers of anything else; 3, or 2 of each of several variables.
    joints
        How many axes the robot has; None: not known.
    path
        Where the file goes; by default ``NAME.py`` in the working folder.

    Returns
    -------
    pathlib.Path
        The file.

    Raises
    ------
    EffectError
        The name is none or is taken, a variable or the place does not exist, or the file does.
    """
    target = Path(f"{name}.py" if path is None else path)
    text = effect_text(name, depends_on, at, stage=stage, orders=orders, joints=joints)
    if target.exists():
        raise EffectError(f"{target}: expected a file that does not exist yet, found one")
    write_text(target, text)
    return target


def effect_text(
    name: str,
    depends_on: Sequence[str],
    at: str,
    *,
    stage: Stage | None = None,
    orders: int | None = None,
    joints: int | None = None,
) -> str:
    """The text of the file that :func:`effect_new` writes."""
    if not name.isidentifier() or keyword.iskeyword(name):
        raise EffectError(f"{name!r}: expected a name of letters, digits and _ that does not begin with a digit")
    if name in catalogue():
        raise EffectError(f"{name!r}: the catalogue has an effect of that name; expected another")
    if orders is not None and not 1 <= orders <= MOST_ORDERS:
        raise EffectError(f"orders: expected 1 to {MOST_ORDERS}, found {orders}")
    found = dependence(depends_on, at, stage, joints)
    return _written(name, found, orders or (ALONE if len(depends_on) == 1 else TOGETHER))


def effect_module(text: str) -> ModuleType:
    """The module that a text of :func:`effect_text` is: its ``EFFECT`` and its ``shape``."""
    module = ModuleType("effect_of_unknown_shape")
    exec(compile(text, module.__name__, "exec"), module.__dict__)
    return module


def _written(name: str, found: Dependence, orders: int) -> str:
    place, names = found.place, [v.name for v in found.variables]
    bases, used = zip(*(_terms(v, orders) for v in found.variables), strict=True)
    terms = bases[0] if len(bases) == 1 else f"products({', '.join(bases)})"
    several = place.units if len(place.units) > 1 else {}
    inputs = ", ".join(_input(v, code) for v in found.variables for code in v.code)
    deviation, placing = _deviation(place, f"shape({inputs})")
    arguments = [argument for v in found.variables for argument in v.arguments]
    zeros = ", ".join("0.0" for _ in arguments)
    signals = [f'"{s}"' for s in dict.fromkeys(s for v in found.variables for s in v.signals)]
    return _FILE.format(
        title=name.replace("_", " ").capitalize(),
        name=name,
        at=place.name,
        variables=" and ".join(names),
        comma=",".join(names),
        comma_space=", ".join(names),
        imports=", ".join(sorted({"combined", *placing, *used, *(["products"] if len(bases) > 1 else [])} - {""})),
        axes=_AXES.format(axes=_literal(several)) if several else "",
        arguments=", ".join(f"{argument}: Any" for argument in arguments),
        terms=terms,
        formula=_formula(place),
        deviation=deviation,
        station=place.station,
        parameters=_parameters(place, zeros),
        needs=", ".join(signals) + ("," if len(signals) == 1 else ""),
        stage=found.stage,
    )


def _terms(v: Variable, orders: int) -> tuple[str, str]:
    """The expression of a variable's terms, and the names that it imports from the algebra."""
    match v.basis:
        case "winding" | "fourier" | "powers":
            return f'{v.basis}("{v.name}", {v.name}, {orders})', v.basis
        case "sliding":
            return f'sliding("{v.name}", {", ".join(v.arguments)})', "sliding"
        case _:
            return f'{{"{v.name}": {v.name}}}', ""


def _input(v: Variable, code: str) -> str:
    """How a variable is read from the row's signals, of order one."""
    return code if v.scale == 1.0 or code != v.code[-1] else f"{code} / {v.scale:g}"


def _deviation(place: Place, shape: str) -> tuple[str, tuple[str, ...]]:
    """The body of the deviation, and the names that it imports from the algebra."""
    terms = f"terms = {shape}\n    "
    if len(place.units) == 1:
        return f"{terms}return at_place({place.number}, combined(p, terms), x)", ("at_place",)
    motion = 'combined(p, terms, f"{axis}_") for axis in AXES'
    if place.station == "link_twist":
        return f"{terms}return at_link({place.number}, [{motion}], x)", ("at_link",)
    return f"{terms}return rows(*({motion}))", ("rows",)


def _parameters(place: Place, zeros: str) -> str:
    """The expression of the parameters, a factor for each term, and for each axis where there are several."""
    size = f"{place.size:g}" if place.size >= 1e-3 else f"{place.size:.0e}".replace("e-0", "e-")
    if len(place.units) == 1:
        unit = next(iter(place.units.values()))
        return f'tuple(Parameter(name, "{unit}", {size}, meaning=f"factor of {{name}}") for name in shape({zeros}))'
    return (
        f'tuple(\n        Parameter(f"{{axis}}_{{name}}", unit, {size}, meaning=f"factor of {{name}} in {{axis}}")\n'
        f"        for axis, unit in AXES.items()\n        for name in shape({zeros})\n    )"
    )


def _formula(place: Place) -> str:
    if len(place.units) == 1:
        return f"{'d tau' if 'torque' in place.station else 'dq'}_{place.number}"
    return {"measurement": "dx", "target_shift": "dx in the flange's frame"}.get(place.station, "(w, v)")


def _literal(axes: object) -> str:
    return repr(dict(axes)).replace("'", '"')  # type: ignore[call-overload]
