"""Tests of the outbox, which holds messages until the page can receive them."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from typing import Any, cast

from bridge.web import outbox as module
from bridge.web.outbox import PageOutbox, PostedActions


class Socket:
    """Blocks until ``proceed`` is set, then records every text."""

    def __init__(self) -> None:
        self.texts: list[str] = []
        self.proceed = asyncio.Event()

    async def send_text(self, text: str) -> None:
        await self.proceed.wait()
        self.texts.append(text)


def sent(prepare: Callable[[PageOutbox], None], *then: Callable[[PageOutbox], None]) -> list[str]:
    """Return the messages that a page receives; each step of ``then`` runs once all previous messages are sent."""

    async def send() -> list[str]:
        box, socket = PageOutbox("somebody"), Socket()
        sender = asyncio.create_task(box.send_to(cast("Any", socket)))
        prepare(box)
        socket.proceed.set()
        for step in (*then, lambda _box: None):
            for _ in range(20):
                await asyncio.sleep(0)
            step(box)
        sender.cancel()
        return socket.texts

    return asyncio.run(send())


def test_all_replies_but_only_the_newest_value_are_sent() -> None:
    def prepare(box: PageOutbox) -> None:
        for number in (1, 2):
            box.changed("map", number, f"map {number}")
            box.held(number, 0, 0)
            box.queue({"id": number})

    held = json.dumps({"op": "held", "x": 2, "y": 0, "turn": 0})
    assert sent(prepare) == ['{"id": 1}', '{"id": 2}', held, "map 2"]


def test_next_value_waits_until_the_page_has_drawn_the_last_one() -> None:
    steps: list[Callable[[PageOutbox], None]] = [
        lambda box: box.changed("map", 2, "two"),
        lambda box: box.drawn("map", 7),
        lambda box: box.changed("other", 1, "another feed"),
        lambda box: box.changed("map", 3, "three"),
        lambda box: box.drawn("map", 1),
        lambda box: (box.unwatched("map"), box.changed("map", 4, "four"))[0],
    ]
    texts = sent(lambda box: box.changed("map", 1, "one"), *steps, lambda _box: None)
    assert texts == ["one", "another feed", "three", "four"]


def test_value_of_a_feed_that_is_no_longer_watched_is_not_sent() -> None:
    assert sent(lambda box: (box.changed("map", 1, "one"), box.discard("map"))[0]) == []


def test_outbox_is_full_if_the_page_reads_no_replies() -> None:
    async def fill() -> list[bool]:
        box, full = PageOutbox("somebody"), list[bool]()
        for number in range(module.MOST_REPLIES + 1):
            full.append(box.full)
            box.queue({"id": number})
        return [*full, box.full]

    full = asyncio.run(fill())
    assert full.index(True) == module.MOST_REPLIES + 1


def test_refusals_after_the_server_has_ended_are_dropped() -> None:
    async def make() -> PageOutbox:
        return PageOutbox("somebody")

    box, socket = asyncio.run(make()), Socket()
    box.refuse("the planner drives")
    box.changed("map", 1, "one")

    async def send() -> None:
        socket.proceed.set()
        sender = asyncio.create_task(box.send_to(cast("Any", socket)))
        for _ in range(20):
            await asyncio.sleep(0)
        sender.cancel()

    asyncio.run(send())
    assert socket.texts == []


def test_too_many_waiting_actions_are_refused_until_some_have_run() -> None:
    waiting: list[Callable[[], Any]] = []
    actions, ran = PostedActions(waiting.append), list[int]()
    for number in range(module.MOST_ACTIONS):
        assert actions.run(lambda number=number: ran.append(number))  # type: ignore[misc]
    assert not actions.run(lambda: ran.append(-1))
    waiting.pop(0)()
    assert actions.run(lambda: ran.append(-2))
    for action in waiting:
        action()
    assert ran == [*range(module.MOST_ACTIONS), -2]


def test_run_latest_runs_only_the_newest_action_and_refuses_none() -> None:
    waiting: list[Callable[[], Any]] = []
    actions, ran = PostedActions(waiting.append), list[int]()
    for number in range(2 * module.MOST_ACTIONS):
        actions.run_latest(lambda number=number: ran.append(number))  # type: ignore[misc]
    assert len(waiting) == 1
    waiting.pop()()
    actions.run_latest(lambda: ran.append(-1))
    waiting.pop()()
    assert ran == [2 * module.MOST_ACTIONS - 1, -1]
