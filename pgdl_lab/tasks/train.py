"""Task `train`: simulate, train a surrogate, assess it, track all of it."""

from pgdl_lab import pipeline
from pgdl_lab.tasks import Job
from pgdl_lab.tracking import tracked_run


def run(job: Job) -> float:
    """Run the experiment; a search minimises what is returned, the mean squared error over points to select by [mm²].

    Where the training points leave none, it is that over the test points.
    """
    pipeline.check(job.experiment)
    with tracked_run(job.folder, job.sweep_folder) as tracked:
        metrics = pipeline.run(job.experiment, job.folder, tracked)
    mse = metrics["selection_mm2"] or metrics["mse_mm2"]
    return float(mse["x"] + mse["z"])
