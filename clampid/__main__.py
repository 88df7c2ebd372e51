"""``python -m clampid``: the same as ``clampid``."""

from clampid.cli import main

main()
