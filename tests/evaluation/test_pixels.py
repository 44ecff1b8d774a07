"""Maps with unknown pixels at the size of a picture."""

import numpy as np

from zoedepth.evaluation.pixels import spread_values


def test_values_are_repeated_or_dropped_never_mixed() -> None:
    x = np.arange(12.0).reshape(3, 4)
    assert spread_values(x, (6, 8)).tolist() == np.repeat(np.repeat(x, 2, axis=0), 2, axis=1).tolist()
    assert spread_values(x, (3, 2)).tolist() == x[:, ::2].tolist()


def test_points_of_sparse_truth_grow_and_do_not_wrap_around() -> None:
    x = np.full((20, 20), np.nan)
    x[0, 10], x[10, 0] = 3.0, 5.0
    found = spread_values(x, (20, 20))
    assert found[2, 10] == found[0, 12] == 3.0
    assert found[10, 2] == found[8, 0] == 5.0
    assert np.isnan(found[19, 10])
    assert np.isnan(found[10, 19])
    assert set(np.unique(found[np.isfinite(found)])) == {3.0, 5.0}
    dense = np.where(np.arange(20) < 10, x, 1.0)
    assert np.isnan(spread_values(dense, (20, 20))[5, 5])  # what is dense has real holes
