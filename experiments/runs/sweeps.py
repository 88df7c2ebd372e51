"""Runs a plan for a clamped robot (placeholder while logs and poses are tried)."""
from experiments.runs.context import Context
def run_sweeps(context: Context) -> str | None:
    raise NotImplementedError
