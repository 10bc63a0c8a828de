"""Finished parts come back as they were, or count as absent; nothing in them is run."""

import pickle

import numpy as np
import pytest

from capsbayes.errors import DatabaseError
from capsbayes.run import Store

VALUES = {
    "nodes": np.random.default_rng(1).random((5, 3)),
    "names": np.array(["α", "b"]),
    "single": np.float32([1.0, np.nan]),
    "limit": float("nan"),
    "velocity": 1.2345678901234567,
    "settings": {"law": "neo-Hookean", "walls": {"spacing": 0.08}},
    "message": "",
}


def store(tmp_path, **settings):
    return Store.open(tmp_path / "parts", {"refinement": 8} | settings)


def test_a_part_comes_back_to_the_last_bit(tmp_path):
    store(tmp_path).save("case", VALUES)
    assert store(tmp_path).holds("case")
    assert not store(tmp_path).holds("other")
    again = store(tmp_path).load("case")
    assert again.keys() == VALUES.keys()
    for name, value in VALUES.items():
        if isinstance(value, np.ndarray):
            assert again[name].dtype == value.dtype
            np.testing.assert_array_equal(again[name], value)
        else:
            assert repr(again[name]) == repr(value)
    assert list(store(tmp_path).names("ca*")) == ["case"]
    assert store(tmp_path).load("other") is None


@pytest.mark.parametrize("place", [0, 30, 100, 200, -1])
def test_a_damaged_part_counts_as_absent(tmp_path, place):
    kept = store(tmp_path)
    kept.save("case", VALUES)
    content = bytearray(kept.path("case").read_bytes())
    content[place] ^= 1
    kept.path("case").write_bytes(content)
    if place == 30:  # in the fingerprint of the settings
        with pytest.raises(DatabaseError, match="made with other settings"):
            kept.load("case")
    else:
        assert kept.load("case") is None
        assert not kept.holds("case")


def test_a_part_of_an_earlier_version_is_refused_and_not_run(tmp_path):
    class Harm:
        def __reduce__(self):
            return (tmp_path.joinpath("harm").touch, ())

    kept = store(tmp_path)
    payload = pickle.dumps(Harm())
    for magic in (b"capsbayes part 1 f h", b"capsbayes part 2 f h"):
        kept.path("case").write_bytes(magic + b"\n" + payload)
        if magic.endswith(b"1 f h"):
            with pytest.raises(DatabaseError, match=r"earlier version, whose parts are not read; remove .* to"):
                kept.load("case")
        else:
            assert kept.load("case") is None
    assert not (tmp_path / "harm").exists()


def test_objects_are_not_written_and_other_settings_refused_by_name(tmp_path):
    with pytest.raises(TypeError, match="objects"):
        store(tmp_path).save("case", {"state": np.array([object()])})
    assert not list(store(tmp_path).names())
    store(tmp_path)
    with pytest.raises(DatabaseError, match="refinement 8 there and 12 asked; remove it"):
        store(tmp_path, refinement=12)
    (tmp_path / "parts" / "settings.json").write_text("{")
    with pytest.raises(DatabaseError, match=r"settings\.json is damaged; remove .*parts to start anew"):
        store(tmp_path)
