"""Simulate and train from Python: the same objects and defaults as on the command line."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from omegaconf import OmegaConf

from pgdl_lab.core import paths
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.registry import discover, restored
from pgdl_lab.running import cache
from pgdl_lab.running.experiment import Experiment

if TYPE_CHECKING:
    from pgdl_lab.core.dataset import Dataset
    from pgdl_lab.core.observation import Observation
    from pgdl_lab.core.split import Split
    from pgdl_lab.learning.balancing import BalancingSettings
    from pgdl_lab.learning.loss import Loss
    from pgdl_lab.learning.model import Model
    from pgdl_lab.learning.settings import OptimizerSettings, TrainerSettings
    from pgdl_lab.mechanics.fem import Fem
    from pgdl_lab.mechanics.finger import Finger
    from pgdl_lab.surrogate.surrogate import Surrogate


def simulate(
    finger: Finger | str | None = None, fem: Fem | str | None = None, *, observation: Observation | None = None
) -> Dataset:
    """Displacements of a finger under its weight and rising pressure, by finite elements.

    A simulation is kept in `runs/snapshots` and computed only once. Half a minute to some minutes are usual.

    Parameters
    ----------
    finger
        An instance such as `Pneunet(chambers=6)`, or the name of one with its defaults, as typed after `finger=`.
    fem
        The finite-element model, likewise: `Solid(edge_mm=6.0)` or "solid".
    observation
        How many pressures and points of the side face are kept.

    Raises
    ------
    InputError
        When a value lies outside its limits, or finger and model do not fit together.
    SimulationStopped
        When the finger cannot bear its highest pressure; `snapshots` of the exception holds what converged.

    Examples
    --------
    >>> import pgdl_lab as lab
    >>> finger = lab.Pneunet(chambers=2, max_kpa=10.0)
    >>> data = lab.simulate(finger, lab.Rod(), observation=lab.Observation(snapshots=10, points=200))
    >>> data.displacements.shape  # 10 pressures, 200 points, u_x and u_z [mm]
    (10, 200, 2)
    """
    made = Experiment.of(finger=finger, fem=fem, observation=observation)
    return cache.simulate(made.finger, made.fem, made.observation, paths.RUNS / "snapshots")[0]


def train(
    data: Dataset,
    model: Model | str | None = None,
    *,
    split: Split | str | None = None,
    loss: Sequence[Loss | str] | Mapping[str, Loss] | str | None = None,
    trainer: TrainerSettings | None = None,
    optimizer: OptimizerSettings | None = None,
    balancing: BalancingSettings | None = None,
    seed: int | None = None,
    folder: str | Path | None = None,
) -> Surrogate:
    """A surrogate that learns from some points of `data`; its `error` is that at all others.

    Parameters
    ----------
    data
        What `simulate` gave.
    model
        An instance such as `Pod(degree=8)`, or the name of one with its defaults, as typed after `model=`.
    split
        Which points it learns from, likewise: `RandomSplit(points=2000)` or "extrapolate".
    loss
        Terms of the loss: names or instances, such as `["data", BoundaryLoss(weight=0.1)]`.
    trainer, optimizer, balancing
        Budget, rule, and how the weights of the losses follow the training.
    seed
        Another draw of points and weights.
    folder
        Where surrogate.pt and checkpoints are written; a training that was stopped goes on from there. By default
        nothing is kept.

    Raises
    ------
    InputError
        When a value lies outside its limits, or the points do not suffice for the model.
    TrainingDiverged
        When a loss is no longer finite; `surrogate` of the exception is the last good one.

    Examples
    --------
    >>> import pgdl_lab as lab
    >>> finger = lab.Pneunet(chambers=2, max_kpa=10.0)
    >>> data = lab.simulate(finger, lab.Rod(), observation=lab.Observation(snapshots=10, points=200))
    >>> surrogate = lab.train(data, "pod", split=lab.RandomSplit(points=500))
    >>> surrogate.error["rms_mm"] < 0.01
    True
    """
    from pgdl_lab.assessment.comparison import Comparison
    from pgdl_lab.learning.doubt import trained
    from pgdl_lab.mechanics.whole_body import learnable
    from pgdl_lab.surrogate.surrogate import ERROR

    made = Experiment.of(
        finger=_finger(data), split=split, model=model, loss=loss, trainer=trainer, optimizer=optimizer,
        balancing=balancing, seed=seed,
    )  # fmt: skip
    if data.domain.is_body:
        data = learnable(data)
    made.model.left_out(made.loss)
    for each in made.loss.values():
        each.check(made.finger)
    points = made.split.train_points(data, made.seed)
    with tempfile.TemporaryDirectory() as passing:
        kept = Path(folder or passing)
        kept.mkdir(parents=True, exist_ok=True)
        surrogate = trained(made.model, made.training(data, points, kept))
    predicted = surrogate.probe(data.domain.points_mm).values(data.cases.asked)
    surrogate.record.provenance[ERROR] = Comparison(data, predicted, points).error()
    if folder is not None:
        surrogate.save(kept / "surrogate.pt")
    return surrogate


def _finger(data: Dataset) -> Any:
    """The finger that `data` are of, of joined simulations the first; InputError when they do not say or know it."""
    known = [data.provenance, *data.provenance.get("simulations", ())]
    named = [each["finger"] for each in known if "finger" in each]
    if not named:
        raise InputError("This dataset does not say which finger it is of: make it with pgdl_lab.simulate.")
    discover("finger", "material")
    return OmegaConf.to_object(restored("finger", named[0]))
