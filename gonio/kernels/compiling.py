"""A line about code that is being compiled, as soon as that has taken more than a second.

numba reports the start and the end of every compilation. Code from the cache on disk is not
compiled, so that nothing is said of it. The command line sets `gonio.progress.on_compiling`; in
Python nothing is written.
"""

from __future__ import annotations

import re
import threading
import time
from collections.abc import Callable
from typing import Any

from gonio import progress

DELAY_S = 1.0  # of compiling before anything is said


class Clock:
    """Time spent compiling; the sentence is said once, when that exceeds the delay.

    Examples
    --------
    >>> said = []
    >>> clock = Clock(said.append, delay_s=0.0)
    >>> clock.start("gonio_cache_gonio_models_ward_0123456789abcdef")
    >>> clock.end()
    >>> said
    ['compiling ward, which takes a while the first time ...']
    """

    def __init__(self, say: Callable[[str], None], delay_s: float = DELAY_S) -> None:
        self._say, self._left_s = say, delay_s
        self._lock = threading.Lock()
        self._depth, self._since, self._said = 0, 0.0, False
        self._timer: threading.Timer | None = None

    def start(self, module: str) -> None:
        """A compilation begins; those inside of another one count with it."""
        with self._lock:
            self._depth += 1
            if self._depth > 1 or self._said:
                return
            self._since = time.monotonic()
            if self._left_s <= 0:
                self._speak(module)
                return
            self._timer = threading.Timer(self._left_s, self._on_time, [module])
            self._timer.daemon = True
            self._timer.start()

    def end(self) -> None:
        """The compilation that began last has ended."""
        with self._lock:
            self._depth -= 1
            if self._depth == 0 and self._timer is not None:
                self._timer.cancel()
                self._timer = None
                self._left_s -= time.monotonic() - self._since

    def _on_time(self, module: str) -> None:
        with self._lock:
            if not self._said and self._timer is not None:
                self._speak(module)

    def _speak(self, module: str) -> None:
        self._said = True
        self._say(f"compiling {_short(module)}, which takes a while the first time ...")


def watch() -> None:
    """Follow the compilations of numba, if somebody wants to hear of them."""
    if progress.on_compiling is None or _listeners:
        return
    from numba.core import event  # heavy

    clock = Clock(_say)

    class Listener(event.Listener):  # type: ignore[misc]
        def on_start(self, event: Any) -> None:
            clock.start(str(event.data["dispatcher"].py_func.__module__))

        def on_end(self, event: Any) -> None:
            clock.end()

    _listeners.append(Listener())
    event.register("numba:compile", _listeners[0])


_listeners: list[Any] = []


def _say(text: str) -> None:
    if progress.on_compiling is not None:
        progress.on_compiling(text)


def _short(module: str) -> str:
    """The model's name of a module, written by gonio or not.

    Examples
    --------
    >>> _short("gonio_cache_gonio_models_ward_gmd_0123456789abcdef"), _short("gonio.models.ward")
    ('ward_gmd', 'ward')
    """
    written = re.fullmatch(r"gonio_cache_(?:gonio_models_)?(.+)_[0-9a-f]{16}", module)
    return written[1] if written else module.rpartition(".")[2]
