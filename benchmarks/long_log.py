"""Gravity and friction from a log in Parquet that is never held whole: time, and the memory it takes at most.

    python benchmarks/long_log.py [--rows 1000000] [--keep FOLDER]

The log is written to a temporary folder first (``--rows 10000000`` is the full size: about 1.7 GB), or taken from the
folder of an earlier run with ``--keep``. Then each way that a user has to fit it runs in a process of its own: Python,
``clampid check`` and ``clampid identify``; time and that process' peak of resident memory are printed.
"""

from __future__ import annotations

import argparse
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

IMPORTS = "import clampid.identification.identify_folder"
FIT = """
import sys
from clampid.identification.identify_folder import identify_folder
model = identify_folder(sys.argv[1])
print(f"{len(model.stages['free_air'].slots)} parameters, held out {model.ledger[0].heldout_rms:.4f} times the noise")
"""
VERB = "from clampid.cli import main; raise SystemExit(main())"


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


def run(*arguments: str) -> tuple[str, float, float, float]:
    """What a Python process prints; how long it takes by the clock and of the processor, s; and its peak, MiB."""
    start = perf_counter()
    with tempfile.TemporaryFile("w+", encoding="utf-8") as out:
        process = subprocess.Popen([sys.executable, "-c", *arguments], stdout=out)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            raise SystemExit(f"{arguments[1:]} ended with {process.returncode}")
        out.seek(0)
        return out.read(), perf_counter() - start, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rows", type=int, default=1_000_000)
    parser.add_argument("--keep", type=Path, help="keep the log here; if there is one already, it is taken")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        start, folder = perf_counter(), asked.keep or Path(scratch) / "log"
        if not (folder / "campaign.toml").is_file():
            write_log(folder, asked.rows)
        file = folder / "free_air.parquet"
        rows, size = pa_parquet.read_metadata(file).num_rows, file.stat().st_size / 2**20
        print(f"{rows} rows, {size:.0f} MiB, there after {perf_counter() - start:.0f} s")
        model = str(Path(scratch) / "model.json")
        for name, arguments in (
            ("imports alone", (IMPORTS,)),
            ("identify_folder", (FIT, str(folder))),
            ("clampid check", (VERB, "check", str(folder), "--quiet")),
            ("clampid identify", (VERB, "identify", str(folder), "-o", model, "--quiet")),
        ):
            said, wall, cpu, peak = run(*arguments)
            said = said if arguments[0] == FIT else ""  # the verbs' own tables are not wanted here
            print(
                f"{name:18}{wall:8.1f} s, of the processor {cpu:8.1f} s, peak {peak:6.0f} MiB  {said.strip()}",
                flush=True,
            )


if __name__ == "__main__":
    main()
