"""Where things lie: the root that everything is written under, the configuration and the plugin folders."""

import os
from pathlib import Path

_PACKAGE = Path(__file__).resolve().parents[1]
_CHECKOUT = _PACKAGE.parent if (_PACKAGE.parent / "pyproject.toml").is_file() else None

ROOT = Path(os.environ.get("PGDL_LAB_ROOT") or _CHECKOUT or Path.cwd()).resolve()
"""The checkout's root, or the working directory of an installed package; PGDL_LAB_ROOT moves it elsewhere."""

RUNS = ROOT / "runs"
"""Everything that a run writes."""

BEST = RUNS / "best"
"""YAML files that searches leave behind; apart from runs, whose folders would show up among the choices."""

CONF = (_CHECKOUT or _PACKAGE) / "conf"
"""The YAML files: beside the package in a checkout, inside it when installed from a wheel."""

SHIPPED_PLUGINS = (_CHECKOUT or _PACKAGE) / "plugins"
"""The plugins that come with the lab: beside the package in a checkout, inside it when installed from a wheel."""

OWN_PLUGINS = ROOT / "plugins"
"""The user's own plugins. The command line imports them; loading a surrogate never does."""

PLUGINS = list(dict.fromkeys([SHIPPED_PLUGINS, OWN_PLUGINS]))
"""Folders of plugins."""
