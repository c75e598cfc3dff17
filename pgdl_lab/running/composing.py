"""Configurations composed from choices, as the command line does it."""

from collections.abc import Sequence

from hydra import compose, initialize_config_dir
from hydra.core.global_hydra import GlobalHydra
from omegaconf import DictConfig

from pgdl_lab.core import registry
from pgdl_lab.core.paths import CONF
from pgdl_lab.running.experiment import Experiment, drop_unchosen, store_schema
from pgdl_lab.running.hydra_versions import BASE, share_store


def store_choices() -> None:
    """Put all plugins and settings into Hydra's ConfigStore."""
    registry.discover()
    registry.store()
    store_schema()
    share_store()


def composed(choices: Sequence[str]) -> DictConfig:
    """The configuration of `python -m pgdl_lab CHOICES`; also from within a running task."""
    if GlobalHydra.instance().is_initialized():
        return compose("config", list(choices))
    store_choices()
    with initialize_config_dir(str(CONF), **BASE):
        return compose("config", list(choices))


def experiment(choices: Sequence[str]) -> Experiment:
    """What `python -m pgdl_lab CHOICES` would run.

    Raises
    ------
    InputError
        If a value lies outside its limits.
    """
    config = composed(choices)
    drop_unchosen(config, choices)
    return Experiment.from_config(config)
