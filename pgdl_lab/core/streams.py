"""Standard output and error that no run dies of: what they cannot show, or nobody reads any more, is let go."""

import io
import logging
import os
import sys
from typing import TextIO


class Lasting(io.TextIOWrapper):
    """A text stream that goes on into nothing once its reader has left or its disk is full."""

    def write(self, text: str) -> int:
        try:
            return super().write(text)
        except OSError:
            self._let_go()
            return len(text)

    def flush(self) -> None:
        try:
            super().flush()
        except OSError:
            self._let_go()

    def _let_go(self) -> None:
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, self.fileno())
        os.close(nowhere)


def last() -> None:
    """Let standard output and error of this process outlast their readers; letters that they lack become '?'."""
    logging.raiseExceptions = False  # a log that cannot be written is not worth a traceback
    sys.stdout, sys.stderr = _lasting(sys.stdout), _lasting(sys.stderr)


def _lasting(stream: TextIO | None) -> TextIO:
    if stream is None:  # closed from the start
        return open(os.devnull, "w", encoding="utf-8")
    if isinstance(stream, Lasting) or not isinstance(stream, io.TextIOWrapper):
        return stream
    encoding, by_lines, through = stream.encoding, stream.line_buffering, stream.write_through
    return Lasting(stream.detach(), encoding, "replace", line_buffering=by_lines, write_through=through)
