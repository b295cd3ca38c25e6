"""Plain data and arrays go to bytes and come back; junk is refused and can do nothing
else.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from gaitsweep.pipeline import serialize

_ARRAYS = hnp.arrays(
    st.sampled_from(["f8", "i1", "i2", "i4", "U3", "b1"]),
    hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4),
)


def test_a_number_is_no_list_of_one():
    found = serialize.load(serialize.dump({"passes": np.array(1)}))
    assert found["passes"].shape == ()


@settings(deadline=None, max_examples=60)
@given(
    st.dictionaries(
        st.text(min_size=1, max_size=5),
        _ARRAYS | st.integers(-9, 9) | st.text(max_size=5),
        max_size=4,
    )
)
def test_what_goes_in_comes_out(tree):
    data = serialize.dump(tree)
    found = serialize.load(data)
    assert found.keys() == tree.keys()
    for key, value in tree.items():
        np.testing.assert_array_equal(found[key], value)
        assert getattr(found[key], "dtype", None) == getattr(value, "dtype", None)
    assert serialize.dump(found) == data


@settings(deadline=None, max_examples=200)
@given(st.binary(max_size=60), st.integers(0, 200), st.integers(0, 4))
def test_junk_is_a_value_error(junk, at, cut):
    good = serialize.dump({"a": np.arange(3.0), "b": "text"})
    for data in (junk, good[:at], good[:at] + junk + good[at + cut :]):
        try:
            serialize.load(data)
        except ValueError:
            continue


def test_objects_are_refused():
    with pytest.raises(TypeError, match="object"):
        serialize.dump({"a": np.array([object()])})
    header = b'{"a":{"":["|O",[1]]}}'
    with pytest.raises(ValueError, match="unknown array"):
        serialize.load(len(header).to_bytes(4, "little") + header + bytes(64))
