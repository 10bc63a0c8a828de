"""Pools that a folder holds already."""

import manufactured
import pytest

from capsbayes.errors import InputError
from evidence.exam.sessions import POOLS, blocks_of, build_pools, pool_cases, read_pool


def test_a_pool_that_was_made_with_other_settings_is_refused(tmp_path):
    manufactured.database(8, 6).write(tmp_path / "none-0.nc")
    message = r"none-0\.nc: expected the pool of shapes of this name, got one made with other .*cases; remove it"
    with pytest.raises(InputError, match=message):
        build_pools([("none", 0.0)], tmp_path, "development")


def test_further_files_of_a_pool_are_at_places_of_their_own_and_read_with_it(tmp_path):
    lattice, further = {*pool_cases()}, {*pool_cases(1)}
    assert len(further) == len(lattice)
    assert not lattice & further
    assert not further & {*pool_cases(2)}
    for cases in (lattice, further):
        assert all(0.0315 <= ca <= 0.107 and 0.79 <= size <= 0.963 for ca, size in cases)
    one, other = manufactured.database(8, 6), manufactured.database(7, 5)
    one.write(tmp_path / "none-0.nc")
    assert read_pool(tmp_path, "none", 0.0, "development").sha256 == one.sha256
    other.write(tmp_path / "none-0-block-1.nc")
    both = read_pool(tmp_path, "none", 0.0, "development")
    assert len(both) == len(one) + len(other)
    assert both["size_ratio"].tolist() == [*one["size_ratio"], *other["size_ratio"]]
    assert both.sha256 != one.sha256


def test_the_halves_have_no_place_in_common():
    for pool in POOLS:
        blocks = (blocks_of(*pool, half) for half in ("locked", "development"))
        locked, development = ({case for block in of_half for case in pool_cases(block)} for of_half in blocks)
        assert len(locked) == len(development)
        assert not locked & development
