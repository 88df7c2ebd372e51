"""What holds for all tests."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from program_server import forked_program

# Parallel runs hand the width of their own terminal on; what is printed is then as wide as a file, as without them.
os.environ.pop("COLUMNS", None)


@pytest.fixture(autouse=True)
def _compiler_as_before() -> Iterator[None]:
    """``ik`` and ``sample`` say for their process that nothing is to be compiled; in tests others follow in it."""
    before = os.environ.get("CLAMPID_COMPILER")
    yield
    os.environ.pop("CLAMPID_COMPILER", None)
    if before is not None:
        os.environ["CLAMPID_COMPILER"] = before


@pytest.fixture(scope="session")
def program() -> Iterator[Path]:
    """The command ``clampid``: each call in a process of its own, forked from one that has imported it."""
    with forked_program() as command:
        yield command
