"""Pools that a folder holds already."""

import manufactured
import pytest

from capsbayes.errors import InputError
from capsbayes.evidence.blind.pools import build_pools


def test_a_pool_that_was_made_with_other_settings_is_refused(tmp_path):
    manufactured.database(8, 6).write(tmp_path / "none-0.nc")
    message = r"none-0\.nc: expected the pool of shapes of this name, got one made with other .*cases; remove it"
    with pytest.raises(InputError, match=message):
        build_pools([("none", 0.0)], tmp_path)
