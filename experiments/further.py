"""The numbers of a further column: one that a table of poses has beyond the contract."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pandas as pd

__all__ = ["numbers"]


def numbers(column: pd.Series) -> npt.NDArray[np.float64]:
    """The numbers of a further column.

    Parameters
    ----------
    column
        As read.

    Returns
    -------
    numpy.ndarray
        ``(N,)``; NaN where a cell is empty or infinite, and everywhere if the column is not one of numbers.
    """
    types = pd.api.types
    if not types.is_numeric_dtype(column) or types.is_bool_dtype(column):
        return np.full(len(column), np.nan)
    values = column.to_numpy(np.float64, na_value=np.nan)
    return np.where(np.isfinite(values), values, np.nan)
