"""What a robot, real or virtual, must offer to be commanded: the one seam where a robot link plugs in."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

__all__ = ["RobotLink"]

Array = npt.NDArray[np.float64]


class RobotLink(Protocol):
    """A robot that can be asked where it is, and moved."""

    def posture(self) -> Array:
        """Joint angles now ``(n,)``, rad."""
        ...

    def move(self, postures: Array, speed: float) -> None:
        """Begin a move through postures ``(m, n)``, rad, at a share of the greatest speeds; return at once.

        Raises
        ------
        CallError
            It cannot: another one is under way, the drives are off. The client is told why.
        """
        ...

    def state(self) -> Mapping[str, Any]:
        """What the link says of itself, for JSON."""
        ...

    def stop(self) -> None:
        """Stop at once."""
        ...
