"""Why the real robot deviates: effects, the chain, fit, diagnosis, comparison, reports, command line.

What a notebook needs can be had from here, ``from clampid import identify, diagnose``; each is loaded when it is asked
for, so that nothing of the product has to be there for the rest of it.
"""

from __future__ import annotations

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    __version__: str
    from clampid.comparison.compare import compare
    from clampid.diagnosis.diagnose import diagnose
    from clampid.diagnosis.effect_new import effect_new
    from clampid.exports.dh_export import dh_export, dh_table
    from clampid.exports.urdf_export import urdf_export
    from clampid.identification.identify import identify
    from clampid.loop.add import add
    from clampid.loop.auto import auto
    from clampid.loop.undo import undo
    from clampid.models.calibrated import calibrated_chain
    from clampid.models.model import Model, load_model, save_model
    from experiments.campaign import read_campaign
    from experiments.checks.check import check_campaign
    from experiments.simulate import simulate

__all__ = [
    "Model",
    "__version__",
    "add",
    "auto",
    "calibrated_chain",
    "check_campaign",
    "compare",
    "dh_export",
    "dh_table",
    "diagnose",
    "effect_new",
    "identify",
    "load_model",
    "read_campaign",
    "save_model",
    "simulate",
    "undo",
    "urdf_export",
]

_HOME = {
    "Model": "clampid.models.model",
    "add": "clampid.loop.add",
    "auto": "clampid.loop.auto",
    "calibrated_chain": "clampid.models.calibrated",
    "check_campaign": "experiments.checks.check",
    "compare": "clampid.comparison.compare",
    "dh_export": "clampid.exports.dh_export",
    "dh_table": "clampid.exports.dh_export",
    "diagnose": "clampid.diagnosis.diagnose",
    "effect_new": "clampid.diagnosis.effect_new",
    "identify": "clampid.identification.identify",
    "load_model": "clampid.models.model",
    "read_campaign": "experiments.campaign",
    "save_model": "clampid.models.model",
    "simulate": "experiments.simulate",
    "undo": "clampid.loop.undo",
    "urdf_export": "clampid.exports.urdf_export",
}


def __getattr__(name: str) -> Any:
    if name == "__version__":
        return version("clampid")
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *__all__])
