"""C source that evaluates a casadi function of single rows for eight rows at once, one in each lane of a vector.

casadi writes C for one row, which no compiler turns into vector instructions; yet the fit of a log is as fast as this
function. The vectors are the extension that GCC and clang have in common. What depends on the parameters alone is
computed once, before the rows.
"""

from __future__ import annotations

import ctypes
from math import isfinite
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

__all__ = ["Lanes", "lanes_source"]

Array = npt.NDArray[np.float64]

_ARITHMETIC = {
    ca.OP_ASSIGN: "{0}",
    ca.OP_ADD: "{0} + {1}",
    ca.OP_SUB: "{0} - {1}",
    ca.OP_MUL: "{0} * {1}",
    ca.OP_DIV: "{0} / {1}",
    ca.OP_NEG: "-{0}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "{0} + {0}",
    ca.OP_INV: "1.0 / {0}",
    ca.OP_LT: "TRUTH({0} < {1})",
    ca.OP_LE: "TRUTH({0} <= {1})",
    ca.OP_EQ: "TRUTH({0} == {1})",
    ca.OP_NE: "TRUTH({0} != {1})",
    ca.OP_NOT: "TRUTH({0} == zero)",
    ca.OP_AND: "TRUTH(({0} != zero) & ({1} != zero))",
    ca.OP_OR: "TRUTH(({0} != zero) | ({1} != zero))",
    ca.OP_IF_ELSE_ZERO: "(lanes)((bits)({0} != zero) & (bits){1})",
    ca.OP_SIGN: "EITHER({0} == {0}, TRUTH({0} > zero) - TRUTH({0} < zero), {0})",
    ca.OP_FMIN: "EITHER(({0} < {1}) | ({1} != {1}), {0}, {1})",
    ca.OP_FMAX: "EITHER(({0} > {1}) | ({1} != {1}), {0}, {1})",
}
_FUNCTIONS = {
    ca.OP_SIN: "sin",
    ca.OP_COS: "cos",
    ca.OP_TAN: "tan",
    ca.OP_EXP: "exp",
    ca.OP_LOG: "log",
    ca.OP_SQRT: "sqrt",
    ca.OP_FABS: "fabs",
    ca.OP_TANH: "tanh",
    ca.OP_ATAN: "atan",
    ca.OP_FLOOR: "floor",
    ca.OP_CEIL: "ceil",
}
_FUNCTIONS_OF_TWO = {ca.OP_ATAN2: "atan2"}
# Which glibc's libmvec has for whole vectors, right to four units of the last bit.
_VECTORS = ("sin", "cos", "exp", "log")
_HEAD = """#include <math.h>
typedef double lanes __attribute__((vector_size(8 * sizeof(double))));
typedef long long bits __attribute__((vector_size(8 * sizeof(long long))));
#define TRUTH(c) ((lanes)((bits)(c) & (bits)one))
#define EITHER(c, a, b) ((lanes)(((bits)(c) & (bits)(a)) | (~(bits)(c) & (bits)(b))))
#if defined(__GLIBC__) && defined(__x86_64__) && !defined(__clang__)
#define VECTOR(f) extern double f(double) __attribute__((simd("notinbranch")));
#else
#define VECTOR(f)
#endif
#define BY_LANE(f) \\
  static inline __attribute__((always_inline)) void lanes_##f(lanes *y, const lanes *x) \\
  { \\
    const double *from = (const double *)x; \\
    double *to = (double *)y; \\
    _Pragma("omp simd") for (int k = 0; k < 8; ++k) to[k] = f(from[k]); \\
  }
#define BY_LANE_OF_TWO(f) \\
  static inline __attribute__((always_inline)) void lanes_##f(lanes *y, const lanes *a, const lanes *b) \\
  { for (int k = 0; k < 8; ++k) (*y)[k] = f((*a)[k], (*b)[k]); }
"""


class Lanes:
    """A compiled `lanes_source`, called as `clampid.chain.compiled.Blocks` are.

    Raises
    ------
    OSError
        The library cannot be loaded.
    """

    def __init__(self, function: Any, library: Path) -> None:
        self.function = function
        self._run = getattr(ctypes.CDLL(str(library)), function.name())
        self._run.restype = None
        self._run.argtypes = [ctypes.c_long, ctypes.c_void_p, ctypes.c_long, *[ctypes.c_void_p] * 3]

    def __call__(self, theta: Array, *columns: Array) -> list[Array]:
        """Evaluate at ``theta`` for rows whose columns come in blocks ``(N, k)`` one beside the other."""
        blocks = [np.ascontiguousarray(block, dtype=np.float64) for block in columns]
        theta = np.ascontiguousarray(theta, dtype=np.float64)
        widths, count = np.array([b.shape[1] for b in blocks], dtype=np.int64), len(blocks[0])
        expected = self.function.nnz_in(0), self.function.nnz_in(1), count
        found = theta.size, int(widths.sum()), min(len(b) for b in blocks)
        if found != expected:
            raise ValueError(f"expected {expected} parameters, columns and rows, found {found}")
        results = [np.empty((count, self.function.nnz_out(i))) for i in range(self.function.n_out())]
        rows, places = (np.array([a.ctypes.data for a in arrays], dtype=np.uintp) for arrays in (blocks, results))
        given = theta.ctypes.data, len(blocks), widths.ctypes.data, rows.ctypes.data, places.ctypes.data
        self._run(count, *given)
        return results


def lanes_source(function: Any) -> str | None:
    """C source of ``void NAME(count, theta, blocks, widths, rows, results)``, which evaluates ``count`` rows.

    Parameters
    ----------
    function
        A ``casadi.Function`` of (parameters, row) of the kind SX, all of it dense.

    Returns
    -------
    str or None
        None where an operation has no counterpart here. The columns come in ``blocks`` tables ``rows`` with some
        ``widths``. Each of these and of the ``results`` has one row after the other.
    """
    if not function.is_a("SXFunction"):
        return None
    once: list[str] = []  # what depends on the parameters alone: before the loop over the rows
    lines: list[str] = []
    called: set[str] = set()
    held: dict[int, str] = {}  # casadi's registers, each with the name of what it holds now
    for k in range(function.n_instructions()):
        kind, ins, outs = (f(k) for f in (function.instruction_id, function.instruction_input,
                                          function.instruction_output))  # fmt: skip
        if kind == ca.OP_OUTPUT:
            lines.append(f"to{outs[0]}[{outs[1]}] = {held[ins[0]]};")
            continue
        fixed = ins[0] == 0 if kind == ca.OP_INPUT else all(held[i][0] == "p" for i in ins)
        target, names = f"{'p' if fixed else 'w'}{k}", [held[i] for i in ins if kind != ca.OP_INPUT]
        held[outs[0]] = target
        if kind == ca.OP_INPUT:
            found = f"lanes {target} = zero + theta[{ins[1]}];" if fixed else f"lanes {target} = from[{ins[1]}];"
        elif kind == ca.OP_CONST:
            value = float(function.instruction_constant(k))
            if not isfinite(value):
                return None
            found = f"lanes {target} = zero + {value.hex()};"
        elif kind in _ARITHMETIC:
            found = f"lanes {target} = {_ARITHMETIC[kind].format(*names)};"
        elif kind in _FUNCTIONS:
            called.add(_FUNCTIONS[kind])
            found = f"lanes {target}; lanes_{_FUNCTIONS[kind]}(&{target}, &{names[0]});"
        elif kind in _FUNCTIONS_OF_TWO:
            called.add(_FUNCTIONS_OF_TWO[kind])
            found = f"lanes {target}; lanes_{_FUNCTIONS_OF_TWO[kind]}(&{target}, &{names[0]}, &{names[1]});"
        else:
            return None
        (once if fixed else lines).append(found)
    return _wrapped(function, once, lines, sorted(called))


def _wrapped(function: Any, once: list[str], lines: list[str], called: list[str]) -> str:
    """The lines of one block of rows within the loop over blocks; a last block repeats its last row."""
    width, results = function.nnz_in(1), [function.nnz_out(i) for i in range(function.n_out())]
    out = [
        _HEAD
        + "".join(f"VECTOR({name})\n" for name in called if name in _VECTORS)
        + "".join(f"BY_LANE{'_OF_TWO' * (name in _FUNCTIONS_OF_TWO.values())}({name})\n" for name in called),
        f"void {function.name()}(long count, const double *theta, long blocks, const long *widths,",
        "    const double *const *rows, double *const *results)",
        "{",
        "  const lanes zero = {0.0}, one = zero + 1.0;",
        *(f"  {line}" for line in once),
        f"  lanes from[{max(width, 1)}];",
        *(f"  lanes to{i}[{max(size, 1)}];" for i, size in enumerate(results)),
        "  for (long first = 0; first < count; first += 8) {",
        "    const int live = count - first < 8 ? (int)(count - first) : 8;",
        "    double *into = (double *)from;",
        "    for (long b = 0; b < blocks; into += 8 * widths[b], ++b)",
        "      for (int k = 0; k < 8; ++k) {",
        "        const double *row = rows[b] + (first + (k < live ? k : live - 1)) * widths[b];",
        "        for (long j = 0; j < widths[b]; ++j) into[8 * j + k] = row[j];",
        "      }",
        *(f"    {line}" for line in lines),
    ]
    for i, size in enumerate(results):
        out += [
            "    for (int k = 0; k < live; ++k) {",
            f"      double *row = results[{i}] + (first + k) * {size};",
            f"      for (int j = 0; j < {size}; ++j) row[j] = ((const double *)to{i})[8 * j + k];",
            "    }",
        ]
    return "\n".join([*out, "  }", "}", ""])
