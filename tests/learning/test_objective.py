"""Which pressures the terms of a loss are visited at."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.registry import discover, names, plugin
from pgdl_lab.learning.balancing import BalancingSettings
from pgdl_lab.learning.jet import Jet
from pgdl_lab.learning.loss import Loss, PhysicsLoss
from pgdl_lab.learning.objective import Objective
from pgdl_lab.learning.scene import Scene
from tests.conftest import composed
from tests.trainings import training

discover()
TRAINED_KPA, INTEREST_KPA = 42.5, 50.0


@dataclass(frozen=True)
class Watched(Loss):
    """Remembers what it is given."""

    seen: list[Any] = field(default_factory=list)

    def value(self, jet: Jet, target_mm: torch.Tensor, scene: Scene) -> torch.Tensor:
        assert jet.pressures_kpa is not None
        self.seen.append((jet.pressures_kpa.detach(), target_mm, len(jet.rows)))
        return jet.value.square().mean()


@dataclass(frozen=True)
class Physics(PhysicsLoss, Watched):
    order: ClassVar[int] = 2


@dataclass(frozen=True)
class Own(Watched):
    def own_points(self, scene: Scene) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return scene.domain.points_mm, np.zeros_like(scene.domain.points_mm)


@dataclass(frozen=True)
class OwnPhysics(PhysicsLoss, Own):
    pass


def visited(folder: Path, interest_kpa: float, beyond: bool = True) -> tuple[dict[str, Any], Objective]:
    """What each kind of term is given on the points up to `TRAINED_KPA` of a scene of this interest."""
    how = training(folder, {"data": {}})
    samples = how.samples.at(how.samples.pressures_kpa <= TRAINED_KPA)
    losses = {"data": Watched(), "physics": Physics(beyond=beyond), "own": Own()}
    losses["own physics"] = OwnPhysics(beyond=beyond)
    torch.manual_seed(0)
    mlp = plugin("model", "mlp")(depth=1, width=8).new_field(how)
    scene = replace(how.scene, max_kpa=interest_kpa)
    objective = Objective(mlp, losses, samples, scene, BalancingSettings())
    generator = torch.Generator().manual_seed(0)
    objective.terms(torch.arange(len(samples.pressures_kpa)), generator)
    return {name: loss.seen[0] for name, loss in losses.items()}, objective


def test_physics_is_visited_up_to_the_highest_pressure_of_interest(tmp_path: Path) -> None:
    seen, objective = visited(tmp_path, INTEREST_KPA)
    for name in ("physics", "own", "own physics"):
        kpa = seen[name][0]
        assert INTEREST_KPA - 1 < kpa.max() <= INTEREST_KPA and kpa.min() < 5
        assert float((kpa > TRAINED_KPA).float().mean()) == pytest.approx(7.5 / 47.5, abs=0.04)
    kpa, targets, rows = seen["data"]
    assert torch.equal(kpa, objective.cases[:, 0]) and torch.equal(targets, objective.targets) and rows == 1
    assert seen["physics"][1].isnan().all() and seen["physics"][2] == 6


def test_physics_shares_the_training_points_where_they_reach_all_pressures(tmp_path: Path) -> None:
    seen, objective = visited(tmp_path, TRAINED_KPA)
    for name in ("data", "physics"):
        kpa, targets, rows = seen[name]
        assert torch.equal(kpa, objective.cases[:, 0]) and torch.equal(targets, objective.targets) and rows == 6
    assert seen["own"][0].max() <= TRAINED_KPA * (1 + 1e-6)


def test_physics_stays_within_the_trained_pressures_if_that_is_asked_for(tmp_path: Path) -> None:
    seen, objective = visited(tmp_path, INTEREST_KPA, beyond=False)
    assert torch.equal(seen["physics"][0], objective.cases[:, 0]) and seen["data"][2] == 6
    assert seen["own physics"][0].max() <= TRAINED_KPA * (1 + 1e-6)
    assert seen["own"][0].max() > INTEREST_KPA - 1  # of the clamp, which is no physics


def test_all_terms_but_the_data_and_the_clamp_are_physics() -> None:
    """A term of physics that forgets to be one would be silent where it is needed."""
    for name in names("loss"):
        assert issubclass(plugin("loss", name), PhysicsLoss) == (name not in ("data", "boundary")), name


@pytest.mark.parametrize(("typed", "beyond"), [("paper_extrapolate", False), ("small", True)])
def test_the_papers_physics_is_where_its_data_are(typed: str, beyond: bool) -> None:
    config = composed(f"experiment={typed}", "split=extrapolate", "model=mlp", "loss=[data,navier_cauchy]")
    assert config.loss.navier_cauchy.beyond == beyond


def test_an_interest_that_rounding_puts_above_the_data_is_within_them(tmp_path: Path) -> None:
    seen, objective = visited(tmp_path, TRAINED_KPA * (1 + 1e-12))
    assert torch.equal(seen["physics"][0], objective.cases[:, 0]) and not seen["physics"][1].isnan().any()


def test_nothing_to_minimise_is_refused(tmp_path: Path) -> None:
    how = training(tmp_path, {"data": {}})
    mlp = plugin("model", "mlp")(depth=1, width=8).new_field(how)
    with pytest.raises(InputError, match=r"loss=\[\] leaves nothing to minimise"):
        Objective(mlp, {}, how.samples, how.scene, BalancingSettings())


@pytest.mark.parametrize(
    ("activation", "losses", "named"),
    [
        ("relu", ["data", "navier_cauchy", "boundary"], ["navier_cauchy"]),
        ("tanh", ["data", "navier_cauchy"], []),
        ("relu", ["data", "boundary"], []),
    ],
)
def test_terms_that_a_piecewise_linear_network_cannot_serve_are_named(
    activation: str, losses: list[str], named: list[str], tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    how = training(tmp_path, {name: {} for name in losses})
    mlp = plugin("model", "mlp")(depth=1, width=8, activation=activation).new_field(how)
    Objective(mlp, how.losses, how.samples, how.scene, BalancingSettings())
    assert [message.split()[1] for message in caplog.messages if "second derivatives" in message] == named
