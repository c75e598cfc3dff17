"""What the lab warns of, kept for the result that it is about."""

import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager

WARNINGS = "warnings"
"""Where the provenance of a result keeps them: a list of sentences."""
ASIDE = {"aside": True}
"""To be given as `extra` with a warning that is not about a result, but about what is written or told beside it."""


@contextmanager
def heard() -> Iterator[list[str]]:
    """The warnings that this thread logs meanwhile, each of them once."""
    handler = _Keeper()
    logger = logging.getLogger("pgdl_lab")
    logger.addHandler(handler)
    try:
        yield handler.sentences
    finally:
        logger.removeHandler(handler)


class _Keeper(logging.Handler):
    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.sentences: list[str] = []
        self._thread = threading.get_ident()

    def emit(self, record: logging.LogRecord) -> None:
        sentence = record.getMessage()
        own = record.thread == self._thread and not hasattr(record, "aside")
        if own and sentence not in self.sentences:
            self.sentences.append(sentence)
