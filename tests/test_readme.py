"""What the README promises."""

import json
import re
from pathlib import Path

from tests.conftest import Lab

README = (Path(__file__).parent.parent / "README.md").read_text()


def test_plugin_of_the_readme_trains(lab: Lab, tmp_path: Path) -> None:
    (source,) = re.findall(r'```python\n("""Loss `flatness`.*?)```', README, re.DOTALL)
    (tmp_path / "plugins" / "loss").mkdir(parents=True)
    (tmp_path / "plugins" / "loss" / "flatness.py").write_text(source)
    done = lab(
        *("loss=[data,flatness]", "loss.flatness.weight=0.1", "finger.chambers=2", "finger.max_kpa=5"),
        *("fem.edge_mm=6", "fem.element=hex20", "observation.snapshots=4", "observation.points=800"),
        *("split.points=500", "trainer.max_epochs=2", "trainer.progress=false"),
    )
    assert done.returncode == 0, done.stderr
    metrics = json.loads((tmp_path / "runs" / "latest" / "metrics.json").read_text())
    assert metrics["losses"] == ["data", "flatness"]
    surrogate = (tmp_path / "runs" / "latest" / "surrogate.pt").stat()
    assert surrogate.st_size > 0
