"""Campaigns of logs and poses, each measured once a session."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import pytest

from experiments.campaign import Campaign, read_campaign
from experiments.simulate import simulate

Simulated = Callable[..., Campaign]


@pytest.fixture(scope="session")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Simulated:
    """Measure a campaign, or give the one already measured."""

    @cache
    def make(
        *hidden: str,
        seed: int = 1,
        poses: int = 200,
        tables: tuple[str, ...] = ("free_air", "wrist", "poses", "verification"),
        robot: str = "kuka_kr20_r1810",
    ) -> Campaign:
        folder = tmp_path_factory.mktemp("campaigns") / "arm"
        simulate(folder, robot, list(hidden), seed=seed, poses=poses, tables=tables)
        return read_campaign(folder)

    return make
