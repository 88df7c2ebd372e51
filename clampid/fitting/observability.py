"""Observability indices of planned or fitted measurements: five scalar measures of the scaled Jacobian.

With s_1 ≥ … ≥ s_L the singular values and m the number of measured values::

    O1 = (s_1 ⋯ s_L)^(1/L) / √m   Menq and Borm: the volume, as D-optimality
    O2 = s_L / s_1                Driels and Pathre: the inverse condition number
    O3 = s_L                      Nahvi, Hollerbach and Hayward: the worst direction, as E-optimality
    O4 = s_L² / s_1               Nahvi and Hollerbach: noise amplification
    O5 = 1 / (1/s_1 + … + 1/s_L)  Sun and Hollerbach: after A-optimality

Sources: Borm, Menq, Determination of optimal measurement configurations for robot calibration based on observability
measure, IJRR 10, 1991; Driels, Pathre, Significance of observation strategy on the design of robot calibration
experiments, J. Robotic Systems 7, 1990; Nahvi, Hollerbach, Hayward, ICRA 1994; Nahvi, Hollerbach, The noise
amplification index for optimal pose selection in robot calibration, ICRA 1996; Sun, Hollerbach, Observability index
selection for robot calibration, ICRA 2008.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

__all__ = ["index_words", "observability", "projected"]

Array = npt.NDArray[np.float64]


def observability(information: Array, rows: int) -> dict[str, float]:
    """The five indices O1 to O5, and the number of ``parameters`` (directions) that they are of.

    Directions with an eigenvalue below 1, whose standard error exceeds a reasonable size, are not counted: they are
    reported as not identified, and would make every index zero.

    Parameters
    ----------
    information
        Jᵀ J ``(P, P)`` of the whitened Jacobian, with parameters in units of their reasonable sizes.
    rows
        Number of measured values, m.
    """
    values = np.linalg.eigvalsh(information) if information.size else np.zeros(0)
    s = np.sqrt(values[values >= 1.0])[::-1]
    if not len(s):
        return {"O1": 0.0, "O2": 0.0, "O3": 0.0, "O4": 0.0, "O5": 0.0, "parameters": 0.0}
    return {
        "O1": float(np.exp(np.mean(np.log(s))) / np.sqrt(max(rows, 1))),
        "O2": float(s[-1] / s[0]),
        "O3": float(s[-1]),
        "O4": float(s[-1] ** 2 / s[0]),
        "O5": float(1.0 / np.sum(1.0 / s)),
        "parameters": float(len(s)),
    }


def projected(information: Array, count: int) -> Array:
    """Information ``(count, count)`` on the first parameters with the others eliminated (Schur complement)."""
    A, B, C = information[:count, :count], information[:count, count:], information[count:, count:]
    return A - B @ np.linalg.pinv(C, rcond=1e-10) @ B.T if C.size else A


def index_words(indices: Mapping[str, float]) -> str:
    """One line for people with the indices of :func:`observability`."""
    named = ", ".join(f"{name} {value:.3g}" for name, value in indices.items() if name != "parameters")
    return (
        f"observability of {indices['parameters']:.0f} combinations of parameters: {named} (larger is better; use "
        "them to compare measurements for one set of parameters)"
    )
