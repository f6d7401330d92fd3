"""Progress that nobody is told of."""

from lightstage.products.progress import silent


def test_items_pass_one_by_one() -> None:
    seen = []
    items = (seen.append(i) or i for i in range(3))
    passed = iter(silent(items, 3, "pictures"))
    assert seen == []
    assert next(passed) == 0
    assert seen == [0]
    assert list(passed) == [1, 2]
