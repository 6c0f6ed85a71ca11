"""From a thread to the loop: order, bounds, cancellation."""

import asyncio
import threading

from drivers.bounded_queue import BoundedQueue


async def test_items_keep_their_order_from_a_thread():
    queue = BoundedQueue()

    def produce():
        for number in range(1, 5001):
            queue.put(number)

    thread = threading.Thread(target=produce)
    thread.start()
    got = []
    async for number in queue.items():
        got.append(number)
        if number == 5000:
            break
    thread.join()
    assert got == list(range(1, 5001))


async def test_what_does_not_fit_is_refused_and_what_must_not_be_lost_is_taken():
    queue = BoundedQueue(limit=2)
    assert [queue.put(number) for number in (1, 2, 3)] == [True, True, False]
    assert queue.put(4, always=True)
    queue.close()
    assert [item async for item in queue.items()] == [1, 2, 4]
    assert not queue.put(5)


async def test_a_cancelled_consumer_loses_nothing_it_was_not_given():
    queue = BoundedQueue()
    for number in (1, 2, 3):
        queue.put(number)
    first = await anext(queue.items())
    waiting = asyncio.create_task(anext(BoundedQueue().items()))
    await asyncio.sleep(0)
    waiting.cancel()
    queue.close()
    assert [first, *[item async for item in queue.items()]] == [1, 2, 3]
