"""Links and controllers that end with their test."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from fake_controller import FakeController

from experiments.links import connection
from experiments.links.address import LinkAddress
from experiments.links.eki import EkiLink, connect


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Connect again soon: tests do it a thousand times."""
    monkeypatch.setattr(connection, "FIRST_WAIT", 0.002)


@pytest.fixture
def controller() -> Iterator[FakeController]:
    with FakeController() as found:
        yield found


@pytest.fixture
def link(controller: FakeController) -> Iterator[EkiLink]:
    found = connect(LinkAddress("eki", "127.0.0.1", controller.port))
    yield found
    found.close()
