"""Campaigns on the virtual robot, each measured once a session, and their rows as the fit sees them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from clampid.catalogue import catalogue
from clampid.effect import Stage
from clampid.identification.identify import stage_rows
from clampid.stages.layout import layout_of
from clampid.stages.rows import Rows
from experiments.campaign import Campaign, read_campaign
from experiments.signals import MoveMotion
from experiments.signals.typing_ import Array, Integers
from experiments.simulate import simulate

Simulated = Callable[..., Campaign]


@pytest.fixture(scope="session")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Simulated:
    """Measure a campaign, or give the one already measured."""

    @cache
    def make(
        seed: int = 0,
        poses: int = 60,
        tables: tuple[str, ...] | None = None,
        hidden: tuple[str, ...] = (),
        outliers: float = 0.0,
        robot: str = "kuka_kr20_r1810",
    ) -> Campaign:
        folder = tmp_path_factory.mktemp("campaigns") / "arm"
        simulate(folder, robot, list(hidden), seed=seed, poses=poses, tables=tables, outliers=outliers)
        return read_campaign(folder)

    return make


@pytest.fixture(scope="session")
def tiny(simulated: Simulated) -> Campaign:
    """All tables, twelve poses."""
    return simulated(seed=5, poses=12)


@pytest.fixture(scope="session")
def few_rows(simulated: Simulated, tiny: Campaign) -> dict[Stage, Rows]:
    """A few rows of every stage: every tenth second of a log, three sweeps, all poses, and distances."""
    ranged = simulated(seed=5, poses=12, tables=("distances",)).tables["distances"]
    tiny = replace(tiny, tables={**tiny.tables, "distances": ranged})
    layout = layout_of([tiny])
    resting = [catalogue()["presliding_friction"]]
    free_air = stage_rows([tiny], layout, "free_air", active=resting)
    clamped = stage_rows([tiny], layout, "clamped")
    sweeps = np.unique(clamped.fold)[[0, len(np.unique(clamped.fold)) // 2, -1]]
    return {
        "free_air": free_air.take(np.arange(0, len(free_air), 60)),
        "clamped": clamped.take(np.isin(clamped.fold, sweeps)),
        "poses": stage_rows([tiny], layout, "poses"),
    }


@pytest.fixture(scope="session")
def shared_folder() -> Path:
    """Real and blind campaigns, which stand beside the repository where they are at all."""
    folder = Path(__file__).resolve().parents[2].parent / "shared"
    if not folder.is_dir():
        pytest.skip(f"no campaigns at {folder}")
    return folder


@pytest.fixture
def of_another_shape(monkeypatch: pytest.MonkeyPatch) -> None:
    """No move of a log is a trapezoid of speed, so that rows whose ramps lie between samples do not show the motion."""

    def nothing(q: Array, time: Array, run: Integers) -> MoveMotion:
        return MoveMotion(np.zeros(q.shape), np.zeros(q.shape), np.full(q.shape, np.inf))

    monkeypatch.setattr("clampid.stages.log_motion.motion_of_moves", nothing)
