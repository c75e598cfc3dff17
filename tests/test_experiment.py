from pathlib import Path

import pytest
from hydra.errors import HydraException
from omegaconf import OmegaConf

from pgdl_lab.core import registry
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.paths import CONF
from pgdl_lab.mechanics.material import Yeoh
from pgdl_lab.running import experiment
from pgdl_lab.running.messages import sentence
from tests.conftest import composed

TYPED = [
    "finger.chambers=4",
    "finger/material=ogden",
    "finger.material.alpha=[1.5,4]",
    "split=extrapolate",
    "loss=[data,boundary]",
    "loss.boundary.weight=2",
    "seed=5",
]


def test_an_experiment_is_made_of_plugins() -> None:
    made = experiment.Experiment.from_config(composed(*TYPED))
    assert registry.describe(made.finger)["chambers"] == 4
    assert registry.describe(made.split)["name"] == "extrapolate"
    assert {name: loss.weight for name, loss in made.loss.items()} == {"data": 1.0, "boundary": 2.0}
    assert made.seed == 5
    assert registry.describe(made.yardstick)["name"] == "finite_element"


@pytest.mark.parametrize("typed", ["yardstick=null", "model=finite_element"])
def test_no_yardstick_is_measured_where_none_is_wanted_or_it_is_the_model(typed: str) -> None:
    assert experiment.Experiment.from_config(composed(typed)).yardstick is None


def test_an_unknown_yardstick_is_refused() -> None:
    with pytest.raises(InputError, match="There is no model 'finite_elements'. Did you mean 'finite_element'"):
        experiment.Experiment.from_config(composed("yardstick=finite_elements"))


def test_a_stored_configuration_makes_the_same_experiment(tmp_path: Path) -> None:
    config = composed(*TYPED)
    experiment.save(config, tmp_path / "config.yaml")
    restored = experiment.restore(tmp_path / "config.yaml")
    assert experiment.Experiment.from_config(restored) == experiment.Experiment.from_config(config)
    experiment.save(restored, tmp_path / "again.yaml")
    assert (tmp_path / "again.yaml").read_text() == (tmp_path / "config.yaml").read_text()


def test_a_stored_configuration_without_the_law_has_that_of_the_finger(tmp_path: Path) -> None:
    experiment.save(composed("finger=joints", "finger.material.c1_mpa=0.6"), tmp_path / "config.yaml")
    stored = OmegaConf.load(tmp_path / "config.yaml")
    assert stored.finger.material.pop("name") == "yeoh"
    OmegaConf.save(stored, tmp_path / "config.yaml")
    made = experiment.Experiment.from_config(experiment.restore(tmp_path / "config.yaml"))
    assert made.finger.material == Yeoh(c1_mpa=0.6, c2_mpa=0.0, c3_mpa=0.002562)


@pytest.mark.parametrize(
    ("typed", "wanted"),
    [
        (["finger=joints"], Yeoh(c1_mpa=0.5056, c2_mpa=0.0, c3_mpa=0.002562)),
        (["finger=joints", "finger.material.c2_mpa=0.1"], Yeoh(c1_mpa=0.5056, c2_mpa=0.1, c3_mpa=0.002562)),
        (["finger=joints", "finger/material=yeoh"], Yeoh()),
        (["finger=joints", "finger/material=neo_hooke"], Yeoh(c2_mpa=0.0, c3_mpa=0.0)),
        (["finger=pneunet", "finger/material=joints"], Yeoh(c1_mpa=0.5056, c2_mpa=0.0, c3_mpa=0.002562)),
        (["finger=pneunet_reference", "finger.material.poisson=0.48"], Yeoh(poisson=0.48)),
    ],
)
def test_a_finger_is_of_its_own_material_unless_another_is_typed(typed: list[str], wanted: Yeoh) -> None:
    assert experiment.Experiment.from_config(composed(*typed)).finger.material == wanted


def test_another_law_takes_the_place_of_the_fingers_own() -> None:
    typed = ["finger=bellows", "finger/material=mooney_rivlin", "finger.material.c10_mpa=0.1"]
    material = experiment.Experiment.from_config(composed(*typed)).finger.material
    assert registry.describe(material) == {"name": "mooney_rivlin", "poisson": 0.49, "c10_mpa": 0.1, "c01_mpa": 0.02}


def test_a_stored_plugin_that_is_gone_is_named(tmp_path: Path) -> None:
    experiment.save(composed(), tmp_path / "config.yaml")
    text = (tmp_path / "config.yaml").read_text().replace("name: pneunet", "name: gone")
    (tmp_path / "config.yaml").write_text(text)
    with pytest.raises(InputError, match="There is no finger 'gone'"):
        experiment.restore(tmp_path / "config.yaml")


def test_a_stored_configuration_calls_nothing(tmp_path: Path) -> None:
    experiment.save(composed(), tmp_path / "config.yaml")
    with (tmp_path / "config.yaml").open("a") as file:
        file.write("note: ${oc.env:HOME}\n")
    with pytest.raises(InputError, match=r"config.yaml holds the setting '\$\{oc.env:HOME\}': stored settings are"):
        experiment.restore(tmp_path / "config.yaml")


@pytest.mark.parametrize(
    ("name", "split", "form"),
    [
        ("paper_random", "random", "corrected"),
        ("paper_extrapolate", "extrapolate", "corrected"),
        ("paper_printed", "random", "published"),
    ],
)
def test_the_papers_settings(name: str, split: str, form: str) -> None:
    paper = experiment.Experiment.from_config(composed(f"experiment={name}"))
    assert registry.describe(paper.split)["name"] == split
    assert paper.split.points == 20_000
    model = registry.describe(paper.model)
    assert (model["name"], model["depth"], model["width"], model["activation"]) == ("mlp", 8, 100, "relu")
    assert registry.describe(paper.loss["navier_cauchy"])["form"] == form
    assert (paper.optimizer.name, paper.optimizer.lr, paper.optimizer.batch_size) == ("adam", 1e-3, 512)
    assert (paper.optimizer.schedule, paper.trainer.max_epochs) == ("constant", 100_000)
    assert (paper.observation.snapshots, paper.observation.points) == (100, 4439)


def test_losses_chosen_in_the_place_of_those_of_an_experiment_are_all_that_train() -> None:
    typed = ["experiment=paper_random", "loss=[data]"]
    config = composed(*typed)
    experiment.drop_unchosen(config, typed)
    assert list(experiment.Experiment.from_config(config).loss) == ["data"]


def test_a_field_of_a_loss_of_the_experiment_that_is_not_chosen_is_refused() -> None:
    typed = ["experiment=paper_random", "loss=[data,boundary]", "loss.navier_cauchy.weight=2"]
    with pytest.raises(InputError, match=r"is not chosen: type loss=\[data,boundary,navier_cauchy\] too"):
        experiment.drop_unchosen(composed(*typed), typed)


def test_an_experiment_that_does_not_fit_what_is_chosen_is_named() -> None:
    with pytest.raises(HydraException) as caught:
        composed("experiment=paper_random", "model=pod")
    assert sentence(caught.value).startswith(
        "experiment=paper_random sets model.depth, which the chosen model does not have: leave out one"
    )


@pytest.mark.parametrize("name", sorted(path.stem for path in (CONF / "experiment").glob("*.yaml")))
def test_every_stored_experiment_can_be_made(name: str) -> None:
    assert experiment.Experiment.from_config(composed(f"experiment={name}")).loss
