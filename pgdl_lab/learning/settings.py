"""How long and by which rule a model is trained: the config groups `trainer` and `optimizer`."""

import math
import shutil
from dataclasses import dataclass
from typing import Any

from pgdl_lab.core.errors import InputError

ACCELERATORS = ("auto", "cpu", "gpu")
COMPILERS = ("g++", "clang++", "cl")
FIRST_ORDER = ("adam", "adamw", "nadam", "muon")
FULL_BATCH = ("lbfgs", "levenberg_marquardt")
OPTIMIZERS = FIRST_ORDER + FULL_BATCH
SCHEDULES = ("constant", "cosine")


@dataclass(frozen=True)
class TrainerSettings:
    """The budget and the housekeeping of a training.

    Training ends with `max_epochs` or `max_time`, whichever comes first. The learning-rate schedule follows the steps:
    as many as `max_epochs` makes or, if those do not fit, as the speed of the first steps allows in `max_time`. A run
    whose epochs fit repeats exactly under the same seed, also if the clock stalls later, if it is killed and resumed at
    any step, or if it is given more epochs later under a constant learning rate; see `Plan`.

    Attributes
    ----------
    max_time
        Time budget, "hours:minutes:seconds" or seconds, with the preparation of a model; time spent before a resume
        counts. A step, or a fit of a closed form, that has begun ends; two of these fits are made in any case.
    max_epochs
        Epoch budget; one epoch is one pass over the training points.
    accelerator
        "auto" (a GPU where there is one), "cpu" or "gpu".
    validation
        Share of the training points that is set aside before anything is fitted: the state that errs least on them is
        taken, or that before the first step if the gain may be chance, and error bars are calibrated on them. 0 takes
        the last state. Closed forms leave out points in turn instead and learn from all in the end.
    threads
        CPU threads of the training, of closed forms too. More than one hardly speeds up a small network, and on a busy
        machine threads that wait for each other slow it down many times over.
    compile
        Whether the derivatives of the field are compiled, which takes half a minute and a C++ compiler. Steps with
        second derivatives of a network of x, z and p take two thirds of the time then.
    checkpoint_every_s
        Time between checkpoints [s].
    log_every_s
        Least time between two entries of the loss history [s]; entries are made at the end of epochs, and seldom enough
        to take no more than a hundredth of the time, unless this is 0.
    progress
        Whether a progress bar is shown.
    """

    max_time: str = "00:01:40"
    max_epochs: int = 250
    accelerator: str = "auto"
    validation: float = 0.1
    threads: int = 1
    compile: bool = False
    checkpoint_every_s: float = 20.0
    log_every_s: float = 1.0
    progress: bool = True

    def __post_init__(self) -> None:
        if self.max_epochs < 1:
            raise InputError(f"trainer.max_epochs is {self.max_epochs}; it must be at least 1.")
        if not 0 <= self.validation < 1:
            raise InputError(f"trainer.validation is {self.validation}; it must be a share from 0 to below 1.")
        if self.threads < 1:
            raise InputError(f"trainer.threads is {self.threads}; it must be at least 1.")
        if self.compile and not any(map(shutil.which, COMPILERS)):
            raise InputError(
                f"trainer.compile is true, but none of the C++ compilers {', '.join(COMPILERS)} is installed; install "
                "one or leave it false."
            )
        if self.accelerator not in ACCELERATORS:
            raise InputError(f"trainer.accelerator is '{self.accelerator}'; choose one of {', '.join(ACCELERATORS)}.")
        for name in ("checkpoint_every_s", "log_every_s"):
            if not getattr(self, name) >= 0:
                raise InputError(f"trainer.{name} is {getattr(self, name)} s; it must not be negative.")
        if not self.max_seconds > 0:
            raise InputError(f"trainer.max_time is '{self.max_time}'; it must be above 0.")

    @property
    def max_seconds(self) -> float:
        """Time budget [s]."""
        try:
            parts = [float(part) for part in self.max_time.split(":")]
        except ValueError:
            parts = []
        if not 1 <= len(parts) <= 3 or not all(math.isfinite(part) for part in parts):
            raise InputError(f"trainer.max_time is '{self.max_time}'; write it as hours:minutes:seconds or as seconds.")
        return sum(part * 60**power for power, part in enumerate(reversed(parts)))


@dataclass(frozen=True)
class OptimizerSettings:
    """The rule by which the weights are changed.

    Attributes
    ----------
    name
        "adam", "adamw", "nadam", "muon" (matrices by Muon, the rest by AdamW), "lbfgs" or "levenberg_marquardt"; or
        several of them as a list, such as [adam, lbfgs], which share the budget equally, one after the other. The last
        two take all training points at once, one iteration per epoch, in float64; they may end before their share does.
        null: the one that suits the model, "lbfgs" for hybrid and "adam" for all others.
    lr
        Learning rate at the start; has no effect on methods that take all points at once.
    batch_size
        Training points per step, likewise.
    schedule
        "constant" or "cosine" (from `lr` to 0 over the share of the budget), likewise.
    weight_decay
        Weight decay of the optimiser, likewise.
    """

    name: Any = None
    lr: float = 4e-3
    batch_size: int = 512
    schedule: str = "cosine"
    weight_decay: float = 0.0

    def __post_init__(self) -> None:
        for name in self.stages if self.name is None or self.stages else [""]:
            if name not in OPTIMIZERS:
                raise InputError(
                    f"optimizer.name is '{name}'; choose one of {', '.join(OPTIMIZERS)}, or a list of them."
                )
        if self.schedule not in SCHEDULES:
            raise InputError(f"optimizer.schedule is '{self.schedule}'; choose one of {', '.join(SCHEDULES)}.")
        if not 0 < self.lr < math.inf:
            raise InputError(f"optimizer.lr is {self.lr}; it must be positive.")
        if self.batch_size < 1:
            raise InputError(f"optimizer.batch_size is {self.batch_size}; it must be at least 1.")
        if not self.weight_decay >= 0:
            raise InputError(f"optimizer.weight_decay is {self.weight_decay}; it must not be negative.")

    @property
    def stages(self) -> list[str]:
        """The optimisers in their order; none where the model's own is to be taken."""
        return [self.name] if isinstance(self.name, str) else list(self.name or [])
