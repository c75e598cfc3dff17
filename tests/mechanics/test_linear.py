import ctypes
import gc

import numpy as np
import pytest
import scipy.sparse as sp

from pgdl_lab.mechanics.linear import Pardiso, SuperLU, SymmetricSolver


@pytest.fixture(params=[Pardiso, SuperLU])
def solver(request: pytest.FixtureRequest) -> SymmetricSolver:
    if request.param is Pardiso:
        pytest.importorskip("pypardiso", reason="MKL Pardiso exists on x86-64 only")
    made: SymmetricSolver = request.param()
    return made


def matrix(negative: int, seed: int) -> sp.csr_matrix:
    """Sparse symmetric matrix with a given number of negative eigenvalues: a Laplacian, congruent to a signed one."""
    n = 60
    lower = sp.random_array((n, n), density=0.05, rng=np.random.default_rng(seed), format="csr")
    factor = sp.tril(lower, -1) + sp.eye_array(n)
    signs = np.ones(n)
    signs[:negative] = -1
    return sp.csr_matrix(factor @ sp.diags_array(signs) @ factor.T)


@pytest.mark.parametrize("negative", [0, 3])
def test_solves_and_counts_negative_eigenvalues(solver: SymmetricSolver, negative: int) -> None:
    full = matrix(negative, seed=0)
    right = np.random.default_rng(1).normal(size=full.shape[0])
    solver.factorise(sp.triu(full).tocsr())
    np.testing.assert_allclose(full @ solver.solve(right), right, atol=1e-8)
    assert solver.negative == negative
    solver.close()


def test_factorises_again_with_new_values(solver: SymmetricSolver) -> None:
    full = matrix(0, seed=0)
    upper = sp.triu(full).tocsr()
    right = np.ones(full.shape[0])
    solver.factorise(upper)
    first = solver.solve(right)
    solver.factorise(sp.csr_matrix((2 * upper.data, upper.indices, upper.indptr), shape=upper.shape))
    np.testing.assert_allclose(solver.solve(right), first / 2, rtol=1e-8, atol=1e-12)
    solver.close()


def test_solves_several_columns_at_once(solver: SymmetricSolver) -> None:
    full = matrix(0, seed=0)
    columns = np.random.default_rng(1).normal(size=(full.shape[0], 3))
    solver.factorise(sp.triu(full).tocsr())
    np.testing.assert_allclose(full @ solver.solve(columns), columns, atol=1e-8)
    solver.close()


def test_entries_that_move_to_another_row_are_ordered_anew(solver: SymmetricSolver) -> None:
    apart = sp.csr_matrix(np.diag([2.0, 3.0, 5.0]))
    coupled = sp.csr_matrix((np.array([1.0, 4.0, 5.0]), np.array([0, 1, 2]), np.array([0, 2, 2, 3])), shape=(3, 3))
    right = np.array([1.0, 2.0, 3.0])
    solver.factorise(apart)
    solver.factorise(coupled)
    np.testing.assert_allclose((coupled + sp.triu(coupled, 1).T) @ solver.solve(right), right, atol=1e-12)
    solver.close()


def test_memory_of_a_factorisation_ends_with_its_solver() -> None:
    """Also where a failure keeps it from being closed; MKL counts what it holds."""
    pytest.importorskip("pypardiso", reason="MKL Pardiso exists on x86-64 only")

    def held() -> int:
        gc.collect()
        count = Pardiso()._solver.libmkl.MKL_Mem_Stat
        count.restype = ctypes.c_longlong
        return int(count(ctypes.byref(ctypes.c_int())))

    def leave() -> None:
        solver = Pardiso()
        solver.factorise(sp.triu(matrix(0, seed=0)).tocsr())

    leave()
    before = held()
    leave()
    assert held() == before
