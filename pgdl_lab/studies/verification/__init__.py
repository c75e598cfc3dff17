"""Benchmarks of the mechanics with known answers: closed forms, published values, other codes.

Each module registers its benchmarks with the decorator `benchmark.benchmark`; `discover` imports all of them.
"""

import importlib
import pkgutil


def discover() -> None:
    """Import all modules of this package, which registers their benchmarks."""
    for module in pkgutil.iter_modules(__path__):
        importlib.import_module(f"{__name__}.{module.name}")
