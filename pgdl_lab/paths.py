"""Where things lie: the root that everything is written under, the configuration and the plugin folders."""

import os
from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent
_CHECKOUT = _PACKAGE.parent if (_PACKAGE.parent / "pyproject.toml").is_file() else None

ROOT = Path(os.environ.get("PGDL_LAB_ROOT") or _CHECKOUT or Path.cwd()).resolve()
"""The checkout's root, or the working directory of an installed package; PGDL_LAB_ROOT moves it elsewhere."""

RUNS = ROOT / "runs"
"""Everything that a run writes."""

BEST = RUNS / "best"
"""YAML files that searches leave behind; apart from runs, whose folders would show up among the choices."""

CONF = (_CHECKOUT or _PACKAGE) / "conf"
"""The YAML files: beside the package in a checkout, inside it when installed from a wheel."""

PLUGINS = [folder for folder in dict.fromkeys([_CHECKOUT and _CHECKOUT / "plugins", ROOT / "plugins"]) if folder]
"""Folders of plugins outside the package: the checkout's and the user's own."""
