"""Gravity and friction from a log in Parquet that is never held whole: time, and the memory it takes at most.

    python benchmarks/long_log.py [--rows 1000000] [--keep FOLDER]

The log is written to a temporary folder first (``--rows 10000000`` is the full size: about 1.5 GB), fitted in
a process of its own, and that process' peak of resident memory is printed, beside that of one that only imports.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from time import perf_counter

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pa_parquet
from virtual_log import rows_of, virtual_log

from experiments.campaign import write_campaign
from kinematics.description import load_robot

TEMPLATE_ROWS = 100_000  # of the virtual robot; a longer log repeats them with noise of its own
NOISE = 0.05  # Nm

FIT = """
import json, resource, sys, time
from clampid.identify_folder import identify_folder
def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
before = peak()
out = {"before": before}
if len(sys.argv) > 1:
    start, cpu = time.perf_counter(), time.process_time()
    model = identify_folder(sys.argv[1])
    stage = model.stages["free_air"]
    out |= {"wall": time.perf_counter() - start, "cpu": time.process_time() - cpu, "peak": peak(),
            "parameters": len(stage.slots), "heldout": model.ledger[0].heldout_rms}
print(json.dumps(out))
"""


def write_log(folder: Path, rows: int) -> Path:
    """A campaign folder with a free-air log of so many rows."""
    header, tables = virtual_log(load_robot("kuka_kr20_r1810"))
    template = rows_of(tables, min(rows, TEMPLATE_ROWS))
    template = template[[c for c in template if not str(c).startswith("temp_")]]
    write_campaign(folder, header, {"free_air": template})
    rng = np.random.default_rng(0)
    torques = [c for c in template if str(c).startswith("tau")]
    runs, span = int(template["run"].max()), float(template["time_s"].max()) + 10.0
    schema = pa.Schema.from_pandas(template, preserve_index=False)
    with pa_parquet.ParquetWriter(folder / "free_air.parquet", schema) as writer:
        for k in range(-(-rows // len(template))):
            part = template[: rows - k * len(template)].copy()
            part["run"] += k * runs
            part["time_s"] = (part["time_s"] + k * span).round(3)
            part[torques] += NOISE * rng.standard_normal((len(part), len(torques)))
            writer.write_table(pa.Table.from_pandas(pd.DataFrame(part), schema, preserve_index=False))
    return folder


def run(*arguments: str) -> dict[str, float]:
    """What the process that fits says of itself."""
    done = subprocess.run([sys.executable, "-c", FIT, *arguments], check=True, capture_output=True, text=True)
    return dict(json.loads(done.stdout))


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--keep", type=Path, help="write the log here and keep it")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        start = perf_counter()
        folder = write_log(asked.keep or Path(scratch) / "log", asked.rows)
        size = (folder / "free_air.parquet").stat().st_size / 2**20
        print(f"{asked.rows} rows written, {size:.0f} MiB, in {perf_counter() - start:.0f} s")
        found = run(str(folder))
    print(f"fitted, {found['parameters']:.0f} parameters: {found['wall']:.0f} s, of the processor {found['cpu']:.0f} s")
    print(f"error on held-out runs: {found['heldout']:.4f} times the noise")
    print(f"peak of resident memory: {found['peak']:.0f} MiB; with the imports alone: {found['before']:.0f} MiB")


if __name__ == "__main__":
    main()
