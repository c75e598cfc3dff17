"""The best configurations of a search as files that run again."""

from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from pgdl_lab.core.files import replacing
from pgdl_lab.core.registry import KINDS, PARTS


def write_experiment(run: Path, path: Path, comment: str) -> None:
    """Turn the `config.yaml` of a run into a file for `experiment=`.

    All values are written out, so that the file gives the same run when defaults change.

    Parameters
    ----------
    run
        Folder of the run.
    path
        The file.
    comment
        One line for its head.
    """
    config: Any = OmegaConf.to_container(OmegaConf.load(run / "config.yaml"))
    defaults: list[dict[str, Any]] = [{"override /task": config["task"]}]
    for kind in KINDS:
        if kind == "loss":
            defaults.append({"override /loss": list(config[kind])})
            for loss in config[kind].values():
                loss.pop("name")
            continue
        defaults.append({f"override /{kind}": config[kind].pop("name")})
        for part in (part for part, whole in PARTS.items() if whole == kind):
            defaults.append({f"override /{kind}/{part}": config[kind][part].pop("name")})
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as temporary:
        text = OmegaConf.to_yaml(OmegaConf.create({"defaults": defaults, **config}))
        temporary.write_text(f"# @package _global_\n# {comment}\n{text}", encoding="utf-8")
