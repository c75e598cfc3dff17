"""Task `export`: a trained surrogate as plain NumPy arrays, as a torch.export program and as an ONNX file."""

import json
import logging

from rich.console import Console
from rich.table import Table

from pgdl_lab.core.files import replacing
from pgdl_lab.export.export import Form, export
from pgdl_lab.running.folders import stored_surrogate
from pgdl_lab.running.tracking import add_artifacts
from pgdl_lab.tasks import Job

_log = logging.getLogger(__name__)


def run(job: Job) -> None:
    """Write `export/surrogate.npz`, `.pt2` and `.onnx` beside the surrogate, each compared with it.

    Raises
    ------
    LabError
        When there is no surrogate in the run's folder, or a form does not give its numbers.
    """
    folder = job.folder / "export"
    table = Table(title="Forms of the surrogate")
    for heading in ("form", "file", "size (kB)", "largest difference (mm)", "tolerance (mm)"):
        table.add_column(heading, justify="left" if heading in ("form", "file") else "right")
    rows = []
    surrogate = stored_surrogate(job.folder)
    for sentence in surrogate.warnings:
        _log.warning("%s", sentence)
    for form in export(surrogate, folder):
        if not isinstance(form, Form):
            _log.warning("Left out: %s", form)
            continue
        size = form.path.stat().st_size
        table.add_row(
            form.name, form.path.name, f"{size / 1e3:.0f}", f"{form.difference_mm:.2g}", f"{form.tolerance_mm:g}"
        )
        rows.append({"form": form.name, "file": form.path.name, "bytes": size, "difference_mm": form.difference_mm,
                     "tolerance_mm": form.tolerance_mm})  # fmt: skip
    with replacing(folder / "export.json") as temporary:
        temporary.write_text(json.dumps(rows, indent=1), encoding="utf-8")
    Console().print(table)
    add_artifacts(job.folder, [folder])
    _log.info("Everything is in %s", folder)
