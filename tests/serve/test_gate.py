import asyncio
from collections.abc import Awaitable, Callable

import pytest

from zoedepth.serve.gate import Gate
from zoedepth.serve.problems import Problem

Gone = asyncio.Future[None]


def play(game: Callable[[], Awaitable[None]]) -> None:
    """Run a test in an event loop of its own."""
    asyncio.run(game())


def here() -> Gone:
    return asyncio.get_running_loop().create_future()


async def settle() -> None:
    for _ in range(5):
        await asyncio.sleep(0)


def test_places_are_taken_and_handed_on_in_order() -> None:
    async def game() -> None:
        gate, order = Gate(1, 5), []

        async def visit(name: str) -> None:
            assert await gate.enter(seconds=9, gone=here())
            order.append(name)

        await visit("first")
        waiting = [asyncio.ensure_future(visit(name)) for name in ("second", "third")]
        await settle()
        assert (gate.n_inside, gate.n_waiting, order) == (1, 2, ["first"])
        gate.leave()
        await settle()
        assert order == ["first", "second"]
        gate.leave()
        await asyncio.gather(*waiting)
        assert order == ["first", "second", "third"]
        gate.leave()
        assert (gate.n_inside, gate.n_waiting) == (0, 0)

    play(game)


def test_a_full_queue_sends_away() -> None:
    async def game() -> None:
        gate = Gate(1, 1)
        await gate.enter(seconds=9, gone=here())
        waiting = asyncio.ensure_future(gate.enter(seconds=9, gone=here()))
        await settle()
        with pytest.raises(Problem) as caught:
            await gate.enter(seconds=9, gone=here())
        assert caught.value.kind == "busy"
        gate.leave()
        assert await waiting

    play(game)


def test_who_waits_too_long_is_told_and_takes_no_place() -> None:
    async def game() -> None:
        gate = Gate(1, 5)
        await gate.enter(seconds=9, gone=here())
        with pytest.raises(Problem) as caught:
            await gate.enter(seconds=0.001, gone=here())
        assert caught.value.kind == "waited-too-long"
        assert gate.n_waiting == 0
        gate.leave()
        assert gate.n_inside == 0

    play(game)


def test_who_hangs_up_takes_no_place() -> None:
    async def game() -> None:
        gate, gone = Gate(1, 5), here()
        await gate.enter(seconds=9, gone=here())
        waiting = asyncio.ensure_future(gate.enter(seconds=9, gone=gone))
        await settle()
        gone.set_result(None)
        assert not await waiting
        assert gate.n_waiting == 0

    play(game)


def test_who_hangs_up_as_the_turn_comes_gives_the_place_back() -> None:
    async def game() -> None:
        gate, gone = Gate(1, 5), here()
        await gate.enter(seconds=9, gone=here())
        waiting = asyncio.ensure_future(gate.enter(seconds=9, gone=gone))
        await settle()
        gate.leave()
        gone.set_result(None)
        assert not await waiting
        assert gate.n_inside == 0

    play(game)


def test_a_request_that_is_cancelled_as_its_turn_comes_gives_the_place_back() -> None:
    async def game() -> None:
        gate = Gate(1, 5)
        await gate.enter(seconds=9, gone=here())
        waiting = asyncio.ensure_future(gate.enter(seconds=9, gone=here()))
        await settle()
        gate.leave()
        waiting.cancel()
        with pytest.raises(asyncio.CancelledError):
            await waiting
        assert gate.n_inside == 0

    play(game)


def test_a_closed_gate_lets_nobody_in_and_those_inside_finish() -> None:
    async def game() -> None:
        seen: list[tuple[int, int]] = []
        gate = Gate(1, 5, lambda waiting, inside: seen.append((waiting, inside)))
        await gate.enter(seconds=9, gone=here())
        waiting = asyncio.ensure_future(gate.enter(seconds=9, gone=here()))
        await settle()
        gate.close()
        with pytest.raises(Problem) as caught:
            await waiting
        assert caught.value.kind == "shutting-down"
        with pytest.raises(Problem):
            gate.check()
        gate.leave()
        assert seen[-1] == (0, 0)
        assert (1, 1) in seen

    play(game)
