"""The drives in the report: springs and clearances marked where the loops are, the compliance matrix, the fixture."""

from __future__ import annotations

import numpy as np
import pytest

from clampid.catalogue import catalogue
from clampid.charts import Cells, Line, Points
from clampid.identification.identify import identify
from clampid.identification.model_on_campaign import on_campaign
from clampid.models.drives import drives_of
from clampid.report.drives import drives_section
from clampid.report.loops import loops_figure
from clampid.report.stage_data import StageData, stage_data
from clampid.report.style import Figure, Table
from experiments.campaign import read_campaign
from experiments.simulate import simulate


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> StageData:
    folder = simulate(tmp_path_factory.mktemp("drives") / "arm", seed=5, tables=("clamped",))
    campaign = read_campaign(folder)
    return stage_data(on_campaign(identify(campaign), campaign))["clamped"]


def test_slopes_and_clearances_are_where_the_loops_are(data: StageData):
    drives = drives_of(data.model, data.first.rows.robot)
    plot = loops_figure(data).plot
    marks = [m for m in plot.named("spring and clearance") if isinstance(m, Line)]
    assert len(marks) == 6
    for joint, mark in enumerate(marks):
        x, y = np.radians(np.array(mark.x, float)), np.array(mark.y, float)
        for a, b in ((0, 1), (2, 3)):
            if y[a] != y[b]:
                assert (y[b] - y[a]) / (x[b] - x[a]) == pytest.approx(drives.stiffness[joint], rel=1e-5)
        own = data.first.rows.robot.transmission[joint][joint]
        assert x[2] - x[1] == pytest.approx(drives.gap[joint] / abs(own), abs=1e-9)
        loop = next(m for m in plot.panels[joint].named("measured") if isinstance(m, Points))
        assert np.array(loop.x).min() <= np.degrees(x).min() + 0.1 * np.ptp(loop.x)
        assert np.degrees(x).max() <= np.array(loop.x).max() + 0.1 * np.ptp(loop.x)


def test_the_line_runs_in_the_middle_of_the_loop(data: StageData):
    """Without friction, a forward branch lies as far above it as a backward one below."""
    mark = next(m for m in loops_figure(data).plot.named("spring and clearance") if isinstance(m, Line))
    rows = np.flatnonzero((data.first.rows.sweep.driven == 0) & (data.first.rows.series.run == 0))
    angle = data.first.rows.signals["motor"][rows, 0]
    off = data.first.rows.measured[rows, 0] - np.interp(np.degrees(angle - angle.mean()), mark.x, mark.y)
    motion = data.first.rows.signals["motor_motion"][rows, 0]
    used = data.first.good[rows, 0]
    friction = drives_of(data.model, data.first.rows.robot).friction[0]
    assert np.mean(off[used & (motion > 0)]) == pytest.approx(friction, rel=0.15)
    assert np.mean(off[used & (motion < 0)]) == pytest.approx(-friction, rel=0.15)


def test_the_section_has_table_matrix_and_fixture(data: StageData):
    section = drives_section(data)
    assert section is not None
    table, matrix, fixture = section.blocks
    assert isinstance(table, Table)
    assert len(table.rows) == 6
    assert isinstance(matrix, Figure)
    drives = drives_of(data.model, data.first.rows.robot)
    (cells,) = matrix.plot.panels[0].marks
    assert isinstance(cells, Cells)
    z = cells.values
    np.testing.assert_allclose(np.diag(z), 1.0)
    assert z[3, 4] == pytest.approx(
        drives.compliance[3, 4] / np.sqrt(drives.compliance[3, 3] * drives.compliance[4, 4])
    )
    assert " ± " in cells.texts[3][4]
    assert isinstance(fixture, Figure)
    sensor = [m for m in fixture.plot.named("sensor") if isinstance(m, Points)]
    assert len(sensor) == 6
    assert 1.0 < np.std(sensor[0].y) < 10.0  # its noise of 3 µm, in µm


def test_no_section_without_springs(data: StageData):
    assert drives_section(None) is None
    assert "watched_fixture" in catalogue()
