"""The array type that the package's signatures use."""

import numpy as np
import numpy.typing as npt

__all__ = ["Array", "frozen_array"]

Array = npt.NDArray[np.float64]


def frozen_array(values: npt.ArrayLike) -> Array:
    """
    Copy into a float array that cannot be written to: what frozen dataclasses hold.

    Parameters
    ----------
    values
        Anything that numpy can make an array of.

    Returns
    -------
    Array
        A read-only copy.
    """
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array
