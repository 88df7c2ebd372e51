"""Functions of single rows run over whole blocks of rows, in compiled C where a C compiler is found.

Where it can, the compiled function does eight rows at once (`clampid.chain.lanes`). A function that is used for a few
fits alone is compiled only where its rows pay for that (:class:`Rowwise`). Without a compiler functions run in casadi's
own machine: the same numbers, slower. What was compiled is kept in the user's cache folder under the hash of what it
computes and its own. So each function is compiled once on a machine, and a library that was cut off or changed is made
again instead of ending the process (see :mod:`clampid.chain.library_folder`).
"""

from __future__ import annotations

import hashlib
import logging
import os
import platform
import shlex
import shutil
import subprocess
from collections.abc import Callable, Sequence
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import numpy.typing as npt

from clampid.chain import lanes
from clampid.chain.lanes import Lanes
from clampid.chain.library_folder import digest_of, is_whole, own_folder, remove_oldest, used_now
from experiments.outputs import flush_folder, scratch_folder

__all__ = ["Blocks", "Rowwise", "compile_function", "compile_piece", "compile_rows", "compiler", "pieces_pay"]

Array = npt.NDArray[np.float64]

BLOCK = 64  # rows evaluated at once; the last block of a call is filled up with what was there before
# Neither of the first two changes a result: casadi's code asks for no errno, and traps no exception of the processor.
HARMLESS = ("-fno-math-errno", "-fno-trapping-math", "-fPIC", "-shared")
FOR_ONE_ROW, FOR_EIGHT_ROWS = "-O2", "-O1"  # the first takes up to twice as long to compile; by eights it gains nothing
PLAIN = ("-std=c99",)
NATIVE = ("-std=gnu99", "-march=native", "-fopenmp-simd", "-Wno-psabi")  # for this processor; not every compiler can
# Seconds, measured on one core and rounded: of the compiler to begin, and for an instruction; and what a row of
# an instruction takes less when it is compiled. Their ratios alone count.
BEGINS, COMPILES, SAVES = 0.06, 6e-4, 6e-9
# Rows of a call, from which on pieces are compiled: as long as that takes, twenty calls with so many rows save. A
# diagnosis of a log makes about as many calls of a piece.
PIECE_ROWS = 5000
# Calls of a function of a fit: its points, and those of later fits with the same law at the same places. Measured in
# ``auto`` on two sessions of a UR10: 55 for each library.
CALLS = 50
COMPILE_SECONDS = 120.0  # one that takes longer is not worth waiting for

_log = logging.getLogger(__name__)


class Blocks:
    """A function of (parameters, row) over blocks of rows through casadi's buffers: one crossing per block."""

    def __init__(self, function: Any) -> None:
        self.function = function
        mapped = function.map("rows", "serial", BLOCK, [0], [])
        self.theta = np.zeros(function.nnz_in(0))
        self.rows = np.zeros((BLOCK, function.nnz_in(1)))
        self.out = [np.zeros((BLOCK, function.nnz_out(i))) for i in range(function.n_out())]
        self.buffer, self.trigger = mapped.buffer()
        for i, array in enumerate((self.theta, self.rows)):
            if array.size:
                self.buffer.set_arg(i, array.data)
        for i, array in enumerate(self.out):
            if array.size:
                self.buffer.set_res(i, array.data)

    def __call__(self, theta: Array, *columns: Array) -> list[Array]:
        """Evaluate at ``theta`` for rows whose columns come in blocks ``(N, k)`` one beside the other."""
        count = len(columns[0]) if columns else 0
        results = [np.empty((count, o.shape[1])) for o in self.out]
        self.theta[:] = theta
        # Side by side once, so that each block of rows is one copy.
        every = np.concatenate(columns, axis=1) if len(columns) > 1 else columns[0] if columns else np.zeros((0, 0))
        for start in range(0, count, BLOCK):
            stop = min(start + BLOCK, count)
            self.rows[: stop - start] = every[start:stop]
            self.trigger()
            for result, o in zip(results, self.out, strict=True):
                result[start:stop] = o[: stop - start]
        return results


class Rowwise:
    """A function of (parameters, row) that is compiled where the rows of a call pay for it.

    Which calls are compiled depends on the function, its calls and the number of rows alone, so that the same call has
    the same result at any time.

    Parameters
    ----------
    function
        A ``casadi.Function`` of (parameters, row), dense.
    calls
        How often it is expected to be called.
    """

    def __init__(self, function: Any, calls: int = CALLS) -> None:
        self.function, self.calls = function, calls
        self._instructions = function.n_instructions() if function.is_a("SXFunction") else 0

    def __call__(self, theta: Array, *columns: Array) -> list[Array]:
        """As :class:`Blocks`."""
        rows = len(columns[0]) if columns else 0
        gain = self.calls * SAVES * rows * self._instructions
        worth = gain > BEGINS + COMPILES * self._instructions
        return (self._compiled if worth else self._blocks)(theta, *columns)

    @property
    def once(self) -> Rowwise:
        """The same for a single call."""
        return Rowwise(self.function, 1)

    @cached_property
    def _blocks(self) -> Blocks:
        return Blocks(self.function)

    @cached_property
    def _compiled(self) -> Blocks | Lanes:
        return _lanes(self.function) or self._blocks


def compiler() -> list[str] | None:
    """The command of the C compiler, or None where there is none.

    It is ``$CC`` or ``cc``; ``CLAMPID_COMPILER`` goes before both, and ``CLAMPID_COMPILER=none`` means none.
    """
    asked = os.environ.get("CLAMPID_COMPILER") or os.environ.get("CC") or "cc"
    command = shlex.split(asked)
    if not command or asked == "none" or shutil.which(command[0]) is None:
        return None
    return command


def compile_rows(function: Any) -> Blocks | Lanes:
    """A casadi function of (parameters, row), to be called with blocks of rows: the fastest there is on this machine.

    Parameters
    ----------
    function
        A dense ``casadi.Function`` of two inputs, without calls to anything that has no C source.
    """
    return _lanes(function) or Blocks(compile_function(function))


def compile_piece(function: Any) -> Blocks | Lanes:
    """A casadi function as of `compile_rows`, for one that many models share: see :mod:`clampid.chain.piecewise`."""
    return _lanes(function) or Blocks(function)


def pieces_pay(rows: int) -> bool:
    """Whether functions of so many rows are compiled piece by piece: with a compiler, where there are enough rows."""
    return rows >= PIECE_ROWS and compiler() is not None


def _lanes(function: Any) -> Lanes | None:
    """The function compiled for eight rows at once; None where that cannot be had."""
    if not function.is_a("SXFunction"):
        return None
    plain, options = _anonymous(function), (*NATIVE, FOR_EIGHT_ROWS, *HARMLESS)
    content = f"{_writer()} {plain.serialize()}"  # a tenth of the time that the source takes to write
    library = _library(function.name(), content, lambda: lanes.lanes_source(plain), options, _processor())
    if library is None:
        return None
    try:
        return Lanes(function, library)
    except (OSError, AttributeError) as error:  # it is no library, or another function's
        _log.info("%s runs row by row: %s", function.name(), error)
        return None


@cache
def _writer() -> str:
    """What a source depends on besides its function."""
    return f"{ca.CasadiMeta.version()} {digest_of(Path(lanes.__file__))}"


def _anonymous(function: Any) -> Any:
    """The same function with symbols named by their places, so that what computes the same has the same content."""
    inputs = [ca.SX.sym(f"i{k}", function.size1_in(k), function.size2_in(k)) for k in range(function.n_in())]
    return ca.Function(function.name(), inputs, function.call(inputs))


def compile_function(function: Any) -> Any:
    """The same casadi function, compiled to C if that can be had; else the function itself.

    Parameters
    ----------
    function
        A ``casadi.Function`` without calls to anything that has no C source.
    """
    if compiler() is None:
        return function
    name = function.name()
    generator = ca.CodeGenerator(name)
    generator.add(function)
    source = generator.dump()
    for options, machine in ((NATIVE, _processor()), (PLAIN, "")):
        command = (*options, FOR_ONE_ROW, *HARMLESS)
        library = _library(name, source, lambda: source, command, f"{ca.CasadiMeta.version()} {machine}")
        try:
            if library is not None:
                return ca.external(name, str(library))
        except RuntimeError as error:
            _log.info("%s runs uncompiled: %s", name, error)
    return function


def _library(
    name: str, content: str, written: Callable[[], str | None], options: Sequence[str], machine: str
) -> Path | None:
    """The library of a function, compiled unless the cache has it; None where it cannot be had.

    Parameters
    ----------
    content
        What the source follows from: libraries of equal content are the same.
    written
        Writes the source; None where it cannot.
    machine
        What the library depends on besides content and command.
    """
    command = compiler()
    if command is None:
        return None
    key = hashlib.sha256("\0".join([machine, *command, *options, content]).encode()).hexdigest()[:24]
    try:
        folder = own_folder()
        for library in folder.glob(f"{name}-{key}.*.so"):
            if is_whole(library):
                used_now(library)
                return library
            library.unlink(missing_ok=True)  # cut off, changed, or writable by others: made again
        source = written()
        return None if source is None else _build([*command, *options], source, folder, f"{name}-{key}")
    except (OSError, subprocess.SubprocessError) as error:
        _log.info("%s was not compiled: %s", name, error)
        return None


def _processor() -> str:
    """What says which instructions this processor has: cache folders may be shared between machines."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return f"{platform.machine()} {platform.processor()}"
    return next((line for line in lines if line.startswith(("flags", "Features"))), platform.machine())


def _build(command: list[str], source: str, place: Path, name: str) -> Path:
    """Compile beside the library's place and move it there whole, under a name that has its own hash in it."""
    with scratch_folder(place, name) as folder:
        (folder / "function.c").write_text(source, encoding="utf-8")
        made = folder / "function.so"
        subprocess.run(
            [*command, "-o", str(made), str(folder / "function.c"), "-lm"],
            check=True,
            capture_output=True,
            timeout=COMPILE_SECONDS,
        )
        os.chmod(made, 0o600)
        library = place / f"{name}.{digest_of(made)}.so"
        with open(made, "rb") as file:
            os.fsync(file.fileno())
        made.replace(library)
    flush_folder(place)
    remove_oldest(place)
    return library
