"""A fingerprint of a campaign: equal for equal measurements, whatever the file format."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pa_parquet

from experiments.log_windows import batches

__all__ = ["fingerprint"]


def fingerprint(raw: Mapping[str, Any], tables: Mapping[str, pd.DataFrame | Path]) -> str:
    """Hash the header and all tables.

    Numbers count by value (all as float64), columns by name, rows in their order. The order of keys and columns, the
    names of files and CSV against Parquet make no difference. Extra columns count too; those of dates or other types
    than numbers and text count by their text, which may differ between CSV and Parquet.

    Parameters
    ----------
    raw
        Content of ``campaign.toml``; its ``[tables]`` is left out.
    tables
        The validated tables; or Parquet files of numbers, which are read column by column and piece by piece.

    Returns
    -------
    str
        64 hexadecimal digits.
    """
    digest = hashlib.sha256()
    header = {key: _plain(value) for key, value in raw.items() if key != "tables"}
    digest.update(json.dumps(header, sort_keys=True, default=str).encode())
    for name in sorted(tables):
        for title, cells in _columns(name, tables[name]):
            digest.update(title.encode())
            for piece in cells:
                digest.update(_content(piece))
    return digest.hexdigest()


def _columns(name: str, table: pd.DataFrame | Path) -> Iterator[tuple[str, Iterator[pd.Series]]]:
    """What is hashed of each column: what it is, and its cells, piece by piece."""
    if isinstance(table, pd.DataFrame):
        for column in sorted(map(str, table.columns)):
            yield f"\n{name}/{column}/{len(table)}\n", iter([table[column]])
        return
    with pa_parquet.ParquetFile(table) as file:
        for column in sorted(file.schema_arrow.names):
            pieces = (batch.column(0).to_pandas() for batch in batches(file, [column]))
            yield f"\n{name}/{column}/{file.metadata.num_rows}\n", pieces


def _content(cells: pd.Series) -> bytes:
    if pd.api.types.is_numeric_dtype(cells) and not pd.api.types.is_bool_dtype(cells):
        # Adding zero turns −0.0 into 0.0, which equals it and is printed differently.
        return (cells.to_numpy(dtype="<f8", na_value=np.nan) + 0.0).tobytes()
    return "\x1f".join("" if empty else str(cell) for cell, empty in zip(cells, cells.isna(), strict=True)).encode()


def _plain(value: Any) -> Any:
    """Numbers as floats throughout, since TOML may say 0 or 0.0."""
    if isinstance(value, Mapping):
        return {key: _plain(v) for key, v in value.items()}
    if isinstance(value, list):
        return [_plain(v) for v in value]
    if isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    return value
