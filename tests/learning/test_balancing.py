"""The direction of balancing: the weaker term's weight rises."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.registry import plugin
from pgdl_lab.learning.balancing import Balancer, BalancingSettings
from pgdl_lab.learning.objective import Objective
from tests.trainings import training

TERMS = {"strong": 100.0, "weak": 1.0}


def test_weaker_gradient_gets_the_larger_factor() -> None:
    balancer = Balancer(BalancingSettings("gradient_norm", memory=0.5), TERMS)
    balancer.by_gradients(TERMS)
    assert balancer.factors["strong"] < 1 < balancer.factors["weak"]
    for _ in range(50):
        balancer.by_gradients(TERMS)
    assert balancer.factors["weak"] / balancer.factors["strong"] == pytest.approx(100)


def test_slower_term_gets_the_larger_factor() -> None:
    balancer = Balancer(BalancingSettings("relobralo"), TERMS)
    for step in range(5):
        balancer.by_progress({"strong": 0.5**step, "weak": 0.95**step}, draw=0.5)
    assert balancer.factors["strong"] < 1 < balancer.factors["weak"]
    assert sum(balancer.factors.values()) == pytest.approx(2)


def test_relobralo_by_hand() -> None:
    """Shares are 2 / (1 + exp(difference of the ratios)) for the lesser ratio, 2 minus that for the other."""
    balancer = Balancer(BalancingSettings("relobralo", memory=0.9), TERMS)

    def factors(strong: float, weak: float, draw: float) -> list[float]:
        balancer.by_progress({"strong": strong, "weak": weak}, draw)
        return [balancer.factors["strong"], balancer.factors["weak"]]

    assert factors(4.0, 1.0, draw=0.0) == [1, 1]  # nothing to compare with
    # to the last: ratios 0.5 and 1, shares 0.755081 and 1.244919
    assert factors(2.0, 1.0, draw=0.5) == pytest.approx([0.975508, 1.024492], abs=1e-6)
    # to the last: 0.5 and 0.9, shares 0.802625 and 1.197375; to the first: 0.25 and 0.9, 0.685980 and 1.314020
    assert factors(1.0, 0.9, draw=0.0) == pytest.approx([0.697644, 1.302356], abs=1e-6)
    # to the last: 1 and 1, shares 1 and 1
    assert factors(1.0, 0.9, draw=0.5) == pytest.approx([0.727880, 1.272120], abs=1e-6)


def test_term_without_a_gradient_keeps_its_factor() -> None:
    balancer = Balancer(BalancingSettings("gradient_norm"), TERMS)
    balancer.by_gradients({"strong": 2.0, "weak": 0.0})
    assert balancer.factors == {"strong": 1.0, "weak": 1.0}


def test_terms_that_are_zero_or_not_finite_keep_their_factors() -> None:
    for wrong in (0.0, float("nan"), float("inf")):
        gradients, progress = (
            Balancer(BalancingSettings(rule), [*TERMS, "odd"]) for rule in ("gradient_norm", "relobralo")
        )
        gradients.by_gradients({**TERMS, "odd": wrong})
        for value in (1.0, 0.5):
            progress.by_progress({"strong": value, "weak": 1.0, "odd": wrong}, draw=0.5)
        for balancer in (gradients, progress):
            assert balancer.factors["odd"] == 1 and balancer.factors["strong"] < 1 < balancer.factors["weak"]


def test_factors_are_adjusted_every_so_many_steps() -> None:
    due = [step for step in range(10) if Balancer(BalancingSettings("relobralo", every=3), TERMS).due(step)]
    assert due == [0, 3, 6, 9] and not any(Balancer(BalancingSettings(every=3), TERMS).due(step) for step in range(10))


def test_gradients_come_to_lie_in_the_ratio_of_the_weights(tmp_path: Path) -> None:
    losses = {"data": {}, "navier_cauchy": {"weight": 0.25}}
    whole = training(tmp_path, losses)
    torch.manual_seed(0)
    field = plugin("model", "mlp")(depth=2, width=16).new_field(whole)
    settings = BalancingSettings("gradient_norm", memory=0.0)
    objective = Objective(field, whole.losses, whole.samples, whole.scene, settings)
    terms = objective.terms(torch.arange(100), torch.Generator())
    before = objective.gradient_shares(terms)
    objective.balance(terms, torch.Generator())
    after = objective.gradient_shares(terms)
    assert before["navier_cauchy"] < 0.1 and after["navier_cauchy"] == pytest.approx(0.2)
    with torch.no_grad():
        whole_loss = sum(objective.weight(name) * float(value) for name, value in terms.items())
        assert float(objective.total(terms)) == pytest.approx(whole_loss)


@pytest.mark.parametrize("rule", ["gradient_norm", "relobralo"])
def test_balanced_training_resumes_where_it_stood(rule: str, tmp_path: Path) -> None:
    model = plugin("model", "mlp")(depth=2, width=16)
    losses = {"data": {}, "boundary": {}}
    balancing = BalancingSettings(rule, every=3)

    def run(folder: str, epochs: int) -> list[dict[str, float]]:
        whole = training(tmp_path / folder, losses, max_epochs=epochs, schedule="constant")
        return list(model.fit(replace(whole, balancing=balancing)).record.history)

    run("broken", 2)
    resumed, unbroken = run("broken", 4), run("unbroken", 4)
    for ours, theirs in zip(resumed, unbroken, strict=True):
        assert ours["weight/data"] == theirs["weight/data"] and ours["loss"] == theirs["loss"]
    assert resumed[-1]["weight/data"] != 1


@pytest.mark.parametrize("fields", [{"rule": "ntk"}, {"every": 0}, {"memory": 1.0}, {"memory": float("nan")}])
def test_nonsense_is_refused(fields: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        BalancingSettings(**fields)


def test_shares_by_progress_come_from_the_terms_alone(tmp_path: Path) -> None:
    """One term has halved and the other stayed: shares are 2 e^½/(e^½ + e) and 2 e/(e^½ + e)."""
    whole = training(tmp_path, {"data": {}, "boundary": {}})
    field = plugin("model", "mlp")(depth=1, width=4).new_field(whole)
    settings = BalancingSettings("relobralo", memory=0.0)
    objective = Objective(field, whole.losses, whole.samples, whole.scene, settings)
    for data in (4.0, 2.0):  # numbers that no gradient can be taken of
        objective.balance({"data": torch.tensor(data), "boundary": torch.tensor(3.0)}, torch.Generator())
    whole_share = np.exp(0.5) + np.exp(1.0)
    assert objective.balancer.factors["data"] == pytest.approx(2 * np.exp(0.5) / whole_share)
    assert objective.balancer.factors["boundary"] == pytest.approx(2 * np.exp(1.0) / whole_share)


def test_terms_without_weight_have_no_share_of_the_gradient(tmp_path: Path) -> None:
    whole = training(tmp_path, {"data": {"weight": 0.0}})
    field = plugin("model", "mlp")(depth=1, width=4).new_field(whole)
    objective = Objective(field, whole.losses, whole.samples, whole.scene, BalancingSettings())
    assert objective.gradient_shares(objective.terms(torch.arange(10), torch.Generator())) == {"data": 0.0}


def test_norms_of_gradients_by_hand(tmp_path: Path) -> None:
    """Of 3 a + 4 b, of a number, and of what depends on some of the weights alone."""
    whole = training(tmp_path, {"data": {}})
    field = plugin("model", "mlp")(depth=1, width=4).new_field(whole)
    objective = Objective(field, whole.losses, whole.samples, whole.scene, BalancingSettings())
    first, *_, last = field.parameters()
    terms = {
        "both": 3 * first.flatten()[0] + 4 * last.flatten()[0],
        "number": torch.tensor(2.0),
        "one": 2 * last.flatten()[1],
    }
    assert objective.gradient_norms(terms) == pytest.approx({"both": 5.0, "number": 0.0, "one": 2.0})
