"""Hydra's door to the lab's searches; Hydra 1.3 looks for sweepers in `hydra_plugins` only."""

from typing import TYPE_CHECKING, Any

from hydra.core.config_search_path import ConfigSearchPath
from hydra.core.config_store import ConfigStore
from hydra.plugins.search_path_plugin import SearchPathPlugin
from hydra.plugins.sweeper import Sweeper
from hydra.types import HydraContext, TaskFunction
from omegaconf import DictConfig, OmegaConf

from pgdl_lab.core.registry import closest
from pgdl_lab.running import sweep
from pgdl_lab.running.folders import BEST
from pgdl_lab.running.hydra_versions import register_resolver
from pgdl_lab.search import calibration
from pgdl_lab.search.settings import SearchSettings

if TYPE_CHECKING:
    from pgdl_lab.search.sweeper import Search


class PgdlOptunaSweeper(Sweeper):
    """Runs a search with Optuna; see `SearchSettings`.

    Parameters
    ----------
    settings
        Fields of `SearchSettings`.
    """

    def __init__(self, **settings: Any) -> None:
        sweep.take_folder()  # a search counts its failures itself
        for name in settings:
            closest(name, SearchSettings.__dataclass_fields__, "hydra.sweeper field")
        self.settings = SearchSettings(**OmegaConf.to_object(OmegaConf.create(settings)))  # type: ignore[arg-type]
        self.search: Search | None = None

    def setup(self, *, hydra_context: HydraContext, task_function: TaskFunction, config: DictConfig) -> None:
        from pgdl_lab.search.sweeper import Search  # loads Optuna

        self.search = Search(self.settings, hydra_context, task_function, config)

    def sweep(self, arguments: list[str]) -> None:
        assert self.search is not None
        self.search.run(arguments)


class BestOfStudies(SearchPathPlugin):
    """Lets `experiment=<study>/best` find what a search left behind."""

    def manipulate_search_path(self, search_path: ConfigSearchPath) -> None:
        if BEST.is_dir():  # Hydra warns of places that do not exist
            search_path.append("pgdl_lab", f"file://{BEST.parent}")


register_resolver("open_dimensions", calibration.dimensions)
register_resolver("paper_extremes", calibration.targets)

_node = OmegaConf.structured(SearchSettings)
OmegaConf.set_readonly(_node, None)
OmegaConf.set_struct(_node, False)
_node["_target_"] = "hydra_plugins.pgdl_optuna.PgdlOptunaSweeper"
_node["_recursive_"] = False  # sampler and pruner are made later: Optuna takes long to load
ConfigStore.instance().store(group="hydra/sweeper", name="pgdl_optuna", node=_node, provider="pgdl_lab")
