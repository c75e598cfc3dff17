"""An experiment: everything that one run is made of, built from its configuration."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import FrozenInstanceError, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hydra.core.config_store import ConfigStore
from omegaconf import DictConfig, OmegaConf, open_dict

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.files import replacing
from pgdl_lab.core.observation import Observation
from pgdl_lab.core.paths import CONF
from pgdl_lab.core.registry import (
    KINDS,
    PARTS,
    config_node,
    describe,
    discover,
    names,
    plugin,
    require_values,
    restored,
)
from pgdl_lab.core.split import Split
from pgdl_lab.learning.balancing import BalancingSettings
from pgdl_lab.learning.loss import Loss
from pgdl_lab.learning.model import Model
from pgdl_lab.learning.settings import OptimizerSettings, TrainerSettings
from pgdl_lab.mechanics.fem import Fem
from pgdl_lab.mechanics.finger import Finger

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from pgdl_lab.learning.data import Training

SETTINGS = {
    "balancing": BalancingSettings,
    "observation": Observation,
    "optimizer": OptimizerSettings,
    "trainer": TrainerSettings,
}
"""Parts of the configuration that are not chosen among plugins."""


@dataclass(frozen=True)
class Experiment:
    """A finger, how it is simulated and how a surrogate of it is trained: instances of what the configuration names."""

    finger: Finger
    fem: Fem
    split: Split
    model: Model
    loss: dict[str, Loss]
    balancing: BalancingSettings
    observation: Observation
    optimizer: OptimizerSettings
    trainer: TrainerSettings
    seed: int
    yardstick: Model | None

    def __post_init__(self) -> None:
        if not isinstance(self.seed, int) or not 0 <= self.seed < 2**32:
            raise InputError(f"seed is {self.seed}; it must be a whole number from 0 to 4294967295.")

    @classmethod
    def from_config(cls, config: DictConfig) -> Experiment:
        """Make the instances; each checks its own fields.

        Raises
        ------
        InputError
            If a value lies outside its limits, or no loss is chosen.
        """
        if not config.loss:
            raise InputError("There is no loss to train on: choose at least one, for example loss=[data].")
        try:
            parts: Any = OmegaConf.to_object(config)
        except FrozenInstanceError as error:
            raise InputError(f"A field was added that does not exist ({error}): leave out the '+'.") from error
        for name, settings in SETTINGS.items():
            if not isinstance(parts[name], settings):
                raise InputError(
                    f"{name}={parts[name]} names no field: set {name}.{fields(settings)[0].name} or another."
                )
        # a run does not measure itself; runs of earlier versions name no yardstick
        name = config.get("yardstick")
        parts["yardstick"] = plugin("model", name)() if name and name != parts["model"].name else None
        return cls(**{field.name: parts[field.name] for field in fields(cls)})

    @classmethod
    def of(cls, **chosen: Any) -> Experiment:
        """An experiment from Python; what is not chosen, or None, is what the command line takes for it.

        Parameters
        ----------
        chosen
            Fields of an experiment. A plugin is an instance or the name of one with its own defaults; losses are a list
            of such, or instances by their names.

        Raises
        ------
        InputError
            If there is no plugin of a name, or a value lies outside its limits.
        """
        usual: Any = OmegaConf.to_container(OmegaConf.load(CONF / "config.yaml"))
        for entry in usual["defaults"]:
            usual |= entry if isinstance(entry, dict) else {}
        parts = {name: settings() for name, settings in SETTINGS.items()} | {"seed": usual["seed"], "yardstick": None}
        parts |= {kind: usual[kind] for kind in KINDS}
        parts |= {name: value for name, value in chosen.items() if value is not None}
        losses = parts.pop("loss")
        if not isinstance(losses, Mapping):
            made = [_made("loss", loss) for loss in ([losses] if isinstance(losses, str) else losses)]
            losses = {describe(loss)["name"]: loss for loss in made}
        return cls(loss=dict(losses), **{name: _made(name, part) for name, part in parts.items()})

    def training(self, data: Dataset, train: NDArray[np.int64], folder: Path, **beside: Any) -> Training:
        """The training of this experiment's model on the points `train` (n,) of `data`.

        Parameters
        ----------
        data
            The snapshots of this experiment's finger.
        train
            Their indices, see `Samples.of`.
        folder
            Run folder.
        beside
            "logger" and "callbacks", see `Training`; "provenance", where it is not that of `data`.
        """
        from pgdl_lab.learning.data import Samples, Training
        from pgdl_lab.learning.scene import Scene

        known: dict[str, Any] = {"provenance": data.provenance, "balancing": self.balancing}
        return Training.of(
            Samples.of(data, train), Scene.of(self.finger, data), self.loss, self.trainer, self.optimizer, self.seed,
            folder, **(known | beside),
        )  # fmt: skip


def _made(kind: str, given: Any) -> Any:
    """What is `given` for a part: an instance as it is, the name of a plugin as one with its own defaults."""
    if not isinstance(given, str):
        return given
    if given not in names(kind):
        discover(kind)
    return plugin(kind, given)()


def drop_unchosen(config: DictConfig, overrides: Sequence[str]) -> None:
    """Drop what an experiment sets for losses that the command line `overrides` chose others in the place of.

    Raises
    ------
    InputError
        If a field of such a loss is typed.
    """
    for name in [str(name) for name in config.loss if OmegaConf.get_type(config.loss, name) is dict]:
        if any(re.match(rf"\+*loss\.{re.escape(name)}\b", override) for override in overrides):
            known = [str(other) for other in config.loss if other != name]
            raise InputError(not_chosen(name, known))
        with open_dict(config.loss):
            del config.loss[name]


def not_chosen(loss: str, known: list[str]) -> str:
    """That a field of a loss is typed which is not among those `known`."""
    return f"The loss '{loss}' is not chosen: type loss=[{','.join([*known, loss])}] too."


def store_schema() -> None:
    """Put the typed settings into Hydra's ConfigStore, where `conf/config.yaml` finds them."""
    nodes = {name: config_node(settings) for name, settings in SETTINGS.items()}
    ConfigStore.instance().store(name="schema", node=OmegaConf.create({**nodes, "loss": {}}), provider="pgdl_lab")


def save(config: DictConfig, path: Path) -> None:
    """Write the resolved configuration with the names of its plugins, so that `restore` can build it again."""
    plain: Any = OmegaConf.to_container(config, resolve=True)
    plain.pop("resume", None)  # how the run was called, not what it is
    for kind in KINDS:
        if kind == "loss":
            plain[kind] = {key: _named(config[kind], key, fields) for key, fields in plain[kind].items()}
        else:
            plain[kind] = _named(config, kind, plain[kind])
    with replacing(path) as temporary:
        OmegaConf.save(OmegaConf.create(plain), temporary)


def _named(parent: DictConfig, key: str, fields: dict[str, Any]) -> dict[str, Any]:
    chosen: Any = OmegaConf.get_type(parent, key)
    parts = {part: _named(parent[key], part, fields[part]) for part, whole in PARTS.items() if whole == key}
    return {"name": chosen.name, **fields, **parts}


def restore(path: Path) -> DictConfig:
    """Typed configuration from a file that `save` wrote.

    Raises
    ------
    InputError
        If a plugin that it names is no longer there, or it holds what is to be worked out.
    """
    stored: Any = OmegaConf.load(path)
    require_values(OmegaConf.to_container(stored, resolve=False), path)
    for kind in KINDS:
        if kind == "loss":
            stored[kind] = {key: restored(kind, fields) for key, fields in stored[kind].items()}
        else:
            stored[kind] = restored(kind, stored[kind])
    for name, settings in SETTINGS.items():
        stored[name] = OmegaConf.merge(config_node(settings), stored.get(name) or {})
    return stored


def resumed(config: DictConfig, folder: Path, overrides: list[str]) -> DictConfig:
    """Stored configuration of the run in `folder`, with the trainer settings that are typed now.

    Parameters
    ----------
    config
        What the command line says now.
    folder
        The run to go on with.
    overrides
        What was typed, as key=value.

    Raises
    ------
    InputError
        If anything but `trainer.…` is typed beside `resume`.
    """
    stored = restore(folder / "config.yaml")
    for override in overrides:
        key = override.partition("=")[0]
        if key == "resume":
            continue
        if not key.startswith("trainer."):
            raise InputError(f"resume goes on with the run as it was: '{key}' cannot change now, only trainer.… can.")
        OmegaConf.update(stored, key, OmegaConf.select(config, key))
    return stored
