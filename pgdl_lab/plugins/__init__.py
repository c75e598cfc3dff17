"""All plugins, wherever they lie: `pgdl_lab.plugins.<kind>.<name>` is a module in one of the folders of `__path__`.

A wheel carries the plugins in this package; a checkout keeps them in `plugins/`. Either way user files are found too,
under module names that worker processes can import.
"""

from pgdl_lab.paths import PLUGINS

__path__ = [*__path__, *(str(folder) for folder in PLUGINS)]
