"""What a notebook imports from the top of the package."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import version

import pytest

import clampid


def test_every_name_is_there():
    for name in clampid.__all__:
        value = getattr(clampid, name)
        assert value == version("clampid") if name == "__version__" else value.__name__ == name
        assert name in dir(clampid)


def test_what_is_not_there_is_said():
    with pytest.raises(AttributeError, match="'clampid' has no attribute 'identfy'"):
        _ = clampid.identfy


def test_nothing_is_loaded_before_it_is_asked_for():
    program = "import sys, clampid; print('casadi' in sys.modules); clampid.identify; print('casadi' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["False", "True"]
