"""Sparse direct solvers for symmetric matrices: MKL Pardiso where it is installed, SuperLU of SciPy elsewhere."""

import os
import weakref
from importlib.metadata import PackageNotFoundError, files
from typing import Any, Protocol

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

Array = NDArray[np.float64]


class SymmetricSolver(Protocol):
    """A factorised symmetric matrix.

    Attributes
    ----------
    name
        What solves: for the provenance.
    negative
        Number of negative eigenvalues of the factorised matrix: an equilibrium is stable when there are none.
    """

    name: str
    negative: int

    def factorise(self, upper: sp.csr_matrix) -> None:
        """Factorise the matrix whose upper triangle is given."""

    def solve(self, right_hand_side: Array) -> Array:
        """Solve for one vector (n,) or several, as columns (n, m)."""

    def release(self) -> None:
        """Give back the memory of the factors, but keep the ordering for the next matrix."""

    def close(self) -> None:
        """Give back all memory."""


class Pardiso:
    """MKL Pardiso for symmetric indefinite matrices; the ordering is kept as long as the pattern stays the same.

    Its memory is not Python's: it is given back by `close`, and at the latest with this object.
    """

    name = "MKL Pardiso"

    def __init__(self) -> None:
        _name_mkl()
        from pypardiso import PyPardisoSolver

        self._solver = PyPardisoSolver(mtype=-2)
        # Set by hand, these are the defaults, but for iterative refinement (8): Newton's method corrects what it would.
        for number, value in {1: 1, 2: 3, 8: 0, 10: 8, 21: 1}.items():
            self._solver.set_iparm(number, value)
        weakref.finalize(self, self._solver.free_memory, everything=True).atexit = False
        self._matrix: sp.csr_matrix | None = None
        self.negative = 0

    def factorise(self, upper: sp.csr_matrix) -> None:
        unused = np.zeros((upper.shape[0], 1))
        known, self._matrix = self._matrix, None  # until it is factorised
        if known is None or not same_pattern(known, upper):
            self.close()
            self._run(11, upper, unused)
        self._run(22, upper, unused)
        self._matrix = upper
        self.negative = int(self._solver.get_iparm(23))

    def solve(self, right_hand_side: Array) -> Array:
        columns = np.asfortranarray(right_hand_side.reshape(len(right_hand_side), -1))
        return self._run(33, self._matrix, columns).reshape(right_hand_side.shape)

    def _run(self, phase: int, matrix: sp.csr_matrix | None, right_hand_side: Array) -> Array:
        self._solver.set_phase(phase)
        solution: Array = self._solver._call_pardiso(matrix, right_hand_side)
        return solution

    def release(self) -> None:
        if self._matrix is not None:
            self._solver.free_memory()

    def close(self) -> None:
        self._solver.free_memory(everything=True)
        self._matrix = None


class SuperLU:
    """SuperLU in symmetric mode: pivots stay on the diagonal, so their signs count the negative eigenvalues."""

    name = "SciPy SuperLU"

    def __init__(self) -> None:
        self.negative = 0
        self._factors: Any = None

    def factorise(self, upper: sp.csr_matrix) -> None:
        from scipy.sparse.linalg import splu

        full = (upper + sp.triu(upper, 1).T).tocsc()
        self._factors = splu(full, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        self.negative = int((self._factors.U.diagonal() < 0).sum())

    def solve(self, right_hand_side: Array) -> Array:
        solution: Array = self._factors.solve(right_hand_side)
        return solution

    def release(self) -> None:
        self._factors = None

    def close(self) -> None:
        self._factors = None


def same_pattern(one: sp.csr_matrix, other: sp.csr_matrix) -> bool:
    """Whether two matrices have entries in the same places."""
    return np.array_equal(one.indptr, other.indptr) and np.array_equal(one.indices, other.indices)


def _name_mkl() -> None:
    """Tell pypardiso where MKL lies, as pip knows; it would search the whole environment for it, twice."""
    try:
        library = [entry for entry in files("mkl") or () if entry.name.startswith(("libmkl_rt.", "mkl_rt.2.dll"))]
    except PackageNotFoundError:
        return
    if library:
        os.environ.setdefault("PYPARDISO_MKL_RT", str(library[0].locate()))


def symmetric_solver() -> SymmetricSolver:
    """The fastest solver that is installed."""
    try:
        return Pardiso()
    except ImportError:
        return SuperLU()
