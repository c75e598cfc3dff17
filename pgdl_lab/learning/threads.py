"""How many CPU threads a computation works with."""

from collections.abc import Iterator
from contextlib import contextmanager

import scipy.linalg  # noqa: F401  # as the solver below
import torch
from threadpoolctl import threadpool_limits

from pgdl_lab.mechanics.linear import symmetric_solver


@contextmanager
def threads(count: int) -> Iterator[None]:
    """Let PyTorch, BLAS and the sparse solver use `count` CPU threads in this block."""
    symmetric_solver()  # a library that is loaded later is not limited
    before = torch.get_num_threads()
    with threadpool_limits(count):
        torch.set_num_threads(count)
        try:
            yield
        finally:
            torch.set_num_threads(before)
