"""What holds for all tests."""

from __future__ import annotations

import os

# Parallel runs hand the width of their own terminal on; what is printed is then as wide as a file, as without them.
os.environ.pop("COLUMNS", None)
