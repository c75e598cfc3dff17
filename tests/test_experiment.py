from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from omegaconf import DictConfig

from pgdl_lab import experiment, registry
from pgdl_lab.cli import store_choices
from pgdl_lab.errors import InputError
from pgdl_lab.paths import CONF


def composed(*typed: str) -> DictConfig:
    store_choices()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        return compose("config", list(typed))


TYPED = ["finger.chambers=4", "split=extrapolate", "loss=[data,boundary]", "loss.boundary.weight=2", "seed=5"]


def test_an_experiment_is_made_of_plugins() -> None:
    made = experiment.Experiment.from_config(composed(*TYPED))
    assert registry.describe(made.finger)["chambers"] == 4
    assert registry.describe(made.split)["name"] == "extrapolate"
    assert {name: loss.weight for name, loss in made.loss.items()} == {"data": 1.0, "boundary": 2.0}
    assert made.seed == 5


def test_a_stored_configuration_makes_the_same_experiment(tmp_path: Path) -> None:
    config = composed(*TYPED)
    experiment.save(config, tmp_path / "config.yaml")
    restored = experiment.restore(tmp_path / "config.yaml")
    assert experiment.Experiment.from_config(restored) == experiment.Experiment.from_config(config)
    experiment.save(restored, tmp_path / "again.yaml")
    assert (tmp_path / "again.yaml").read_text() == (tmp_path / "config.yaml").read_text()


def test_a_stored_plugin_that_is_gone_is_named(tmp_path: Path) -> None:
    experiment.save(composed(), tmp_path / "config.yaml")
    text = (tmp_path / "config.yaml").read_text().replace("name: pneunet", "name: gone")
    (tmp_path / "config.yaml").write_text(text)
    with pytest.raises(InputError, match="There is no finger 'gone'"):
        experiment.restore(tmp_path / "config.yaml")


@pytest.mark.parametrize("name", ["paper_random", "paper_extrapolate"])
def test_the_papers_settings(name: str) -> None:
    paper = experiment.Experiment.from_config(composed(f"experiment={name}"))
    assert registry.describe(paper.split)["name"] == name.removeprefix("paper_")
    assert paper.split.points == 20_000
    model = registry.describe(paper.model)
    assert (model["name"], model["depth"], model["width"], model["activation"]) == ("mlp", 8, 100, "relu")
    assert registry.describe(paper.loss["navier_cauchy"])["form"] == "published"
    assert (paper.optimizer.name, paper.optimizer.lr, paper.optimizer.batch_size) == ("adam", 1e-3, 512)
    assert (paper.optimizer.schedule, paper.trainer.max_epochs) == ("constant", 100_000)
    assert (paper.observation.snapshots, paper.observation.points) == (100, 4439)
