"""A campaign, and its points as a tracker and a controller write them."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from foreign_files import ANGLES, XYZ

from experiments.campaign import Campaign, read_campaign
from experiments.simulate import simulate


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Campaign:
    folder = tmp_path_factory.mktemp("foreign") / "arm"
    tables = ("poses", "verification", "free_air")
    return read_campaign(simulate(folder, robot="kuka_kr20_r1810", poses=20, seed=1, tables=tables))


@pytest.fixture(scope="module")
def points(original: Campaign) -> pd.DataFrame:
    """The first visit's points, in the columns and units of a tracker and a controller."""
    table = original.tables["poses"]
    table = table[table["visit"] == 1].reset_index(drop=True)
    out = pd.DataFrame({"Point": "P" + table["pose"].astype(str), "SMR": table["target"]})
    for i in range(6):
        out[f"A{i + 1}"] = np.rad2deg(table[ANGLES[i]])
    out[["X", "Y", "Z"]] = 1e3 * table[XYZ].to_numpy()
    return out
