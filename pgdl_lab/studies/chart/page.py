"""The chart as one self-contained HTML page: hover for figures, any number of queries, no library."""

import html
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from pgdl_lab.core.files import replacing
from pgdl_lab.studies.chart.point import TIE_ERROR, TIE_TIME, Point
from pgdl_lab.studies.chart.reference import Errors

TEMPLATE = Path(__file__).with_name("page.html")


def write_page(points: Sequence[Point], uncertainty: Errors, title: str, queries: int, path: Path) -> None:
    """Write the page; see `figure.draw` for the parameters."""
    content = {
        "points": [asdict(point) for point in points],
        "uncertainty": asdict(uncertainty),
        "queries": queries,
        "ties": {"time": TIE_TIME, "error": TIE_ERROR},
    }
    data = json.dumps(content).replace("<", "\\u003c")  # nothing in it can end the script
    text = TEMPLATE.read_text(encoding="utf-8").replace("TITLE", html.escape(title)).replace('"DATA"', data)
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
