"""Fixed campaigns with their fits and first verdicts: what a change that is no change of physics leaves alone.

    PYTHONPATH=. python tests/core/fixed_fits.py

writes ``fixed_fits.json`` beside this file anew. Do so only where numbers are meant to change, and say so.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from clampid.diagnosis.diagnose import diagnose
from clampid.effect import Stage
from clampid.identification.identify import identify
from clampid.models.model import Model
from experiments.campaign import Campaign, read_campaign
from experiments.simulate import simulate

KEPT = Path(__file__).parent / "fixed_fits.json"
REAL = ("tx40_current_log", "ur10_series_c")
POSES: dict[Stage, tuple[str, ...]] = {
    "poses": ("geometry", "joint_compliance", "backlash", "gravity", "wrist_coupling_friction")
}
SWEEPS: dict[Stage, tuple[str, ...]] = {"clamped": ("joint_compliance", "backlash", "coulomb_friction")}
WEIGHTLESS: dict[Stage, tuple[str, ...]] = {"free_air": ("coulomb_friction", "viscous_friction")}
MOVING: dict[Stage, tuple[str, ...]] = {
    "free_air": ("gravity", "coulomb_friction", "viscous_friction", "wrist_coupling_friction", "inertia")
}
# fit → robot, seed, poses, tables, effects
FITS: dict[str, tuple[str, int, int, tuple[str, ...] | None, dict[Stage, tuple[str, ...]] | None]] = {
    "all tables": ("kuka_kr20_r1810", 5, 60, None, None),
    "log with accelerations": ("kuka_kr20_r1810", 8, 20, ("free_air", "wrist"), MOVING),
    "poses alone": ("staubli_tx40", 7, 60, ("poses",), None),
}
# case → what is hidden, seed, tables, start model
VERDICTS: dict[str, tuple[tuple[str, ...], int, tuple[str, ...], dict[Stage, tuple[str, ...]] | None]] = {
    "stribeck": (("stribeck_friction",), 3, ("free_air", "wrist"), None),
    "no gravity": ((), 3, ("free_air", "wrist"), WEIGHTLESS),
    "fixture": (("fixture_compliance",), 4, ("clamped",), SWEEPS),
    "tilt": (("base_tilt",), 6, ("poses",), POSES),
    "eccentric gear": (("gear_eccentricity",), 1, ("poses",), POSES),
    "expansion": (("thermal_expansion",), 2, ("poses",), POSES),
}


def measured(robot: str, hidden: tuple[str, ...], seed: int, poses: int, tables: tuple[str, ...] | None) -> Campaign:
    """A seeded campaign on the virtual robot."""
    with tempfile.TemporaryDirectory() as folder:
        simulate(Path(folder) / "arm", robot, list(hidden), seed=seed, poses=poses, tables=tables)
        return read_campaign(Path(folder) / "arm")


def as_table(model: Model) -> dict[str, dict[str, list[float]]]:
    """Stage → slot → value and standard error, SI, of what rows tell; the rest is prior."""
    out: dict[str, dict[str, list[float]]] = {}
    for name, stage in model.stages.items():
        std = stage.covariance.diagonal() ** 0.5
        out[name] = {
            slot.label: [float(f"{stage.theta[k]:.8g}"), float(f"{std[k]:.8g}")]
            for k, slot in enumerate(stage.slots)
            if stage.identified[k]
        }
    return out


def fitted(case: str, shared: Path | None = None) -> dict[str, dict[str, list[float]]]:
    """The fit of a case: simulated, or of a folder of that name in ``shared/real``."""
    if shared is not None:
        return as_table(identify(read_campaign(shared / "real" / case)))
    robot, seed, poses, tables, effects = FITS[case]
    return as_table(identify(measured(robot, (), seed, poses, tables), effects))


def verdict(case: str) -> Mapping[str, list[str]]:
    """Stage → the verdict in a word and its first name."""
    hidden, seed, tables, effects = VERDICTS[case]
    campaign = measured("kuka_kr20_r1810", hidden, seed, 60, tables)
    found = diagnose(identify(campaign, effects), campaign).stages
    return {name: [str(s.verdict), *(str(c["effect"]) for c in s.candidates[:1])] for name, s in found.items()}


def main() -> None:
    shared = Path(__file__).resolve().parents[2].parent / "shared"
    kept: dict[str, Any] = {
        "fits": {case: fitted(case) for case in FITS},
        "real": {case: fitted(case, shared) for case in REAL},
        "verdicts": {case: verdict(case) for case in VERDICTS},
    }
    KEPT.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
