"""A multirun as a whole: its folder, and which of its jobs failed."""

from pathlib import Path
from typing import Any

from hydra.experimental.callback import Callback
from omegaconf import DictConfig

FAILURE = "error.txt"
"""File in the folder of a job that failed: one sentence."""
OVERRIDES = "overrides.json"
"""File in the folder of every job of a multirun: what was typed for it."""

_started: list[Path] = []


class SweepStart(Callback):
    """Hydra callback that notes the folder of the multirun in the process that started it."""

    def on_multirun_start(self, config: DictConfig, **kwargs: Any) -> None:
        _started.append(Path(config.hydra.sweep.dir))


def take_folder() -> Path | None:
    """Folder of the multirun that this process started, once; None without one."""
    return _started.pop() if _started else None


def failures(folder: Path) -> dict[str, str]:
    """Name of each failed job of a multirun and what went wrong, whichever process it ran in."""
    files = sorted(folder.glob(f"*/{FAILURE}"), key=lambda file: (len(file.parent.name), file.parent.name))
    return {file.parent.name: file.read_text(encoding="utf-8") for file in files}
