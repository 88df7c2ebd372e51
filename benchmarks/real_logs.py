"""Held-out torques of real logs: R² of the last fifth for each motor, beside a regression.

The first four fifths are fitted by `identify`, or with ``--auto`` by `auto`, the last fifth is predicted. Beside it a
regression of each motor's torque on rigid-body dynamics, rotor, dry and viscous friction and a constant, with the same
speeds and accelerations.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from clampid.comparison.compare import compare
from clampid.identification.identify import identify
from clampid.loop.auto import auto
from clampid.stages.log_facts import facts_of, log_parts
from experiments.campaign import Campaign, read_campaign


def part_of(campaign: Campaign, first: float, last: float) -> Campaign:
    """The rows of the log from one share of it to another."""
    table = campaign.tables["free_air"]
    rows = slice(round(first * len(table)), round(last * len(table)))
    tables = MappingProxyType({"free_air": table.iloc[rows].reset_index(drop=True)})
    return replace(campaign, tables=tables, fingerprint=f"{campaign.fingerprint}, rows {rows.start} to {rows.stop}")


def main() -> None:
    """Print a line per motor."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("campaign", type=Path, nargs="+", help="folders with a log of one run")
    parser.add_argument("--auto", action="store_true", help="add what is missing until nothing more is confirmed")
    parser.add_argument("--effects", default="", help="effects of the stage, with commas; default: the standard set")
    options = parser.parse_args()
    for folder in options.campaign:
        whole = read_campaign(folder)
        first, last = part_of(whole, 0.0, 0.8), part_of(whole, 0.8, 1.0)
        began = time.process_time()
        wanted = options.effects.split(",") if options.effects else None
        model = auto([first], wanted)[0] if options.auto else identify(first, wanted)
        seconds = time.process_time() - began
        facts = facts_of(log_parts([first]))
        way = facts.motions.way
        source = "recorded speeds" if way.logged else "positions"
        print(f"{folder.name}: {seconds:.0f} s of CPU; motion from {source} over {1e3 * way.window_s:.0f} ms")
        motors = compare(model, last).tables["free_air"]["per_motor"]
        for k, (motor, regression) in enumerate(zip(motors, facts.regression, strict=True), start=1):
            print(
                f"  motor {k}: R² {motor['r2']:.4f}, {motor['rms_Nm']:.3f} Nm rms; a regression leaves at most "
                f"{regression:.3f} Nm of rows that it has not seen"
            )
        print(f"  R² at the median {np.median([m['r2'] for m in motors]):.4f}")


if __name__ == "__main__":
    main()
