"""Compiled or not, functions give the same numbers; without a compiler, or with a broken one, nothing is lost."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import casadi as ca
import numpy as np
import pytest

from clampid.chain.compiled import BLOCK, Blocks, Rowwise, compile_function, compile_rows, compiler
from clampid.chain.lanes import Lanes, lanes_source
from clampid.chain.library_folder import remove_oldest, used_now


def function() -> ca.Function:
    theta, row = ca.SX.sym("theta", 2), ca.SX.sym("row", 3)
    out = ca.vertcat(theta[0] * ca.sin(row[0]) + row[1] ** 3, ca.exp(theta[1] * row[2]))
    return ca.Function("some", [theta, row], [out, ca.densify(ca.jacobian(out, theta))])


def expected(theta: np.ndarray, rows: np.ndarray) -> np.ndarray:
    return np.c_[theta[0] * np.sin(rows[:, 0]) + rows[:, 1] ** 3, np.exp(theta[1] * rows[:, 2])]


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path


@pytest.mark.parametrize("count", [1, BLOCK - 1, BLOCK, 2 * BLOCK + 3])
def test_every_row_of_every_block_is_evaluated(count: int):
    rng = np.random.default_rng(count)
    theta, rows = rng.normal(size=2), rng.normal(size=(count, 3))
    value, jacobian = Blocks(function())(theta, rows[:, :1], rows[:, 1:])
    np.testing.assert_allclose(value, expected(theta, rows), rtol=1e-14)
    assert jacobian.shape == (count, 4)


@pytest.mark.skipif(compiler() is None, reason="no C compiler here")
def test_compiled_once_it_gives_the_same_numbers(cache: Path):
    rng = np.random.default_rng(0)
    theta, rows = rng.normal(size=2), rng.normal(size=(300, 3))
    fast = compile_function(function())
    (library,) = cache.rglob("*.so")
    made = library.stat().st_mtime_ns
    again = compile_function(function())
    assert library.stat().st_mtime_ns == made
    assert [p for p in library.parent.iterdir() if p != library] == []
    for f in (fast, again):
        np.testing.assert_allclose(Blocks(f)(theta, rows)[0], expected(theta, rows), rtol=1e-13)


@pytest.mark.skipif(compiler() is None, reason="no C compiler here")
@pytest.mark.parametrize("harm", ["empty", "cut off", "changed", "writable", "another's", "a link"])
def test_a_library_that_cannot_be_trusted_is_made_again(cache: Path, harm: str):
    """In a process of its own: a library that is cut off ends the process that loads it."""
    theta, rows = np.ones(2), np.ones((4, 3))
    compile_function(function())
    (library,) = cache.rglob("*.so")
    good = library.read_bytes()
    match harm:
        case "empty":
            library.write_bytes(b"")
        case "cut off":
            os.truncate(library, len(good) // 2)
        case "changed":
            library.write_bytes(good[:-1] + bytes([good[-1] ^ 1]))
        case "writable":
            library.chmod(0o666)
        case "another's":
            if os.geteuid() != 0:
                pytest.skip("giving a file away needs root")
            os.chown(library, 12345, 12345)
        case _:
            library.rename(cache / "real")
            library.symlink_to(cache / "real")
    again = compile_function(function())
    (library,) = (cache / "clampid").rglob("*.so")
    assert library.read_bytes() == good
    assert stat.S_IMODE(library.lstat().st_mode) == 0o600
    np.testing.assert_allclose(Blocks(again)(theta, rows)[0], expected(theta, rows), rtol=1e-13)


@pytest.mark.skipif(compiler() is None, reason="no C compiler here")
def test_a_cache_that_others_may_write_is_closed_to_them(cache: Path):
    folder = cache / "clampid" / "compiled"
    folder.mkdir(parents=True)
    for part in (folder, folder.parent):
        part.chmod(0o777)
    compile_function(function())
    assert [stat.S_IMODE(p.stat().st_mode) for p in (folder, folder.parent)] == [0o755, 0o755]
    assert list(folder.glob("*.so"))


@pytest.mark.skipif(compiler() is None or os.geteuid() != 0, reason="giving a folder away needs root")
def test_a_cache_of_another_user_is_not_used(cache: Path):
    folder = cache / "clampid" / "compiled"
    folder.mkdir(parents=True)
    os.chown(folder, 12345, 12345)
    f = compile_function(function())
    assert not list(folder.iterdir())
    theta, rows = np.ones(2), np.ones((4, 3))
    np.testing.assert_allclose(Blocks(f)(theta, rows)[0], expected(theta, rows), rtol=1e-13)


@pytest.mark.parametrize("command", ["none", "no-such-compiler-anywhere", "false"])
def test_without_a_working_compiler_it_runs_uncompiled(cache: Path, command: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("CLAMPID_COMPILER", command)
    f = compile_function(function())
    assert not list(cache.rglob("*.so"))
    theta, rows = np.ones(2), np.ones((4, 3))
    np.testing.assert_allclose(Blocks(f)(theta, rows)[0], expected(theta, rows), rtol=1e-14)


def every_operation() -> ca.Function:
    theta, row = ca.SX.sym("theta", 1), ca.SX.sym("row", 3)
    a, b, c = row[0], row[1], row[2]
    parts = (a + b, a - b, a * b, a / c, -a, a**2, 2 * a, 1 / c, ca.sin(a), ca.cos(a), ca.tan(a), ca.exp(a), ca.log(c),
             ca.sqrt(c), ca.fabs(a), ca.tanh(a), ca.atan(a), theta * a, 0.1 + c, b, ca.atan2(a, b), ca.floor(3 * a),
             ca.ceil(3 * a), ca.sign(a), ca.fmin(a, b), ca.fmax(a, b), ca.if_else(a < b, a, c), a <= b, ca.eq(a, a),
             ca.ne(a, b), ca.logic_and(a < b, c < 1), ca.logic_or(a < b, c < 1), ca.logic_not(a < b))  # fmt: skip
    return ca.Function("every", [theta, row], [ca.vertcat(*parts), ca.vertcat(a * c, 7.0)])


@pytest.mark.skipif(compiler() is None, reason="no C compiler here")
@pytest.mark.parametrize("count", [0, 1, 7, 8, 9, 1003])
def test_eight_rows_at_once_give_the_numbers_of_each(cache: Path, count: int):
    rng = np.random.default_rng(count)
    rows = np.c_[rng.normal(size=(count, 2)), rng.uniform(0.1, 2.0, size=count)]
    fast, slow = compile_rows(every_operation()), Blocks(every_operation())
    assert isinstance(fast, Lanes)
    for a, b in zip(fast(np.array([0.3]), rows[:, :1], rows[:, 1:]), slow(np.array([0.3]), rows), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-14, atol=1e-14)


@pytest.mark.skipif(compiler() is None, reason="no C compiler here")
def test_eight_rows_at_once_treat_what_is_no_number_as_one_row_does(cache: Path):
    """fmin and fmax leave it out, a comparison with it is false, and what is not chosen does not spoil the sum."""
    theta, row = ca.SX.sym("theta", 0), ca.SX.sym("row", 2)
    a, b = row[0], row[1]
    parts = (ca.fmin(a, b), ca.fmax(a, b), a < b, ca.logic_not(a < b), ca.if_else(b > 0, a, b), ca.sign(a), ca.floor(a))
    f = ca.Function("edges", [theta, row], [ca.vertcat(*parts)])
    edges = np.array([np.nan, np.inf, -np.inf, 0.0, -0.0, 1.0, -1.5])
    rows = np.array(np.meshgrid(edges, edges)).reshape(2, -1).T.copy()
    fast = compile_rows(f)
    assert isinstance(fast, Lanes)
    np.testing.assert_array_equal(fast(np.zeros(0), rows)[0], Blocks(f)(np.zeros(0), rows)[0])


def long_function(lines: int) -> ca.Function:
    """So many angles, each with a sine and a square."""
    theta, row = ca.SX.sym("theta", 1), ca.SX.sym("row", lines)
    return ca.Function("wide", [theta, row], [ca.densify(theta * ca.sin(row) + row**2)])


@pytest.mark.skipif(compiler() is None, reason="no C compiler here")
def test_many_rows_of_a_long_function_are_compiled_and_few_are_not(cache: Path):
    f = long_function(400)
    rows, theta = np.random.default_rng(0).normal(size=(3000, 400)), np.array([1.3])
    chosen, slow = Rowwise(f), Blocks(f)
    np.testing.assert_array_equal(chosen(theta, rows[:50])[0], slow(theta, rows[:50])[0])
    assert list(cache.rglob("*.so")) == []
    np.testing.assert_allclose(chosen(theta, rows)[0], slow(theta, rows)[0], rtol=1e-13, atol=1e-13)
    assert len(list(cache.rglob("*.so"))) == 1


def test_without_a_compiler_many_rows_have_the_same_numbers(cache: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("CLAMPID_COMPILER", "none")
    f, rows, theta = long_function(400), np.random.default_rng(0).normal(size=(3000, 400)), np.array([1.3])
    np.testing.assert_array_equal(Rowwise(f)(theta, rows)[0], Blocks(f)(theta, rows)[0])


def test_of_too_many_libraries_those_used_longest_ago_go(tmp_path: Path):
    for k in range(6):
        (tmp_path / f"f-{k}.so").write_bytes(bytes(100))
        os.utime(tmp_path / f"f-{k}.so", ns=(k, k))
    used_now(tmp_path / "f-0.so")
    remove_oldest(tmp_path, largest=600)
    assert len(list(tmp_path.iterdir())) == 6
    remove_oldest(tmp_path, largest=599)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["f-0.so", "f-5.so"]


def test_what_cannot_be_done_by_eights_is_done_one_by_one(cache: Path):
    theta, row = ca.SX.sym("theta", 0), ca.SX.sym("row", 2)
    f = ca.Function("one", [theta, row], [ca.sinh(row[0]) + row[1]])
    assert lanes_source(f) is None
    rows = np.array([[1.0, 2.0], [-1.0, 2.0]])
    np.testing.assert_allclose(compile_rows(f)(np.zeros(0), rows)[0][:, 0], np.sinh(rows[:, 0]) + 2.0)


def test_columns_that_do_not_fit_are_refused(cache: Path):
    if compiler() is None:
        pytest.skip("no C compiler here")
    fast = compile_rows(every_operation())
    with pytest.raises(ValueError, match=r"expected \(1, 3, 4\)"):
        fast(np.zeros(1), np.zeros((4, 2)))
    with pytest.raises(ValueError, match=r"expected \(1, 3, 4\)"):
        fast(np.zeros(1), np.zeros((4, 2)), np.zeros((3, 1)))


def test_columns_may_come_in_blocks(cache: Path):
    theta, rows = np.array([0.3]), np.random.default_rng(3).uniform(0.1, 0.9, (21, 3))
    f = compile_rows(every_operation())
    apart = f(theta, rows[:, :1], np.zeros((21, 0)), rows[:, 1:])
    for one, other in zip(f(theta, rows), apart, strict=True):
        np.testing.assert_array_equal(one, other)


def test_rows_without_a_compiler(cache: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("CLAMPID_COMPILER", "none")
    theta, rows = np.ones(2), np.ones((4, 3))
    np.testing.assert_allclose(compile_rows(function())(theta, rows)[0], expected(theta, rows), rtol=1e-14)


@pytest.mark.skipif(compiler() is None, reason="no C compiler here")
def test_functions_that_differ_by_names_of_symbols_share_a_library(cache: Path):
    def one(names: tuple[str, str], factor: float) -> ca.Function:
        theta, row = (ca.SX.sym(name, 3) for name in names)
        return ca.Function("piece", [theta[1:], row[:2]], [factor * theta[1:] * row[:2]])

    theta, rows = np.array([2.0, 3.0]), np.array([[1.0, 5.0]])
    for names in (("theta", "row"), ("t", "r")):
        assert compile_rows(one(names, 2.0))(theta, rows)[0].tolist() == [[4.0, 30.0]]
    assert len(list(cache.rglob("*.so"))) == 1
    assert compile_rows(one(("t", "r"), 3.0))(theta, rows)[0].tolist() == [[6.0, 45.0]]
    assert len(list(cache.rglob("*.so"))) == 2
