"""The memory of a fit does not grow with the log."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pa_parquet
import pytest

from experiments.campaign import write_campaign
from experiments.virtual_robot import measure
from kinematics.description import load_robot

FIT = """
import json, resource, sys
from clampid.identification.identify_folder import identify_folder
model = identify_folder(sys.argv[1], ["gravity", "coulomb_friction", "viscous_friction"])
peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
print(json.dumps({"peak": peak, "noise": model.ledger[0].heldout_rms}))
"""
NUMBER = 8 / 2**20  # MiB


def peak_of(folder: Path, times: int) -> tuple[float, float]:
    """Peak of resident memory in MiB of a fit to a log repeated so many times, and the size of its columns."""
    measured = measure(load_robot("kuka_kr20_r1810"), seed=1, tables=("free_air",))
    table = measured.tables["free_air"]
    table = table[[c for c in table if not str(c).startswith("temp_")]]
    write_campaign(folder, measured.header, {"free_air": table})
    schema = pa.Schema.from_pandas(table, preserve_index=False)
    with pa_parquet.ParquetWriter(folder / "free_air.parquet", schema) as writer:
        for k in range(times):
            part = table.assign(run=table["run"] + 100 * k)
            writer.write_table(pa.Table.from_pandas(part, schema, preserve_index=False))
    done = subprocess.run([sys.executable, "-c", FIT, str(folder)], check=True, capture_output=True, text=True)
    found = json.loads(done.stdout)
    assert found["noise"] < 2.0
    return float(found["peak"]), times * table.size * NUMBER


@pytest.mark.study
def test_twice_the_log_takes_no_more_memory(tmp_path: Path) -> None:
    """Both logs are longer than the buffer in which medians are selected (4 million numbers, 80 repeats are 5)."""
    short, columns = peak_of(tmp_path / "short", 80)
    long, more = peak_of(tmp_path / "long", 160)
    assert more - columns > 130.0
    assert long - short < 30.0
