"""The kinds of arrays that signals come in."""

import numpy as np
import numpy.typing as npt

__all__ = ["Array", "Bools", "Integers"]

Array = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Bools = npt.NDArray[np.bool_]
