"""A cache keeps the values used last within a number of bytes."""

from threading import Thread

from tactile_loc.core.runtime.caches import ByteCache


def test_the_value_used_least_recently_is_dropped_first():
    cache, made = ByteCache(6, len), []

    def use(key: str) -> bytearray:
        return cache.get(key, lambda: made.append(key) or bytearray(3 * key.encode()))

    for key in "ababac":
        assert use(key) == bytearray(3 * key.encode())
        assert cache.nbytes == 3 * min(2, len(set(made)))
    assert made == ["a", "b", "c"]
    use("a")
    use("b")
    assert made == ["a", "b", "c", "b"]
    assert (len(cache), cache.nbytes) == (2, 6)


def test_a_value_that_has_grown_displaces_others():
    cache = ByteCache(6, len)
    first = cache.get("a", lambda: bytearray(b"a"))
    cache.get("b", lambda: bytearray(b"b"))
    for grown, count in ((b"aaaa", 2), (b"a", 1)):
        first.extend(grown)
        cache.keep("a", first)
        assert (len(cache), cache.nbytes) == (count, 6)


def test_the_value_in_use_stays_even_if_it_is_too_large():
    cache = ByteCache(2, len)
    for value, left in ((b"a", 1), (b"bbbb", 4), (b"c", 1)):
        cache.get(str(value), lambda value=value: bytearray(value))
        assert (cache.nbytes, len(cache)) == (left, 1)


def test_the_sum_stays_right_with_several_threads():
    cache = ByteCache(50, len)

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
