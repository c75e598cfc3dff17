"""A training that is cut, killed, extended or slowed down takes the same steps as one that is not."""

import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from pgdl_lab.core.registry import discover, plugin
from pgdl_lab.learning import clock
from pgdl_lab.learning.fit import _prepared
from pgdl_lab.learning.module import TrainingModule
from pgdl_lab.learning.plan import Plan
from tests.conftest import environment
from tests.trainings import training

discover()
LOSSES: dict[str, Any] = {"data": {}, "boundary": {}}


def model(**fields: Any) -> Any:
    return plugin("model", "mlp")(**{"depth": 1, "width": 12, "activation": "tanh", "dtype": "float64", **fields})


def weights(surrogate: Any) -> torch.Tensor:
    return torch.cat([weight.flatten() for weight in surrogate.field.parameters()])


def losses(surrogate: Any) -> list[tuple[float, ...]]:
    """The loss history, but for the times."""
    names = ("epoch", "lr", "raw/data", "raw/boundary", "validation")
    # methods that take all points at once have no learning rate
    return [tuple(np.nan_to_num(entry[name], nan=-1.0) for name in names) for entry in surrogate.record.history]


@pytest.fixture
def seconds(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """A clock that stands at the number in this list, and goes on by one second with each step of a training."""
    at = [0.0]
    monkeypatch.setattr(clock, "now", lambda: at[0])
    taken = TrainingModule._take_step

    def step(self: TrainingModule, number: int) -> str | None:
        at[0] += 1
        return taken(self, number)

    monkeypatch.setattr(TrainingModule, "_take_step", step)
    return at


@pytest.mark.parametrize("name", ["adam", "muon", "lbfgs", "levenberg_marquardt"])
def test_twenty_epochs_and_twenty_more_are_forty(name: str, tmp_path: Path) -> None:
    def run(folder: str, epochs: int) -> Any:
        how = {"name": name, "schedule": "constant", "lr": 0.05, "max_epochs": epochs, "log_every_s": 0}
        return model().fit(training(tmp_path / folder, LOSSES, **how))

    whole, half, extended = run("whole", 40), run("parts", 20), run("parts", 40)
    assert torch.equal(weights(whole), weights(extended)) and losses(whole) == losses(extended)
    assert losses(half) == losses(whole)[:20] and not torch.equal(weights(whole), weights(half))


def test_training_goes_on_from_the_last_state_and_the_best_is_kept_beside_it(tmp_path: Path) -> None:
    """A rate that ruins the weights: the best state is the first, the last is far from it."""

    def run(folder: str, epochs: int) -> Any:
        how = {"schedule": "constant", "lr": 3.0, "max_epochs": epochs}
        return plugin("model", "body")(depth=1, width=16, modes=32).fit(training(tmp_path / folder, LOSSES, **how))

    whole, extended = run("whole", 4), (run("parts", 2), run("parts", 4))[1]
    assert losses(whole) == losses(extended) and losses(whole)[-1][2] > 1
    stored = torch.load(tmp_path / "parts/checkpoints/last.ckpt", weights_only=True)
    last = stored["state_dict"]["objective.field.linear.weight"]
    assert torch.equal(extended.field.linear.weight, stored["best"]["start"]["weights"]["linear.weight"])
    assert (last - extended.field.linear.weight).abs().max() > 1


@pytest.mark.parametrize("schedule", ["constant", "cosine"])
def test_a_training_that_the_time_cuts_within_an_epoch_goes_on_there(
    schedule: str, tmp_path: Path, seconds: list[float]
) -> None:
    """4 steps an epoch: 14 s end within the fourth epoch."""

    def run(folder: str, limit_s: float) -> Any:
        seconds[0] = 0.0
        how = {"schedule": schedule, "max_epochs": 8, "max_time": f"{limit_s:g}", "checkpoint_every_s": 1e9}
        return model().fit(training(tmp_path / folder, LOSSES, **how))

    whole, cut, again = run("whole", 1e6), run("parts", 14), run("parts", 14)
    ended = cut.record.history[-1]["epoch"]
    assert ended % 1 and cut.record.history == again.record.history and torch.equal(weights(cut), weights(again))
    extended = run("parts", 1e6)
    assert [entry["epoch"] for entry in extended.record.history] == list(range(1, 9))
    if schedule == "constant":
        assert torch.equal(weights(whole), weights(extended)) and losses(whole) == losses(extended)
    else:  # the first part was annealed to its own end
        assert cut.record.history[-1]["lr"] < 1e-4 < whole.record.history[3]["lr"]


@pytest.mark.parametrize("name", [["adam"], ["adam", "lbfgs"]])
def test_a_stalled_clock_changes_nothing(name: list[str], tmp_path: Path, seconds: list[float]) -> None:
    def run(folder: str, stalls: dict[int, float]) -> Any:
        seconds[0] = 0.0
        taken = TrainingModule._take_step

        def step(self: TrainingModule, number: int) -> str | None:
            seconds[0] += stalls.get(self.step, 0.0)
            return taken(self, number)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(TrainingModule, "_take_step", step)
            return model().fit(training(tmp_path / folder, LOSSES, name=name, max_epochs=6, max_time="40"))

    smooth = run("smooth", {})
    for place, stalls in enumerate(({1: 6.0}, {9: 6.0}, {2: 3.0, 17: 3.0, 20: 3.0})):
        stalled = run(f"stalled_{place}", stalls)
        assert torch.equal(weights(smooth), weights(stalled)) and losses(smooth) == losses(stalled)


def test_a_plan_is_what_fits_at_the_speed_of_the_first_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    at = [0.0]
    monkeypatch.setattr(clock, "now", lambda: at[0])

    def planned(slow: dict[int, float], until: int, limit_s: float = 100.0, stages: int = 1) -> Plan:
        at[0] = 0.0
        plan = Plan(stages, 1000, 4, clock.Clock(limit_s))
        for step in range(until):
            plan.begins(step, once_per_epoch=False)
            at[0] += slow.get(step, 1.0)
        return plan

    assert planned({}, 5).end == 4000  # not known yet
    plain = planned({}, 30)
    assert 90 < plain.end <= 100
    assert planned({0: 5.0, 20: 50.0}, 40).end == pytest.approx(plain.end, abs=5)  # of slow steps only the time is lost
    assert planned({}, 30, limit_s=1e4).end == 4000  # all fit
    assert 45 < planned({}, 30, stages=2).end <= 50
    assert plain.progress(plain.end // 2) == pytest.approx(0.5, abs=0.01)
    assert planned({}, 51, stages=2).progress(51) == 1 and not planned({}, 51, stages=2).last


@pytest.mark.parametrize(
    ("first_s", "other_s", "once", "limit_s", "settled", "end"),
    [
        (1.0, 1.0, False, 100.0, 10, 95),  # after a tenth of the time; 95 % of the 90 s left at 1 s each
        (1.0, 1.0, False, 40.0, 5, 38),  # not before 5 steps were seen: 95 % of 35 s
        (8.0, 2.0, False, 1e3, 29, 271),  # within an epoch of 14 s; five of which tell 3.5 s a step
        (6.0, 0.0, True, 100.0, 20, 64),  # the first step of an epoch does it all: 1.5 s a step, 95 % of 70 s
    ],
)
def test_a_plan_by_hand(
    first_s: float, other_s: float, once: bool, limit_s: float, settled: int, end: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    at = [0.0]
    monkeypatch.setattr(clock, "now", lambda: at[0])
    plan, laid = Plan(1, 1000, 4, clock.Clock(limit_s)), []
    for step in range(40):
        plan.begins(step, once)
        laid.append(plan.end)
        at[0] += other_s if step % 4 else first_s
    assert laid == [4000] * settled + [end] * (40 - settled)
    assert plan.progress(end // 5) == pytest.approx((end // 5) / end) and plan.progress(end + 1) == 1


def test_a_plan_shares_epochs_out_and_goes_on_with_the_same_budget_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    at = [0.0]
    monkeypatch.setattr(clock, "now", lambda: at[0])
    plan = Plan(2, 5, 4, clock.Clock(100.0))
    assert (plan.stage, plan.begun, plan.end, plan.last) == (0, 0, 12, False)  # whole epochs
    assert plan.progress_of_all(6) == pytest.approx(0.25)
    at[0] = 60.0
    assert plan.progress_of_all(6) == pytest.approx(0.6)  # the time is further
    plan.start(1, 12)
    assert (plan.stage, plan.begun, plan.end, plan.last) == (1, 12, 20, True)
    assert plan.progress(14) == 0.25 and plan.progress_of_all(18) == pytest.approx(0.875)
    at[0] = 200.0
    plan.begins(13, once_per_epoch=False)  # the time is over
    assert plan.end == 13 and plan.progress(13) == 1 and plan.progress_of_all(13) == 1

    for epochs, limit_s, end in ((5, 100.0, 13), (6, 100.0, 24), (5, 300.0, 20)):
        resumed = Plan(2, epochs, 4, clock.Clock(limit_s, spent_s=50.0))
        resumed.restore(plan.state())
        assert (resumed.stage, resumed.begun, resumed.end) == (1, 12, end)
    at[0] += 25.0
    assert resumed._clock.seconds == 75.0 and resumed._clock.left_s == 225.0
    at[0] += 300.0
    assert resumed._clock.left_s == 0.0


def test_steps_too_short_to_be_measured_shorten_no_plan(monkeypatch: pytest.MonkeyPatch) -> None:
    at = [0.0]
    monkeypatch.setattr(clock, "now", lambda: at[0])
    plan = Plan(1, 1000, 4, clock.Clock(100.0))
    for step in range(30):
        plan.begins(step, once_per_epoch=False)
        at[0] += 20.0 * (step == 9)
    assert plan.end == 4000


CHILD = """
import sys
from pathlib import Path
from tests.learning.test_resume import endless, model
print("begins", flush=True)
model().fit(endless(Path(sys.argv[1])))
"""


def endless(folder: Path, checkpoint_every_s: float = 0.0) -> Any:
    """Epochs of 29 steps; the place is written after each step."""
    return training(folder, LOSSES, max_epochs=2000, batch_size=64, checkpoint_every_s=checkpoint_every_s)


def test_a_training_that_is_killed_within_an_epoch_goes_on_at_that_step(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A real process and a real kill; what it left is compared with a training that nobody disturbed."""
    file = tmp_path / "checkpoints/last.ckpt"

    def place() -> dict[str, Any]:
        found: dict[str, Any] = torch.load(file, weights_only=True)["place"]
        return found

    child = subprocess.Popen([sys.executable, "-c", CHILD, str(tmp_path)], env=environment(tmp_path))
    limit = time.monotonic() + 120
    while not file.exists() or not 3 < place()["done"] < 20:
        assert child.poll() is None and time.monotonic() < limit
        time.sleep(0.01)
    child.send_signal(signal.SIGKILL)
    child.wait()
    killed = place()
    assert 0 < killed["done"] < 29

    states: dict[str, dict[int, torch.Tensor]] = {"resumed": {}, "whole": {}}
    close = TrainingModule._close_epoch
    for name, folder in (("resumed", tmp_path), ("whole", tmp_path / "whole")):

        def close_and_keep(self: TrainingModule, last: bool, name: str = name) -> None:
            close(self, last)
            states[name][self._epoch] = torch.cat([w.detach().flatten() for w in self.objective.parameters()])
            self.trainer.should_stop |= self._epoch > killed["epoch"]

        monkeypatch.setattr(TrainingModule, "_close_epoch", close_and_keep)
        model().fit(endless(folder, checkpoint_every_s=1e9))
    assert list(states["resumed"]) == [killed["epoch"], killed["epoch"] + 1]
    for epoch, state in states["resumed"].items():
        assert torch.equal(state, states["whole"][epoch])


def test_what_a_checkpoint_holds_comes_back_where_it_is_used(tmp_path: Path) -> None:
    """A device whose numbers cannot be read stands for a GPU: states are copied to the CPU, the rest is moved to it."""
    how = training(tmp_path, LOSSES)
    module = _prepared(model(), how)
    module._keep_best()
    module._sums = {"data": torch.ones(())}
    checkpoint: dict[str, Any] = {}
    module.on_save_checkpoint(checkpoint)
    place = checkpoint["place"]
    assert module.best["start"]["errors"].device.type == "cpu"
    module.to("meta")
    assert module.held_inputs.device.type == module.held_targets.device.type == "meta"
    for copied in (module._weights, module._validation):
        with pytest.raises(NotImplementedError, match="Cannot copy out of meta tensor"):
            copied()
    module._go_on_within_epoch(place)
    assert module._order.device.type == module._sums["data"].device.type == "meta"
