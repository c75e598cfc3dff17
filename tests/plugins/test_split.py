from functools import cache
from itertools import combinations
from typing import Any

import numpy as np
import pytest

from pgdl_lab.core.dataset import Dataset
from pgdl_lab.core.errors import InputError
from pgdl_lab.core.inputs import Cases
from pgdl_lab.core.registry import discover, names, plugin
from pgdl_lab.core.split import Split
from tests.synthetic import snapshots
from tests.trainings import small

discover()
KPA = np.linspace(0.5, 50, 100)
several = cache(lambda: Dataset.joined([small(), small(), small()], wall_mm=[1.0, 2.0, 3.0]))


def make(name: str, **fields: object) -> Split:
    split = plugin("split", name)(**fields)
    assert isinstance(split, Split)
    return split


@pytest.mark.parametrize("name", names("split"))
class TestEverySplit:
    def test_draws_each_point_once_and_only_from_seen_snapshots(self, name: str) -> None:
        data, split = several(), make(name, points=500)
        train = split.train_points(data, seed=3)
        assert train.shape == (500,) and np.all(np.diff(train) > 0)
        assert split.seen(data.cases)[train // len(data.domain.points_mm)].all()

    def test_repeats_under_a_seed_and_differs_under_another(self, name: str) -> None:
        data, split = several(), make(name, points=500)
        first = split.train_points(data, seed=3)
        assert np.array_equal(first, split.train_points(data, seed=3))
        assert not np.array_equal(first, split.train_points(data, seed=4))

    def test_selects_by_points_of_the_trained_snapshots_that_are_not_trained_on(self, name: str) -> None:
        data, split = several(), make(name, points=500)
        train = split.train_points(data, seed=3)
        selection = split.selection_points(data, train, seed=3)
        assert not np.intersect1d(selection, train).size and len(np.unique(selection)) == len(selection)
        seen = split.seen(data.cases)
        assert seen[selection // len(data.domain.points_mm)].all()
        assert len(selection) == min(2000, (seen.sum() * len(data.domain.points_mm) - 500) // 10)
        assert np.array_equal(selection, split.selection_points(data, train, seed=3))
        assert not np.array_equal(selection, split.selection_points(data, train, seed=4))
        everything = np.flatnonzero(np.repeat(seen, len(data.domain.points_mm)))
        assert not len(split.selection_points(data, everything, seed=3))

    def test_refuses_more_points_than_there_are(self, name: str) -> None:
        with pytest.raises(InputError, match="ask for fewer"):
            make(name, points=10**6).check(several().cases, nodes=1000)

    def test_refuses_no_points(self, name: str) -> None:
        with pytest.raises(InputError, match="at least 1"):
            make(name, points=0)

    def test_highlights_are_snapshots(self, name: str) -> None:
        highlights = make(name).highlights(Cases.path(KPA))
        assert len(highlights) and np.all(np.diff(highlights) > 0) and highlights[-1] == len(KPA) - 1


def test_random_refuses_to_leave_no_test_points() -> None:
    with pytest.raises(InputError, match="none to test on"):
        make("random", points=1000).check(Cases.path(KPA), nodes=10)


def test_random_highlights_the_papers_pressures() -> None:
    assert KPA[make("random").highlights(Cases.path(KPA))] == pytest.approx([10, 20, 30, 40, 50])


@pytest.mark.parametrize("count", [50, 100, 300])
def test_extrapolate_includes_the_cut_off_whatever_the_rounding(count: int) -> None:
    kpa = 50 * np.arange(1, count + 1) / count
    assert kpa[make("extrapolate").seen(Cases.path(kpa))].max() == pytest.approx(44)


def test_extrapolate_highlights_the_papers_pressures() -> None:
    assert KPA[make("extrapolate").highlights(Cases.path(KPA))] == pytest.approx([45, 47, 50])


def test_extrapolate_refuses_a_range_without_snapshots() -> None:
    with pytest.raises(InputError, match="No snapshot lies in the training range"):
        make("extrapolate").check(Cases.path(np.array([45.0, 50.0])), nodes=10)


@pytest.mark.parametrize(
    "fields",
    [{"train_fraction": 1.0}, {"train_fraction": 0.0}, {"tested": [0.5]}, {"tested": []}]
    + [{"tested": [0.88, 1.0]}, {"tested": [0.9, 1.1]}],
)
def test_extrapolate_refuses_fractions_that_leave_nothing(fields: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        make("extrapolate", **fields)


def test_dataset_holds_out_whole_pressures_and_keeps_the_ends() -> None:
    seen = make("snapshots", train_snapshots=9).seen(Cases.path(KPA))
    assert seen.sum() == 9 and seen[0] and seen[-1]


@pytest.mark.parametrize("total", [3, 4, 10, 25, 100])
def test_dataset_gives_as_many_as_it_is_asked_for(total: int) -> None:
    kpa = np.linspace(50 / total, 50, total)
    for count in range(2, total):
        seen = make("snapshots", train_snapshots=count).seen(Cases.path(kpa))
        assert seen.sum() == count and seen[0] and seen[-1]
    assert np.array_equal(make("snapshots", train_snapshots=3).seen(Cases.path(KPA)).nonzero()[0], [0, 49, 99])


def test_dataset_lie_as_near_as_can_be_to_chebyshevs_points() -> None:
    """Against all ways to choose 4 of 9; the points (1 − cos(π k / 3)) / 2 are 0, ¼, ¾ and 1 of the range."""
    for seed in range(5):
        kpa = np.sort(np.random.default_rng(seed).uniform(10, 50, 9))
        wanted = kpa[0] + (kpa[-1] - kpa[0]) * np.array([0.0, 0.25, 0.75, 1.0])
        ways = np.array(list(combinations(range(9), 4)))
        seen = make("snapshots", train_snapshots=4).seen(Cases.path(kpa)).nonzero()[0]
        away = np.abs(kpa[ways] - wanted).sum(axis=1)
        assert np.abs(kpa[seen] - wanted).sum() == pytest.approx(away.min())


@pytest.mark.parametrize("count", [1, 100])
def test_dataset_refuses_to_hold_out_none_or_interpolate_from_one(count: int) -> None:
    with pytest.raises(InputError, match="train_snapshots"):
        make("snapshots", train_snapshots=count).seen(Cases.path(KPA))


def test_extrapolate_includes_a_cut_off_that_rounding_puts_below_its_snapshot() -> None:
    kpa = np.arange(1.0, 101.0)
    assert 0.29 * 100 < 29
    assert kpa[make("extrapolate", train_fraction=0.29).seen(Cases.path(kpa))].max() == 29


def test_extrapolate_refuses_to_train_on_all_pressures_by_the_name_of_the_setting_that_asks_for_it() -> None:
    with pytest.raises(InputError, match="train_fraction is 1.0; it must lie between 0 and 1"):
        make("extrapolate", train_fraction=1.0)


def test_one_point_is_enough_and_a_search_selects_by_2000_at_most() -> None:
    data = snapshots(cell_mm=2.0, count=50)
    split = make("random", points=1)
    train = split.train_points(data, seed=0)
    assert len(train) == 1 and 50 * len(data.domain.points_mm) > 21_000
    assert len(split.selection_points(data, train, seed=0)) == 2000


@pytest.mark.parametrize("given", [[True] * 100, np.ones(3, dtype=bool), np.ones(100)])
def test_what_says_nothing_of_each_case_is_refused(given: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plugin("split", "random"), "seen", lambda *_: given)
    if isinstance(given, list):  # of bool, which is as good
        make("random", points=5).check(Cases.path(KPA), 9)
        return
    with pytest.raises(InputError, match=r"RandomSplit.seen gave .*; it must give bool of shape \(100,\)"):
        make("random", points=5).check(Cases.path(KPA), 9)
