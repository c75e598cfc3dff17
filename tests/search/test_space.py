import optuna
import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra_plugins.pgdl_optuna import PgdlOptunaSweeper
from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution
from optuna.trial import FixedTrial

from pgdl_lab.core.errors import InputError
from pgdl_lab.search.settings import SearchSettings
from pgdl_lab.search.space import parse


@pytest.mark.parametrize(
    ("typed", "values"),
    [
        ("a=choice(tanh,64,[data,boundary])", CategoricalDistribution(["tanh", 64, "[data,boundary]"])),
        ("a=1,2.5,true", CategoricalDistribution([1, 2.5, True])),
        ("a=[x],[x,y]", CategoricalDistribution(["[x]", "[x,y]"])),
        ("a=range(2,7)", IntDistribution(2, 6)),
        ("a=range(2,9,3)", IntDistribution(2, 8, step=3)),
        ("a=range(0.5,2,0.5)", FloatDistribution(0.5, 1.5, step=0.5)),
        ("a=interval(1,5)", FloatDistribution(1, 5)),
        ("a=int(interval(1,5))", IntDistribution(1, 5)),
        ("a=tag(log,interval(1e-4,1e-2))", FloatDistribution(1e-4, 1e-2, log=True)),
        ("a=tag(log,int,interval(16,256))", IntDistribution(16, 256, log=True)),
    ],
)
def test_hydras_grammar_gives_optunas_distributions(typed: str, values: object) -> None:
    (parameter,) = parse({}, [typed]).parameters
    assert parameter.distribution == values


@pytest.mark.parametrize("typed", ["choice({})", "{}"])
def test_any_text_can_be_searched(typed: str) -> None:
    texts = ["ä.vtu", "o'n.vtu", "a,b", "a;b c", "plain", "x<1", "3"]
    elements = ",".join("'{}'".format(text.replace("'", "\\'")) for text in texts)
    space = parse({}, ["finger.path=" + typed.format(elements)])
    distribution = space.parameters[0].distribution
    assert isinstance(distribution, CategoricalDistribution)
    overrides = [space.suggest(FixedTrial({"finger.path": choice}))[0] for choice in distribution.choices]
    assert [OverridesParser.create().parse_override(override).value() for override in overrides] == texts


def test_a_setting_exists_only_under_its_condition_and_what_is_typed_counts_more() -> None:
    params = {
        "loss": "choice([data],[data,boundary])",
        "loss.boundary.weight": {"space": "tag(log,interval(0.1,10))", "when": {"loss": "[data,boundary]"}},
        "seed": "range(0,9)",
    }
    both = parse(params, ["task=train", "seed=3"])
    assert [parameter.name for parameter in both.parameters] == ["loss", "loss.boundary.weight"]
    alone = optuna.trial.FixedTrial({"loss": "[data]", "loss.boundary.weight": 1.0})
    assert both.suggest(alone) == ["seed=3", "task=train", "loss=[data]"]
    pair = optuna.trial.FixedTrial({"loss": "[data,boundary]", "loss.boundary.weight": 0.5})
    assert both.suggest(pair)[-1] == "loss.boundary.weight=0.5"
    settled = parse(params, ["loss=[data]"])
    assert settled.suggest(optuna.trial.FixedTrial({"seed": 4})) == ["loss=[data]", "seed=4"]


@pytest.mark.parametrize(
    ("params", "typed", "answer"),
    [
        ({}, ["a=1"], "Nothing is searched"),
        ({"a": "tag(loud,interval(0,1))"}, [], "has the tag loud; the tags are log and int"),
        ({"a": {"space": "1,2", "when": {"b": "x"}}, "b": "x,y"}, [], "depends on b, which is not searched before it"),
        ({"a": {"values": "1,2"}}, [], "The space of a is"),
        ({"a": "tag(log,interval(0,1))"}, [], "is no search space"),
        ({"a": "range(3,3)"}, [], "is no search space"),
    ],
)
def test_a_space_that_cannot_be_read_is_one_sentence(params: dict, typed: list[str], answer: str) -> None:
    with pytest.raises(InputError, match=answer):
        parse(params, typed)


@pytest.mark.parametrize(
    ("fields", "answer"),
    [
        ({"objectives": ["a", "b"], "pruner": {"_target_": "x"}}, r"2 objectives \(a, b\): set hydra.sweeper.pruner="),
        ({"objectives": []}, "no objective"),
        ({"objectives": ["least a"]}, "has a space"),
        ({"objectives": ["misfit"]}, "needs hydra.sweeper.targets"),
        ({"targets": {"a": [1.0, 0.0]}}, "the latter above 0"),
        ({"study": "a/b"}, "names the folder"),
        ({"study": "snapshots"}, "names the folder"),
        ({"n_trials": 0}, "n_trials is 0"),
        ({"trial_seconds": -1.0}, "trial_seconds is -1.0 s"),
        ({"max_failure_rate": 2.0}, "max_failure_rate is 2.0"),
    ],
)
def test_settings_that_make_no_sense_are_refused(fields: dict, answer: str) -> None:
    with pytest.raises(InputError, match=answer):
        SearchSettings(**{"study": "s", **fields})


def test_a_setting_of_the_sweeper_that_there_is_not_is_told_with_the_closest() -> None:
    with pytest.raises(InputError, match="no hydra.sweeper field 'worker'. Did you mean 'workers'"):
        PgdlOptunaSweeper(study="s", worker=2)


def test_directions() -> None:
    settings = SearchSettings("s", objectives=["a.b+a.c", "maximize d"])
    assert settings.directions == {"a.b+a.c": "minimize", "d": "maximize"}
