"""How many CPU threads a simulation works with."""

import os


def threads() -> int:
    """As many as OMP_NUM_THREADS says, else one for each core that this process may use."""
    told = os.environ.get("OMP_NUM_THREADS", "").split(",")[0].strip()
    if told.isdecimal() and int(told) > 0:
        return int(told)
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
