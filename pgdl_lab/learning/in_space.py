"""What can be learnt: not every model and loss goes beyond the side face and the pressure."""

from __future__ import annotations

from collections.abc import Mapping

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.inputs import PRESSURE, Cases
from pgdl_lab.core.registry import describe, names, plugin
from pgdl_lab.learning.loss import Loss
from pgdl_lab.learning.model import Model


def require_in_space(model: Model, losses: Mapping[str, Loss]) -> None:
    """Check that a model and the terms of its loss suit a whole body.

    Raises
    ------
    InputError
        When one of them knows the side face alone.
    """
    if not model.in_space:
        raise InputError(
            f"model={describe(model)['name']} learns the side face alone: for the whole body choose one of "
            f"{_able('model')}, or leave out observation.of=body."
        )
    plane = [name for name, loss in losses.items() if not loss.in_space]
    if plane:
        raise InputError(
            f"Loss {', '.join(plane)} balances forces in the plane of the side face: for the whole body choose among "
            f"{_able('loss')}, or leave out observation.of=body."
        )


def require_in_plane(losses: Mapping[str, Loss]) -> None:
    """Check that the terms of a loss suit the side face.

    Raises
    ------
    InputError
        When one of them knows the whole body alone.
    """
    for name, loss in losses.items():
        if not loss.in_plane:
            raise InputError(
                f"Loss {name} balances the whole body: choose observation.of=body, or leave it out; on the side face "
                "loss section balances a section."
            )


def require_inputs(model: Model, cases: Cases) -> None:
    """Check that a model takes these inputs, and that the cases tell something of each.

    Raises
    ------
    InputError
        When it knows the pressure alone, and there are others, or one of several has one value.
    """
    inputs = cases.names
    if inputs != [PRESSURE] and not model.several_inputs:
        raise InputError(
            f"model={describe(model)['name']} knows the pressure alone, and the data have {', '.join(inputs)}: choose "
            f"one of {_able('model', 'several_inputs')}."
        )
    for name, (low, high) in cases.ranges().items() if len(inputs) > 1 else ():
        if low == high:
            raise InputError(
                f"{name} is {low:g} at all training points, so that nothing tells what it does: train on simulations "
                "that differ in it."
            )


def _able(kind: str, what: str = "in_space") -> str:
    """Names of the plugins of a kind that suit a whole body, or several inputs."""
    return ", ".join(name for name in names(kind) if getattr(plugin(kind, name), what, False))
