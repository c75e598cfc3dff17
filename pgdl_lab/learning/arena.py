"""Memory that one training step takes over from the last: what was just used is still in the processor's cache."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch import Tensor

SHAPES = 32  # of these many shapes, those used last, memory is kept

_free: OrderedDict[tuple[torch.Size, torch.dtype, torch.device], list[Tensor]] = OrderedDict()


class Arena:
    """Tensors for intermediate results, borrowed until this object dies; whoever asks next for such a one gets them.

    Parameters
    ----------
    like
        Gives type and device.
    """

    def __init__(self, like: Tensor) -> None:
        self._like = like.new_empty(0)
        self._borrowed: list[Tensor] = []

    def take(self, *shape: int) -> Tensor:
        """A tensor of this shape, its content arbitrary."""
        known = _free.get((torch.Size(shape), self._like.dtype, self._like.device))
        self._borrowed.append(known.pop() if known else self._like.new_empty(shape))
        return self._borrowed[-1]

    @contextmanager
    def scratch(self) -> Iterator[None]:
        """What is taken in this block is needed in it alone."""
        before = len(self._borrowed)
        yield
        self._give(before)

    def _give(self, first: int) -> None:
        for tensor in reversed(self._borrowed[first:]):
            key = tensor.shape, tensor.dtype, tensor.device
            _free.setdefault(key, []).append(tensor)
            _free.move_to_end(key)
        del self._borrowed[first:]
        while len(_free) > SHAPES:
            _free.popitem(last=False)

    def __del__(self) -> None:
        self._give(0)
