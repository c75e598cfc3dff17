"""Training of a neural model from start or checkpoint to surrogate."""

from __future__ import annotations

import hashlib
import logging
import warnings
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar, Protocol

import lightning.pytorch as pl
import numpy as np
import torch

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.registry import describe
from pgdl_lab.learning.callbacks import Checkpoint, ProgressBar
from pgdl_lab.learning.clock import Clock
from pgdl_lab.learning.data import Samples, Training
from pgdl_lab.learning.field import Field
from pgdl_lab.learning.loss import Loss
from pgdl_lab.learning.module import TrainingDiverged, TrainingModule
from pgdl_lab.learning.objective import Objective
from pgdl_lab.learning.threads import threads
from pgdl_lab.surrogate.record import Record
from pgdl_lab.surrogate.surrogate import Surrogate


class Trainable(Protocol):
    """What a training asks of a model; see `TrainedModel`."""

    optimizer: ClassVar[str]

    @property
    def patience(self) -> int | None: ...
    def left_out(self, losses: Mapping[str, Loss]) -> dict[str, str]: ...
    def begin(self, training: Training) -> tuple[Field, Samples]: ...
    def finished(self, field: Any, record: Record, training: Training) -> Surrogate: ...


def fit(model: Trainable, training: Training) -> Surrogate:
    """Train `model`, resuming from `<folder>/checkpoints/last.ckpt` if it lies there.

    Raises
    ------
    InputError
        When the checkpoint is damaged or belongs to another training, or no GPU is there but asked for.
    TrainingDiverged
        When a loss or a weight is no longer finite; carries the surrogate of the last good weights.
    """
    with threads(training.trainer.threads):
        module = _prepared(model, training)

        def surrogate() -> Surrogate:
            known = training.samples.ranges(), dict(training.provenance)
            record = Record(*known, module.history, training.scene.kept_domain)
            return model.finished(module.objective.field, record, training)

        try:
            _train(module, training)
        except TrainingDiverged as error:
            module.restore_last_good()
            error.surrogate = surrogate()
            raise
        return surrogate()


def trained_field(model: Trainable, training: Training) -> Field:
    """The trained field alone.

    Raises
    ------
    TrainingDiverged
        When a loss or a weight is no longer finite.
    """
    module = _prepared(model, training)
    _train(module, training)
    return module.objective.field


def _prepared(model: Trainable, training: Training) -> TrainingModule:
    """What is trained, as it begins or as its checkpoint left it."""
    model.left_out(training.losses)
    if not training.optimizer.stages:
        training = replace(training, optimizer=replace(training.optimizer, name=model.optimizer))
    path, identity = _path(training), _identity(model, training)
    checkpoint = _checkpoint(path, identity)
    clock = Clock(training.trainer.max_seconds, spent_s=checkpoint["elapsed_s"] if checkpoint else 0.0)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(training.seed)
        field, samples = model.begin(training)
    compiled = training.trainer.compile
    objective = Objective(field, training.losses, samples, training.scene, training.balancing, compiled)
    rules = training.trainer, training.optimizer
    module = TrainingModule(objective, training.held, *rules, training.seed, clock, identity, model.patience)
    if checkpoint is not None:
        module.load_state_dict(checkpoint["state_dict"])
        module.on_load_checkpoint(checkpoint)
    return module


def _train(module: TrainingModule, training: Training) -> None:
    """Go on until the end, and take the best state."""
    if not module.finished:
        path = _path(training)
        resumed = path if path.exists() else None
        path.parent.mkdir(parents=True, exist_ok=True)
        trainer = _trainer(training, Checkpoint(path, training.trainer.checkpoint_every_s))
        with warnings.catch_warnings():
            # Lightning advises on data loaders, and there is none: batches are slices of what the module holds
            warnings.filterwarnings("ignore", module="lightning")
            trainer.fit(module, range(module.steps_per_epoch), ckpt_path=resumed, weights_only=True)
    module.settle()


def _path(training: Training) -> Path:
    return training.folder / "checkpoints" / "last.ckpt"


def _trainer(training: Training, checkpoint: Checkpoint) -> pl.Trainer:
    settings = training.trainer
    if settings.accelerator == "gpu" and not torch.cuda.is_available():
        raise InputError("trainer.accelerator is 'gpu', but PyTorch finds no GPU here; use trainer.accelerator=auto.")
    logging.getLogger("lightning.pytorch").setLevel(logging.WARNING)
    return pl.Trainer(
        accelerator="cpu" if settings.accelerator == "cpu" or not torch.cuda.is_available() else "gpu",
        devices=1,
        max_epochs=settings.max_epochs,
        logger=training.logger or False,
        callbacks=[checkpoint, *training.callbacks, *([ProgressBar()] if settings.progress else [])],
        default_root_dir=training.folder,
        enable_progress_bar=False,
        enable_model_summary=False,
    )


def _identity(model: Trainable, training: Training) -> dict[str, Any]:
    """What a training must agree on with a checkpoint that it resumes from; budgets may differ."""
    data = hashlib.sha256()
    for samples in (training.samples, training.held):
        for values in (samples.points_mm, samples.cases.values, samples.displacements_mm):
            data.update(np.ascontiguousarray(values).tobytes())
    return {
        "model": describe(model),
        "loss": {name: describe(loss) for name, loss in training.losses.items()},
        "optimizer": {**vars(training.optimizer), "name": training.optimizer.stages},
        "balancing": {} if training.balancing.rule == "fixed" else vars(training.balancing).copy(),
        "validation": training.trainer.validation,
        "seed": training.seed,
        "data": data.hexdigest()[:12],
    }


def _checkpoint(path: Path, identity: dict[str, Any]) -> dict[str, Any] | None:
    """The checkpoint at `path`, None if there is none.

    Raises
    ------
    InputError
        When it is damaged or belongs to another training.
    """
    if not path.exists():
        return None
    try:
        checkpoint = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # the unpickler trips over foreign bytes in many ways
        raise InputError(f"{path} is damaged; delete it to train from the start.") from error
    if not isinstance(checkpoint, dict) or "identity" not in checkpoint:
        raise InputError(f"{path} is not a checkpoint of pgdl_lab; delete it or choose another run folder.")
    if "plan" not in checkpoint:
        raise InputError(
            f"{path} is of an earlier version, which kept no last state; delete it to train from the start."
        )
    theirs, ours = _flat(checkpoint["identity"]), _flat(identity)
    differing = [key for key in {**ours, **theirs} if theirs.get(key) != ours.get(key)]
    if differing:
        first = differing[0]
        raise InputError(
            f"{path} belongs to another training ({first} is {theirs.get(first)} there and {ours.get(first)} here); "
            "delete it or choose another run folder."
        )
    return checkpoint


def _flat(tree: Any, prefix: str = "") -> dict[str, Any]:
    if not isinstance(tree, dict):
        return {prefix: tree}
    leaves: dict[str, Any] = {}
    for key, value in tree.items():
        leaves |= _flat(value, f"{prefix}.{key}" if prefix else str(key))
    return leaves
