"""The suite's own EthernetKRL link drives the virtual controller; both know only the config files."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from controller_client import HOME, STEP, Controller, Inside, inside

from experiments.links.eki import EkiLink
from experiments.links.protocol import LinkError, Phase, Program


@contextmanager
def linked(robot: Controller) -> Iterator[EkiLink]:
    link = EkiLink(*robot.at["listening"], "Nm", "A")
    try:
        link.wait_connected(5.0)
        yield link
    finally:
        link.close()


def test_link_moves_the_robot_and_reads_its_recording(tmp_path: Path) -> None:
    with inside(tmp_path / "truth.json", speed=20.0) as robot, linked(robot) as link:
        number = link.execute(Program(np.radians([HOME + STEP, HOME]), 1.0))
        assert link.wait(number, 10.0).phase is Phase.FINISHED
        recording = link.recording(1, 300)
        assert np.array_equal(recording.number, np.arange(1, len(recording.number) + 1))
        assert np.ptp(np.degrees(recording.joints[:, 0])) > 0.5
        assert robot.said(1) == [(1, number, 0)]
        assert robot.said(3) == [(1, number, 2)]


@pytest.mark.parametrize("cut", range(0, 420, 20))
def test_cut_link_moves_once_or_says_that_it_does_not_know(cut: int, shared: Inside) -> None:
    shared.fresh(200.0)
    boot = shared.boot
    shared.hang_up()
    with linked(shared) as link:
        shared.line("operator", f"fault drop-after={cut}" if cut < 340 else f"fault drop-after=motion:sent:{cut - 340}")
        number = link.execute(Program(np.radians([HOME + STEP, HOME]), 1.0))
        try:
            phase = link.wait(number, 10.0).phase
        except LinkError:
            phase = Phase.UNKNOWN
        shared.line("operator", "fault drop-after=10000000")
        time.sleep(0.05)
        accepted = [said for said in shared.said(1) if said[0] == boot]
        finished = [said for said in shared.said(3) if said[0] == boot]
        assert len(accepted) <= 1
        assert (phase is Phase.FINISHED) <= (finished == [(boot, number, 2)])
        assert (phase is Phase.NOT_EXECUTED) <= (accepted == [])


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Inside]:
    with inside(tmp_path_factory.mktemp("truth") / "truth.json", speed=200.0) as one:
        yield one
