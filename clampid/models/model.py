"""A model: one robot, its active effects with values and covariance, what data they came from, and the ledger.

It is one JSON file that a person can read. Nothing in it is changed in place: every step gives a new model.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np

from clampid.effect import Stage
from clampid.fitting.base_names import BaseParameter, base_json, read_base
from clampid.fitting.bootstrap import Bootstrap
from clampid.models.checked import check_model
from clampid.models.migrations import MIGRATIONS
from clampid.models.ranges import Ranges, read_ranges
from clampid.models.stage_json import bootstrap_json, carried_prior_json, read_bootstrap, read_carried_prior
from clampid.shown import Shown
from clampid.slots import Layout, Prior, Slot, Term
from clampid.stages.rows import Array
from clampid.stages.stage_kind import StageKind, kind_of
from experiments.outputs import write_text
from kinematics.reading import json_of, read_text
from kinematics.section import migrated, shown

__all__ = ["FORMAT", "Model", "ModelError", "Round", "Session", "StageModel", "load_model", "save_model"]


FORMAT = "clampid-model/2"


class ModelError(ValueError):
    """A model file that is not one, or does not fit the campaign; the message says what was expected."""


@dataclass(frozen=True)
class Session:
    """One campaign that the model was fitted on.

    Attributes
    ----------
    base_reference
        ``(4, 4)``: where the instrument sees the nominal base, before the fitted motion of the base; None without
        poses.
    tool_com, gravity
        ``(3,)`` each: the declared tool's centre of mass, m, flange frame, and gravity, m/s², base frame; None in
        models of earlier versions.
    anchors
        Where each anchor of distances, ``(3,)`` m, was before its fitted shift, in the instrument's frame.
    """

    name: str
    fingerprint: str
    base_reference: Array | None
    targets: tuple[str, ...]
    tool_mass: float
    temperature: tuple[float, float] | None = None
    tool_com: tuple[float, ...] | None = None
    gravity: tuple[float, ...] | None = None
    anchors: Mapping[str, Array] = field(default_factory=dict)


@dataclass(frozen=True, repr=False)
class StageModel:
    """The active effects of one stage with their values.

    Attributes
    ----------
    theta, covariance
        ``(P,)`` and ``(P, P)``, SI, in the order of ``slots``.
    identified
        Whether the data determine each parameter to within its reasonable size.
    held_out
        Folds (poses, runs or sweeps, by their numbers in the campaign, one tuple per session) kept out of the fit.
    outliers
        (session, table, row from 1) of the rows rejected.
    null_directions
        What these data cannot determine, in words.
    base
        The combinations of masses, first moments and inertias that torques can determine; of ``free_air`` only.
    observability
        Indices O1 … O5 of the fitted rows, and of how many ``parameters``; see `clampid.fitting.observability`.
    bootstrap
        Standard errors and intervals by drawing whole poses anew, where that was asked for.
    carried_prior
        Of a joint fit: what all but this stage's rows say of its parameters, so that it can be fitted again without
        counting any row twice; else None.
    lean
        ``(n, 3)``, rad, of poses: how the robot leans as far as flanks determine, see `fitting.open_flanks`; else None.
    by_springs
        ``(P, n)``, of ``free_air``: how the parameters follow the springs, see :mod:`clampid.fitting.log_springs`; None
        where not known.
    ranges
        Of poses: on what they were fitted, see :mod:`clampid.models.ranges`; None where a model file does not say.
    """

    stage: Stage
    terms: tuple[Term, ...]
    slots: tuple[Slot, ...]
    theta: Array
    covariance: Array
    identified: tuple[bool, ...]
    held_out: tuple[tuple[int, ...], ...] = ()
    outliers: tuple[tuple[int, str, int], ...] = ()
    null_directions: tuple[str, ...] = ()
    base: tuple[BaseParameter, ...] = ()
    observability: Mapping[str, float] = field(default_factory=dict)
    bootstrap: Bootstrap | None = None
    carried_prior: Prior | None = None
    lean: Array | None = None
    by_springs: Array | None = None
    ranges: Ranges | None = None

    @property
    def kind(self) -> StageKind:
        """The stage as a value."""
        return kind_of(self.stage)

    def __repr__(self) -> str:
        names = ", ".join(dict.fromkeys(term.effect for term in self.terms))
        return f"<StageModel: {self.stage}: {names}; {sum(self.identified)} of {len(self.slots)} parameters identified>"

    @property
    def std(self) -> Array:
        """Standard errors ``(P,)``."""
        return np.sqrt(np.maximum(np.diag(self.covariance), 0.0))

    def values(self) -> dict[Slot, float]:
        """Slot → value."""
        return {slot: float(v) for slot, v in zip(self.slots, self.theta, strict=True)}


@dataclass(frozen=True)
class Round:
    """One line of the ledger: what a step made active in a stage, and the error it reached.

    Errors are root mean squares: metres in ``poses``, units of the motors' noise elsewhere.
    """

    stage: Stage
    effects: tuple[str, ...]
    added: tuple[str, ...]
    rms: float
    heldout_rms: float
    noise_floor: float
    evidence: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, repr=False)
class Model(Shown):
    """What is known of one particular robot.

    Attributes
    ----------
    joint
        From all tables in one fit, see :mod:`clampid.identification.joint`.
    robot_file
        Where the campaign's description of the robot is; None of a bundled one, and in models of earlier versions.
    """

    robot: str
    layout: Layout
    stages: Mapping[Stage, StageModel]
    sessions: tuple[Session, ...]
    ledger: tuple[Round, ...] = ()
    seed: int = 0
    holdout: float = 0.0
    user_effects: str | None = None
    joint: bool = False
    robot_file: str | None = None

    def title(self) -> str:
        """The robot, and the effects of each stage."""
        parts = [f"{name}: {', '.join(dict.fromkeys(t.effect for t in s.terms))}" for name, s in self.stages.items()]
        return f"{self.robot}; {'; '.join(parts)}"

    def records(self) -> list[dict[str, Any]]:
        """The parameters of all stages; what is not identified has no value that counts."""
        return [
            {"stage": name, "effect": slot.effect, "parameter": slot.parameter, "at": slot.place, "value": value,
             "std": std, "identified": known}
            for name, s in self.stages.items()
            for slot, value, std, known in zip(s.slots, s.theta.tolist(), s.std.tolist(), s.identified, strict=True)
        ]  # fmt: skip

    def errors(self) -> dict[str, tuple[str, dict[str, float | None]]]:
        """Stage → the errors of its last round in the ledger."""
        last = {r.stage: r for r in self.ledger}
        return {
            name: (kind_of(name).error_unit, {"fitted": r.rms, "held out": r.heldout_rms,
                                                         "noise floor": r.noise_floor})
            for name, r in last.items()
        }  # fmt: skip

    def with_stage(self, stage: StageModel) -> Model:
        """The same model with one stage replaced."""
        return replace(self, stages={**self.stages, stage.stage: stage})


def save_model(model: Model, path: str | Path) -> None:
    """Write a model as readable JSON, through a temporary name."""
    write_text(path, json.dumps(_to_json(model), indent=1, allow_nan=False) + "\n")


def load_model(path: str | Path) -> Model:
    """Read a model.

    Raises
    ------
    ModelError
        The file does not exist, is no JSON, or is no model of this format.
    """
    try:
        data = json_of(read_text(path))
    except FileNotFoundError:
        raise ModelError(f"{path}: expected a model file, found none") from None
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise ModelError(f"{path}: expected a model as JSON, found: {error}") from error
    except OSError as error:
        raise ModelError(f"{path}: cannot be read: {error.strerror}") from error
    if not isinstance(data, dict):
        raise ModelError(f"{path}: expected a model, found {shown(data)}")
    try:
        data = migrated(data, FORMAT, MIGRATIONS)
        check_model(data)
    except ValueError as error:
        raise ModelError(f"{path}: {error}") from None
    try:
        return _with_files_beside(_from_json(data), Path(path))
    except (KeyError, TypeError, IndexError, AttributeError, ValueError) as error:
        raise ModelError(f"{path}: a model with a part missing or spoiled: {type(error).__name__}: {error}") from error


def _with_files_beside(model: Model, path: Path) -> Model:
    """The same model; a user's files that are not where it says are looked for beside the model's own file."""

    def found(file: str | None) -> str | None:
        if file is None or Path(file).is_file():
            return file
        beside = path.parent / Path(file).name
        return str(beside) if beside.is_file() else file

    return replace(model, user_effects=found(model.user_effects), robot_file=found(model.robot_file))


def _to_json(model: Model) -> dict[str, Any]:
    return {
        "format": FORMAT,
        "robot": model.robot,
        "robot_file": model.robot_file,
        "layout": {
            "joints": model.layout.joints,
            "targets": list(model.layout.targets),
            "anchors": list(model.layout.anchors),
            "sessions": list(model.layout.sessions),
            "wrist": list(model.layout.wrist),
        },
        "seed": model.seed,
        "holdout": model.holdout,
        "user_effects": model.user_effects,
        "joint": model.joint,
        "sessions": [
            {
                "name": s.name,
                "fingerprint": s.fingerprint,
                "base_reference": None if s.base_reference is None else s.base_reference.tolist(),
                "targets": list(s.targets),
                "anchors_m": {anchor: place.tolist() for anchor, place in s.anchors.items()},
                "tool_mass_kg": s.tool_mass,
                "temperature_C": None if s.temperature is None else list(s.temperature),
                "tool_com_m": None if s.tool_com is None else list(s.tool_com),
                "gravity_m_s2": None if s.gravity is None else list(s.gravity),
            }
            for s in model.sessions
        ],
        "stages": {name: _stage_json(stage) for name, stage in model.stages.items()},
        "ledger": [
            {
                "stage": r.stage,
                "effects": list(r.effects),
                "added": list(r.added),
                "rms": r.rms,
                "heldout_rms": r.heldout_rms,
                "noise_floor": r.noise_floor,
                "evidence": dict(r.evidence),
            }
            for r in model.ledger
        ],
    }


def _stage_json(stage: StageModel) -> dict[str, Any]:
    parameters = [
        {"effect": s.effect, "parameter": s.parameter, "at": s.place, "value": v, "std": sd, "identified": ok}
        for s, v, sd, ok in zip(stage.slots, stage.theta.tolist(), stage.std.tolist(), stage.identified, strict=True)
    ]
    return {
        "effects": [term.label for term in stage.terms],
        "parameters": parameters,
        "covariance": stage.covariance.tolist(),
        "held_out": [list(folds) for folds in stage.held_out],
        "outliers": [{"session": s, "table": t, "row": r} for s, t, r in stage.outliers],
        "not_identifiable": list(stage.null_directions),
        "base_parameters": [base_json(parameter) for parameter in stage.base],
        "observability": dict(stage.observability),
        "bootstrap": None if stage.bootstrap is None else bootstrap_json(stage.bootstrap),
        "told": None if stage.carried_prior is None else carried_prior_json(stage.carried_prior),
        "lean_rad": None if stage.lean is None else stage.lean.tolist(),
        "by_springs": None if stage.by_springs is None else stage.by_springs.tolist(),
        "ranges": None if stage.ranges is None else stage.ranges.to_json(),
    }


def _vector(data: list[float] | None) -> tuple[float, ...] | None:
    return None if data is None else tuple(float(v) for v in data)


def _from_json(data: Mapping[str, Any]) -> Model:
    layout = data["layout"]
    stages: dict[Stage, StageModel] = {}
    for name, part in data["stages"].items():
        slots = tuple(Slot(p["effect"], p["parameter"], p["at"]) for p in part["parameters"])
        terms = []
        for label in part["effects"]:
            effect, _, place = label.partition("@")
            terms.append(Term(effect, place or None))
        stages[name] = StageModel(
            stage=name,
            terms=tuple(terms),
            slots=slots,
            theta=np.array([p["value"] for p in part["parameters"]], dtype=float),
            covariance=np.array(part["covariance"], dtype=float).reshape(len(slots), len(slots)),
            identified=tuple(bool(p["identified"]) for p in part["parameters"]),
            held_out=tuple(tuple(int(f) for f in folds) for folds in part["held_out"]),
            outliers=tuple((int(o["session"]), str(o["table"]), int(o["row"])) for o in part["outliers"]),
            null_directions=tuple(part["not_identifiable"]),
            base=tuple(read_base(p) for p in part["base_parameters"]),
            observability={name: float(v) for name, v in part["observability"].items()},
            bootstrap=read_bootstrap(part["bootstrap"]),
            carried_prior=read_carried_prior(part["told"]),
            lean=None if part["lean_rad"] is None else np.array(part["lean_rad"], dtype=float),
            by_springs=None if part["by_springs"] is None else np.array(part["by_springs"], dtype=float),
            ranges=read_ranges(part["ranges"]),
        )
    sessions = tuple(
        Session(
            name=s["name"],
            fingerprint=s["fingerprint"],
            base_reference=None if s["base_reference"] is None else np.array(s["base_reference"], dtype=float),
            targets=tuple(s["targets"]),
            tool_mass=float(s["tool_mass_kg"]),
            temperature=None if s["temperature_C"] is None else (s["temperature_C"][0], s["temperature_C"][1]),
            tool_com=_vector(s["tool_com_m"]),
            gravity=_vector(s["gravity_m_s2"]),
            anchors={anchor: np.array(place, dtype=float) for anchor, place in s["anchors_m"].items()},
        )
        for s in data["sessions"]
    )
    ledger = tuple(
        Round(
            stage=cast(Stage, r["stage"]),
            effects=tuple(r["effects"]),
            added=tuple(r["added"]),
            rms=float(r["rms"]),
            heldout_rms=float(r["heldout_rms"]),
            noise_floor=float(r["noise_floor"]),
            evidence=r["evidence"],
        )
        for r in data["ledger"]
    )
    return Model(
        robot=data["robot"],
        layout=Layout(
            joints=int(layout["joints"]),
            targets=tuple(layout["targets"]),
            anchors=tuple(layout["anchors"]),
            sessions=tuple(layout["sessions"]),
            wrist=tuple(layout["wrist"]),
        ),
        stages=stages,
        sessions=sessions,
        ledger=ledger,
        seed=int(data["seed"]),
        holdout=float(data["holdout"]),
        user_effects=data["user_effects"],
        joint=bool(data["joint"]),
        robot_file=data["robot_file"],
    )
