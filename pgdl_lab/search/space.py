"""The search space: settings and what a trial may choose for them, in Hydra's override grammar."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import IntervalSweep, Override, QuotedString, RangeSweep

from pgdl_lab.core.errors import InputError
from pgdl_lab.running.messages import quoted

if TYPE_CHECKING:
    from optuna.distributions import BaseDistribution
    from optuna.trial import BaseTrial


@dataclass(frozen=True)
class Parameter:
    """One setting that trials vary.

    Attributes
    ----------
    name
        The setting, as it is typed.
    text
        Its values, as they are typed.
    distribution
        The same for Optuna.
    when
        Other settings and the texts of their values under which this one exists.
    """

    name: str
    text: str
    distribution: BaseDistribution
    when: Mapping[str, Sequence[str]] = field(default_factory=dict)


@dataclass(frozen=True)
class Space:
    """What trials vary and what is the same in all of them.

    Attributes
    ----------
    parameters
        The settings that vary, each after those it depends on.
    fixed
        Settings typed with one value, and that value as text.
    """

    parameters: Sequence[Parameter]
    fixed: Mapping[str, str]

    def suggest(self, trial: BaseTrial) -> list[str]:
        """Let the sampler choose; the trial's settings as overrides."""
        chosen = dict(self.fixed)
        for parameter in self.parameters:
            if all(chosen.get(other) in values for other, values in parameter.when.items()):
                chosen[parameter.name] = text(_suggest(trial, parameter.name, parameter.distribution))
        return [f"{name}={value}" for name, value in chosen.items()]

    def description(self) -> dict[str, str]:
        """Each parameter's values as one text that two spaces can be compared by."""
        return {each.name: each.text + (f" when {dict(each.when)}" if each.when else "") for each in self.parameters}


def parse(params: Mapping[str, Any], typed: Sequence[str]) -> Space:
    """Read the search space of a search and what was typed beside it; what is typed counts more.

    Raises
    ------
    InputError
        If a text cannot be read, or a condition names a setting that does not come before.
    """
    parser = OverridesParser.create()
    spaces: dict[str, Any] = {}
    conditions: dict[str, Mapping[str, Sequence[str]]] = {}
    for name, given in params.items():
        entry = given if isinstance(given, Mapping) else {"space": given}
        if "space" not in entry or entry.keys() - {"space", "when"}:
            raise InputError(f"The space of {name} is {dict(entry)}; give values, or {{space: values, when: {{...}}}}.")
        spaces[name] = parser.parse_override(f"{name}={entry['space']}")
        conditions[name] = {other: _texts(values) for other, values in (entry.get("when") or {}).items()}
    for each in parser.parse_overrides(list(typed)):
        spaces[each.get_key_element()] = each
    fixed = {name: each.get_value_element_as_str() for name, each in spaces.items() if not each.is_sweep_override()}
    parameters: list[Parameter] = []
    for name, each in spaces.items():
        if name in fixed:
            continue
        known = {*fixed, *(earlier.name for earlier in parameters)}
        for other in conditions.get(name, {}):
            if other not in known:
                raise InputError(
                    f"The space of {name} depends on {other}, which is not searched before it: list that one first."
                )
        values = (each.input_line or "").partition("=")[2]
        parameters.append(Parameter(name, values, _distribution(each), conditions.get(name, {})))
    if not parameters:
        raise InputError("Nothing is searched: type settings with several values, such as 'model.depth=range(2,6)'.")
    return Space(parameters, fixed)


def text(value: Any) -> str:
    """A value as it is typed."""
    if value is None:
        return "null"
    return str(value).lower() if isinstance(value, bool) else str(value)


def _suggest(trial: BaseTrial, name: str, values: Any) -> Any:
    from optuna.distributions import CategoricalDistribution, IntDistribution

    if isinstance(values, CategoricalDistribution):
        return trial.suggest_categorical(name, values.choices)
    suggest: Any = trial.suggest_int if isinstance(values, IntDistribution) else trial.suggest_float
    return suggest(name, values.low, values.high, step=values.step, log=values.log)


def _texts(values: Any) -> list[str]:
    return [text(value) for value in (values if isinstance(values, list) else [values])]


def _typed(value: Any, as_text: str) -> str:
    """A choice as it is typed; Hydra lets the quotes of text go, which its grammar may need."""
    if isinstance(value, QuotedString):
        value = value.text
    return quoted(value) if isinstance(value, str) else as_text


def _distribution(override: Override) -> BaseDistribution:
    from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution

    sweep: Any = override.value()
    tags = sweep.tags
    if tags - {"log", "int"}:
        raise InputError(f"'{override.input_line}' has the tag {min(tags - {'log', 'int'})}; the tags are log and int.")
    try:
        if isinstance(sweep, IntervalSweep):
            low: Any = sweep.start
            high: Any = sweep.end
            if "int" in tags or (isinstance(low, int) and isinstance(high, int)):
                return IntDistribution(int(low), int(high), log="log" in tags)
            return FloatDistribution(low, high, log="log" in tags)
        if isinstance(sweep, RangeSweep):
            values = list(sweep.range())
            if all(isinstance(value, int) for value in values):
                return IntDistribution(values[0], values[-1], step=abs(int(sweep.step)))
            return FloatDistribution(float(values[0]), float(values[-1]), step=float(sweep.step))
        given = sweep.list
        texts = list(override.sweep_string_iterator())
        choices = [
            value if isinstance(value, bool | int | float | None) else _typed(value, as_text)
            for value, as_text in zip(given, texts, strict=True)
        ]
        return CategoricalDistribution(choices)
    except (AttributeError, IndexError, ValueError) as error:
        raise InputError(f"'{override.input_line}' is no search space: {error}") from error
