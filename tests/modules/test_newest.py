"""A stream of which only the newest matters."""

from __future__ import annotations

import threading

from bridge.modules.loop import Loop
from bridge.modules.newest import Newest


def test_while_the_thread_is_busy_the_newest_alone_waits() -> None:
    loop, go_on = Loop("the module"), threading.Event()
    loop.start()
    taken: list[int] = []
    newest = Newest(loop, taken.append)
    loop.post(lambda: go_on.wait(40))
    for number in range(5):
        newest.put(number)
    go_on.set()
    loop.call(lambda: None)
    assert taken == [4]
    newest.put(5)
    loop.call(lambda: None)
    assert taken == [4, 5]
    loop.close()
