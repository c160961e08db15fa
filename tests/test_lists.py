"""Lists of items per lane, on every engine, against plain Python."""

import numpy as np
import pytest

from sdfbake.engine.protocol import Lists

# Lanes and the lengths of their lists; the last are cut into pieces where an engine has too few lanes to be busy.
LENGTHS = {
    "one lane, one item": [1],
    "short lists": [1, 2, 3, 1, 7, 5] * 50,
    "one long list": [5000],
    "few lanes, uneven": [3000, 1, 17, 2000, 8, 9],
    "more pairs than a tile": [40_000, 3, 40_000],
}


def made(xp, lengths, rng, items=1000):
    """Ascending lists, stored in another order than their lanes and with gaps, as narrowed lists are."""
    plain = [np.sort(rng.integers(0, items, n)) for n in lengths]
    start, flat = np.zeros(len(plain), int), []
    for lane in rng.permutation(len(plain)):
        start[lane] = sum(map(len, flat)) + 3
        flat += [np.full(3, items + 99), plain[lane]]
    table = xp.table(np.concatenate(flat))
    return plain, Lists(xp.table(start), xp.table(np.array(lengths)), table)


def unpacked(lists):
    start, count, items = (np.array(array) for array in lists)
    return [items[s : s + n].tolist() for s, n in zip(start, count, strict=True)]


def first_of_least(items, values, tie):
    """The first item within a tie of the least."""
    least = min(values)
    return next(item for item, value in zip(items, values, strict=True) if value <= least + tie(least))


@pytest.mark.parametrize("lengths", LENGTHS.values(), ids=LENGTHS)
def test_first_least(lengths, choice, rng):
    xp = choice.engine
    plain, lists = made(xp, lengths, rng)
    # Whole numbers below 2^20: exact in every precision, with many ties.
    key = rng.integers(0, 60, 1000)
    table, lane = xp.table(key), xp.table(np.arange(len(lengths)))

    def measure(of):
        def measures(item):
            value = xp.real(xp.gather(table, item, True))
            return value, xp.abs(value - xp.real(of & 31))

        return measures

    found = [np.array(array).tolist() for array in xp.first_least(lists, [lane], measure, lambda least: least * 0.0)]
    for n, items in enumerate(plain):
        assert found[0][n] == first_of_least(items, key[items], lambda least: 0)
        assert found[1][n] == first_of_least(items, np.abs(key[items] - (n & 31)), lambda least: 0)


@pytest.mark.parametrize("lengths", LENGTHS.values(), ids=LENGTHS)
def test_values_within_a_tie_are_the_same(lengths, choice, rng):
    """Levels a thousand ties apart, each blurred by less than a tie: the first of the lowest level is found."""
    xp = choice.engine
    plain, lists = made(xp, lengths, rng)
    level = rng.integers(1, 40, 1000)
    values = level + rng.integers(0, 4, 1000) * 2.0**-12  # at most 3/4 of a tie, and exact in single precision
    table = xp.table(values)
    tie = xp.uniform(2.0**-10)
    (found,) = xp.first_least(lists, [], lambda: lambda item: (xp.gather(table, item, True),), lambda least: tie)
    for items, item in zip(plain, np.array(found).tolist(), strict=True):
        assert item == next(i for i in items if level[i] == level[items].min())


@pytest.mark.parametrize("count", [5, 400, 5000])
def test_many_small_steps_do_not_lead_away(choice, count):
    """Every item is less than the one before by 3/4 of a tie: the last two are equally small, no other is."""
    xp = choice.engine
    values = 10.0 - np.arange(count) * 0.75 * 2.0**-10
    table, tie = xp.table(values), xp.uniform(2.0**-10)
    lists = Lists(xp.table(np.zeros(1, int)), xp.table(np.array([count])), xp.table(np.arange(count)))
    (found,) = xp.first_least(lists, [], lambda: lambda item: (xp.gather(table, item, True),), lambda least: tie)
    assert np.array(found).tolist() in ([count - 2], [count - 1])


@pytest.mark.parametrize("lengths", LENGTHS.values(), ids=LENGTHS)
def test_narrowed(lengths, choice, rng):
    xp = choice.engine
    plain, lists = made(xp, lengths, rng)
    bound = rng.integers(0, 1000, len(lengths))
    lane = xp.table(bound)
    narrow = xp.narrowed(lists, [lane], lambda most: lambda item: ((item <= most) & ((item & 3) != 1),))
    expected = [items[(items <= most) & (items % 4 != 1)].tolist() for items, most in zip(plain, bound, strict=True)]
    assert unpacked(narrow) == expected


@pytest.mark.parametrize("lengths", LENGTHS.values(), ids=LENGTHS)
def test_every_lane_may_have_several_lists(lengths, choice, rng):
    """They follow each other lane by lane, some are empty, and those that are not are lists again."""
    xp = choice.engine
    plain, lists = made(xp, lengths, rng)
    bound = xp.table(rng.integers(0, 1000, len(lengths)))
    ways = xp.narrowed(lists, [bound], lambda most: lambda item: tuple(((item + most) & 3) == k for k in range(3)))
    expected = [
        items[(items + most) % 4 == k].tolist()
        for items, most in zip(plain, np.array(bound), strict=True)
        for k in range(3)
    ]
    assert unpacked(ways) == expected
    full = np.flatnonzero([len(items) for items in expected])
    some = xp.table(full)
    again = Lists(xp.gather(ways.start, some, True), xp.gather(ways.count, some, True), ways.items)
    narrow = xp.narrowed(again, [some], lambda n: lambda item: (item >= 0, (item & 1) == (n & 1)))
    assert unpacked(narrow)[::2] == [expected[n] for n in full]
    assert unpacked(narrow)[1::2] == [[item for item in expected[n] if item % 2 == n % 2] for n in full]


def test_interleaved(choice):
    xp = choice.engine
    mixed = xp.interleaved([xp.table(np.arange(5) + 10 * k) for k in range(3)])
    assert np.array(mixed).tolist() == [10 * k + n for n in range(5) for k in range(3)]


@pytest.mark.parametrize("fill", [-1, 2.5])
def test_scattered(choice, rng, fill):
    xp = choice.engine
    place, active = rng.permutation(500)[:300], rng.integers(0, 2, 300)
    value = rng.integers(0, 1000, 300)
    given = xp.table(value if fill == -1 else value / 4)  # quarters are exact in either precision
    whole = np.array(xp.scattered(500, fill, xp.table(place), given, xp.table(active) == 1))
    expected = np.full(500, fill, float)
    expected[place[active == 1]] = value[active == 1] / (1 if fill == -1 else 4)
    np.testing.assert_array_equal(whole, expected)
    assert whole.dtype == (np.int32 if fill == -1 else np.float32 if xp.precision == 32 else np.float64)


@pytest.mark.parametrize("share", [0, 0.3, 1])
def test_kept(choice, rng, share):
    xp = choice.engine
    mask = rng.uniform(size=1000) < share
    kept = xp.kept(xp.table(mask.astype(int)) == 1)
    assert len(kept) == mask.sum()
    np.testing.assert_array_equal(np.array(kept), np.flatnonzero(mask))


def test_rows(choice, rng):
    xp = choice.engine
    values = rng.integers(0, 1 << 20, (50, 4)) / 16  # exact in either precision
    index = rng.integers(0, 50, 300)
    rows = xp.rows(xp.table(values), xp.table(index), True)
    np.testing.assert_array_equal(np.stack([np.array(column) for column in rows], axis=-1), values[index])


def test_other_precisions_share_integers(choice):
    xp = choice.engine
    lanes = xp.lanes(4)
    np.testing.assert_array_equal(
        np.array(xp.at(64).real(lanes) + xp.at(64).uniform(2.0**-40)), np.arange(4) + 2.0**-40
    )
    np.testing.assert_array_equal(np.array(xp.at(32).real(lanes) + xp.at(32).uniform(2.0**-40)), [2.0**-40, 1, 2, 3])
