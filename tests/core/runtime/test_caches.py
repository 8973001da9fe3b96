"""A cache keeps the values used last within a number of bytes, and releases the others."""

from __future__ import annotations

from threading import Thread

from tactile_loc.core.runtime.caches import ByteCache


def make_cache(most_bytes: int) -> tuple[ByteCache[str, bytearray], list[bytes]]:
    released: list[bytes] = []
    return ByteCache(most_bytes, len, lambda value: released.append(bytes(value))), released


def test_the_value_used_least_recently_is_dropped_first():
    cache, released = make_cache(6)
    for key in "abab":
        cache.get(key, lambda key=key: bytearray(3 * key.encode()))
    assert (len(cache), cache.nbytes, released) == (2, 6, [])
    cache.get("a", bytearray)
    cache.get("c", lambda: bytearray(b"ccc"))
    assert released == [b"bbb"]
    made = []
    assert cache.get("b", lambda: made.append("b") or bytearray(b"new")) == b"new"
    assert made == ["b"]
    assert released == [b"bbb", b"aaa"]
    assert cache.nbytes == 6


def test_a_value_that_has_grown_displaces_others():
    cache, released = make_cache(6)
    first = cache.get("a", lambda: bytearray(b"a"))
    cache.get("b", lambda: bytearray(b"b"))
    first.extend(b"aaaa")
    cache.keep("a", first)
    assert (released, cache.nbytes) == ([], 6)
    first.extend(b"a")
    cache.keep("a", first)
    assert (released, cache.nbytes) == ([b"b"], 6)


def test_the_value_in_use_stays_even_if_it_is_too_large():
    cache, released = make_cache(2)
    cache.get("a", lambda: bytearray(b"a"))
    cache.get("b", lambda: bytearray(b"bbbb"))
    assert (released, cache.nbytes, len(cache)) == ([b"a"], 4, 1)
    cache.get("c", lambda: bytearray(b"c"))
    assert (released, cache.nbytes) == ([b"a", b"bbbb"], 1)


def test_the_sum_stays_right_with_several_threads():
    cache, _ = make_cache(50)

    def use(start: int) -> None:
        for number in range(2000):
            size = (start + number) % 13 + 1
            assert len(cache.get(str(size), lambda size=size: bytearray(size))) == size

    threads = [Thread(target=use, args=(start,)) for start in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert cache.nbytes == sum(len(value) for value, _ in cache._kept.values()) <= 50
