"""All plugins, wherever they lie: `pgdl_lab.plugins.<kind>.<name>` is a module in one of the folders of `__path__`.

A wheel carries the plugins in this package; a checkout keeps them in `plugins/`. The user's own, often in the working
directory, are among them only after `pgdl_lab.core.registry.discover`, as importing a kind already runs code there; the
processes that are started afterwards find them too, under the same names, by an environment variable.
"""

import os
from pathlib import Path

from pgdl_lab.core.paths import OWN_PLUGINS, SHIPPED_PLUGINS

_DISCOVERED = "PGDL_LAB_DISCOVERED"

if Path(__file__).resolve().parent != SHIPPED_PLUGINS:
    __path__ = [*__path__, str(SHIPPED_PLUGINS)]


def discover_own() -> None:
    """Add the user's own plugins."""
    if str(OWN_PLUGINS) not in __path__:
        __path__.append(str(OWN_PLUGINS))
    os.environ[_DISCOVERED] = str(OWN_PLUGINS)


if os.environ.get(_DISCOVERED) == str(OWN_PLUGINS):
    discover_own()
