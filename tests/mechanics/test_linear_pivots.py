"""What a solver does where pivots are zero or small, when its memory is given back, and where MKL is looked for."""

import ctypes
import gc
import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp

from pgdl_lab.mechanics import linear
from pgdl_lab.mechanics.linear import Pardiso, SuperLU, SymmetricSolver
from tests.mechanics.test_linear import matrix

NO_MKL = "MKL Pardiso exists on x86-64 only"


@pytest.fixture(params=[Pardiso, SuperLU])
def solver(request: pytest.FixtureRequest) -> SymmetricSolver:
    if request.param is Pardiso:
        pytest.importorskip("pypardiso", reason=NO_MKL)
    made: SymmetricSolver = request.param()
    return made


def test_soft_beside_stiff_is_solved_to_the_last_digits(solver: SymmetricSolver) -> None:
    """Stiffnesses from 1 to 1e-6: a pivot that is small beside the others is no pivot to put another in place of."""
    stiffness = np.logspace(0, -6, 13)
    solver.factorise(sp.csr_matrix(np.diag(stiffness)))
    np.testing.assert_allclose(solver.solve(np.ones(13)), 1 / stiffness, rtol=1e-12)
    assert solver.negative == 0
    solver.close()


def test_pivots_that_are_zero_are_gone_round() -> None:
    """Eigenvalues of ((0, 1), (1, 0)) are 1 and −1; a coupling through zeros needs pivots of two rows."""
    pytest.importorskip("pypardiso", reason=NO_MKL)
    solver = Pardiso()
    upper = sp.csr_matrix((np.array([0.0, 1.0, 0.0]), np.array([0, 1, 1]), np.array([0, 2, 3])), shape=(2, 2))
    solver.factorise(upper)
    np.testing.assert_allclose(solver.solve(np.array([3.0, 7.0])), [7.0, 3.0], rtol=1e-14)
    assert solver.negative == 1
    solver.close()


def test_factors_are_given_back_and_the_solver_goes_on(solver: SymmetricSolver) -> None:
    full = matrix(3, seed=0)
    right = np.random.default_rng(1).normal(size=full.shape[0])
    solver.release()  # nothing to give back yet
    for factor in (1.0, 2.0):
        solver.factorise(sp.triu(factor * full).tocsr())
        np.testing.assert_allclose(factor * full @ solver.solve(right), right, atol=1e-8)
        assert solver.negative == 3
        solver.release()
    solver.close()


def test_memory_of_the_factors_is_given_back() -> None:
    """MKL counts what it holds; factors have at least the entries of their matrix, of 8 bytes each."""
    pytest.importorskip("pypardiso", reason=NO_MKL)
    solver = Pardiso()
    count = solver._solver.libmkl.MKL_Mem_Stat
    count.restype = ctypes.c_longlong

    def held() -> int:
        gc.collect()
        return int(count(ctypes.byref(ctypes.c_int())))

    line = sp.diags_array([np.full(60, 2.0), -np.ones(59)], offsets=[0, 1])
    both = line + sp.triu(line, 1).T
    grid = sp.kron(both, sp.eye_array(60)) + sp.kron(sp.eye_array(60), both)
    upper = sp.triu(grid).tocsr()
    solver.factorise(upper)
    factorised = held()
    solver.release()
    released = held()
    solver.close()
    assert held() < released < factorised - 8 * upper.nnz


@pytest.mark.parametrize("known", [True, False])
def test_mkl_is_taken_from_where_pip_put_it(known: bool, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    library = tmp_path / "libmkl_rt.so.2"

    def files(name: str) -> list[Any] | None:
        assert name == "mkl"
        named = ("libmkl_core.so.2", library.name, "libmkl_rt.py")
        return (
            [SimpleNamespace(name=each, locate=lambda each=each: tmp_path / each) for each in named] if known else None
        )

    monkeypatch.setattr(linear, "files", files)
    monkeypatch.delenv("PYPARDISO_MKL_RT", raising=False)
    linear._name_mkl()
    assert os.environ.get("PYPARDISO_MKL_RT") == (str(library) if known else None)
    monkeypatch.setenv("PYPARDISO_MKL_RT", "/typed/by/hand")
    linear._name_mkl()
    assert os.environ["PYPARDISO_MKL_RT"] == "/typed/by/hand"
