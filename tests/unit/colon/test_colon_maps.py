"""Maps of a tube by their names."""

import numpy as np
import pytest

from dynpf.colon import ROUTE
from dynpf.colon.maps import tube_map
from dynpf.colon.outline import Family

PATH = ROUTE.poses()


def free(name: str, seed: int = 4) -> np.ndarray:
    return tube_map(Family.FOLDS, seed, name, PATH).free


def test_bulges_stand_out_of_the_plain_tube_where_their_names_say() -> None:
    plain, b, half, c, other = (free(name) for name in ("a", "b", "b 0.5", "c", "other 3"))
    added = [int(np.sum(one & ~plain)) for one in (b, half, c, other)]
    assert all(np.all(one[plain]) for one in (b, half, c, other))
    assert added[1] == pytest.approx(0.5 * added[0], rel=0.1)
    assert min(added) > 1000
    assert np.sum((b & ~plain) & (c & ~plain)) < 0.2 * added[0]
    np.testing.assert_array_equal(other, free("other 3"))
    assert not np.array_equal(other, free("other 4"))


def test_a_round_end_has_its_radius() -> None:
    small, large = free("end 105"), free("end 135")
    reach = [np.flatnonzero(one[400]).max() for one in (small, large)]
    np.testing.assert_allclose(reach, (820 + 105, 820 + 135), atol=1.5)


@pytest.mark.parametrize(
    "name", ["d", "", "b x", "end", "end wide", "other 1.5", "c 0.5", "a ", "b -1", "end 1e9", "end nan"]
)
def test_a_name_that_means_nothing_is_told(name: str) -> None:
    with pytest.raises(ValueError, match="expected one of a, b, c, 'b SHARE', 'other NUMBER', 'end RADIUS'"):
        free(name)
