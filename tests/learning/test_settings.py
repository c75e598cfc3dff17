from typing import Any

import pytest

from pgdl_lab.core.errors import InputError
from pgdl_lab.learning.settings import OptimizerSettings, TrainerSettings


@pytest.mark.parametrize(("text", "seconds"), [("90", 90), ("00:02:00", 120), ("1:30", 90), ("1:00:00.5", 3600.5)])
def test_time_is_read(text: str, seconds: float) -> None:
    assert TrainerSettings(max_time=text).max_seconds == seconds


@pytest.mark.parametrize(
    "fields",
    [{"max_time": text} for text in ("", "soon", "0", "1:2:3:4", "inf", "nan", "-5")]
    + [{"max_epochs": 0}, {"threads": 0}, {"validation": 1.0}, {"accelerator": "tpu"}, {"checkpoint_every_s": -1.0}],
)
def test_trainer_refuses_nonsense(fields: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        TrainerSettings(**fields)


@pytest.mark.parametrize(
    "fields",
    [
        {"name": "sgdd"},
        {"name": []},
        {"lr": 0.0},
        {"lr": float("nan")},
        {"batch_size": 0},
        {"schedule": "x"},
        {"weight_decay": -1.0},
    ],
)
def test_optimizer_refuses_nonsense(fields: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        OptimizerSettings(**fields)


def test_several_optimisers_are_a_list() -> None:
    assert OptimizerSettings(name=["adam", "lbfgs"]).stages == ["adam", "lbfgs"]
    with pytest.raises(InputError, match="optimizer.name is 'adm'; choose one of adam, adamw, nadam, muon, lbfgs, lev"):
        OptimizerSettings(name=["adm", "lbfgs"])
