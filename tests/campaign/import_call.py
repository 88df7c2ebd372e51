"""``clampid import`` called in the process."""

from __future__ import annotations

import typer
from click.testing import Result
from typer.testing import CliRunner

from clampid.verbs.import_table import import_table

__all__ = ["call"]


def call(*arguments: object) -> Result:
    """Run ``clampid import`` with these arguments, quietly."""
    app = typer.Typer()
    app.command()(import_table)
    return CliRunner().invoke(app, [*map(str, arguments), "--quiet"])
