from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from pgdl_lab.core.errors import InputError
from pgdl_lab.core.registry import discover, plugin
from pgdl_lab.learning.compression import compressed
from pgdl_lab.surrogate.basis import Basis
from pgdl_lab.surrogate.surrogate import Surrogate
from tests.trainings import TRAIN, small, training

discover()


def fitted(name: str, folder: Path, **fields: int) -> Surrogate:
    surrogate = plugin("model", name)(**fields).fit(training(folder, {"data": {}, "boundary": {}}))
    assert isinstance(surrogate, Surrogate)
    return surrogate


def errors(surrogate: Surrogate) -> np.ndarray:
    """Errors (m, 2) of the points that were not trained on [mm]."""
    data = small()
    error = surrogate.predict(data.domain.points_mm, data.pressures_kpa) - data.displacements
    return np.delete(error.reshape(-1, 2), TRAIN, axis=0)


def test_learnt_modes_beat_the_single_fit_and_both_follow_every_chamber(tmp_path: Path) -> None:
    single, learnt = fitted("finite_element", tmp_path), fitted("pod", tmp_path)
    # 398 points in a field that turns by 90 degrees: a network needs minutes for 1e-2 mm²
    assert (errors(single) ** 2).mean() < 1e-2
    assert (errors(learnt) ** 2).mean() < (errors(single) ** 2).mean()


@pytest.mark.parametrize("name", ["pod", "finite_element"])
def test_bars_cover_the_unseen_points_and_grow_beyond_the_trained_pressures(name: str, tmp_path: Path) -> None:
    surrogate, data = fitted(name, tmp_path, degree=6), small()
    bars = surrogate.error_bar(data.domain.points_mm, data.pressures_kpa)
    assert bars is not None
    unseen = np.delete(bars.ravel(), TRAIN)[:, None]
    assert 0.9 < (np.abs(errors(surrogate)) <= unseen).mean() < 0.99
    top, beyond, far = (np.median(surrogate.error_bar(data.domain.points_mm, kpa)) for kpa in (50.0, 56.0, 62.5))
    assert top < beyond < far
    middles = data.domain.points_mm[data.domain.cells].mean(axis=1)
    # the same at the nodes, whoever else is asked for
    together = surrogate.error_bar(np.concatenate([data.domain.points_mm, middles]), data.pressures_kpa)
    assert together is not None and np.array_equal(together[:, : len(data.domain.points_mm)], bars)
    assert np.median(together[:, len(data.domain.points_mm) :]) > np.median(bars)
    held = surrogate.error_bar(data.domain.points_mm[data.domain.clamp], 30.0)
    assert held is not None and held.max() < surrogate.error_bar(data.domain.points_mm, 30.0).min() * 1.01


def test_a_fit_repeats_exactly(tmp_path: Path) -> None:
    first, second = (fitted("pod", tmp_path, degree=3, rounds=1, draws=8) for _ in range(2))
    for name, array in first.state().items():
        assert np.array_equal(array, second.state()[name]), name


def test_no_more_modes_are_kept_than_tell_the_field_from_what_is_not_known_of_it(tmp_path: Path) -> None:
    rng, range_kpa, deviation_mm = np.random.default_rng(0), np.array([0.0, 50.0]), 1e-3
    sizes = np.diag([1e5, 10.0, 1.0, 0.01, 0.001]) * deviation_mm  # each mode has a polynomial of its own
    whole = {"modes": rng.standard_normal((500, 5, 2)), "amplitudes": sizes, "range_kpa": range_kpa}
    polynomials = Basis.of([range_kpa], 4)(np.linspace(0, 57, 60))

    def kept(deviation_mm: float, noise_mm: float) -> tuple[int, float]:
        """Number of modes, and how far the field of them is from the whole one [mm]."""
        spread = np.zeros((500, 5, 5))
        spread[:, 0, 0] = deviation_mm  # the same at all pressures
        state = {**whole, "spread": spread, "noise_mm": np.array(noise_mm), "bar_deviations": np.array([2.0, 3.0])}
        few = compressed({name: torch.from_numpy(array) for name, array in state.items()})
        fields = [np.einsum("pd,dk,nkc", polynomials, state["amplitudes"], state["modes"]) for state in (whole, few)]
        return few["modes"].shape[1], float(np.sqrt(((fields[1] - fields[0]) ** 2).mean()))

    for known in ((deviation_mm, 1.0), (1.0, deviation_mm / 10)):
        count, error_mm = kept(*known)
        assert count == 3 and deviation_mm / 1000 < error_mm < deviation_mm / 10
    count, error_mm = kept(deviation_mm / 1e4, 1.0)
    assert count == 5 and error_mm < 1e-10


def test_noise_costs_no_modes_that_the_data_tell(tmp_path: Path) -> None:
    given, rng = training(tmp_path, {"data": {}}), np.random.default_rng(0)
    exact = given.samples.displacements_mm
    samples = replace(given.samples, displacements_mm=exact + rng.normal(scale=0.5, size=exact.shape))
    surrogate = plugin("model", "pod")().fit(replace(given, samples=samples))
    state = surrogate.state()
    assert 2 <= state["amplitudes"].shape[1] < state["amplitudes"].shape[0] == state["spread"].shape[1]
    assert np.sqrt((errors(surrogate) ** 2).mean()) < 0.5  # less than the noise


@pytest.mark.parametrize("name", ["pod", "finite_element", "gaussian_process"])
def test_what_a_closed_form_cannot_use_is_refused_or_told(
    name: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    model = plugin("model", name)(**({"points": 50, "modes": 4} if name == "gaussian_process" else {"degree": 3}))

    def fitted(losses: dict[str, dict[str, float]]) -> Surrogate:
        surrogate = model.fit(training(tmp_path, losses))
        assert isinstance(surrogate, Surrogate)
        return surrogate

    for physics in ("navier_cauchy", "section"):
        with pytest.raises(InputError, match=f"model={name} is .*cannot take in loss {physics}; leave it out"):
            fitted({"data": {}, physics: {"weight": 1e6}})
    for nothing in ({"boundary": {}}, {"section": {}}, {"data": {"weight": 0.0}, "boundary": {}}):
        with pytest.raises(InputError, match=rf"loss=\[{','.join(nothing)}\] does not count them: add data"):
            fitted(nothing)
    fitted({"data": {}, "navier_cauchy": {"weight": 0.0}})
    assert "leaves out" not in caplog.text
    fitted({"data": {}, "boundary": {}})
    told = "model=gaussian_process leaves out loss boundary: it is fitted to the data alone, clamped points too."
    assert (told in caplog.text) == (name == "gaussian_process")


@pytest.mark.parametrize(
    ("name", "fields", "words"),
    [
        ("finite_element", {"degree": 0}, "model.degree is 0"),
        ("pod", {"rounds": -1}, "model.rounds is -1"),
        ("pod", {"degree": 10, "draws": 10}, "model.draws is 10"),
    ],
)
def test_settings_are_checked(name: str, fields: dict[str, int], words: str) -> None:
    with pytest.raises(InputError, match=words):
        plugin("model", name)(**fields)
