"""Any bytes as a measurement file: a clean error or a valid table, soon, never a traceback."""

import math

from hypothesis import example, given
from hypothesis import strategies as st

from study.ground.errors import InputError
from study.ground.tabular import NUMBER, parse_csv
from study.mechanics.measurement.measurement_section import Range
from study.mechanics.measurement.reading import read_measurements
from tests.record.samples import Spec

cell = st.one_of(
    st.floats(width=32).map(repr),
    st.integers(-9, 9).map(str),
    st.text(max_size=6),
    st.sampled_from(["", "nan", "1_0", "1,5", '"', '"a"', "\u0661", "1e400", "-", ".", "+.5"]),
)
separator = st.sampled_from([",", ";", "\t", "|", " "])
newline = st.sampled_from(["\n", "\r\n", "\r"])


@st.composite
def files(draw):
    sep, end = draw(separator), draw(newline)
    rows = draw(st.lists(st.lists(cell, min_size=1, max_size=4), max_size=8))
    header = draw(st.sampled_from(["d,f", "d;f", "d\tf", "\ufeffd,f", '"d","f"', "f,d,x", ""]))
    return end.join([header, *(sep.join(row) for row in rows)]).encode()


broken_gzip = st.binary(max_size=60).map(lambda tail: b"\x1f\x8b" + tail)


@given(data=st.one_of(files(), st.binary(max_size=400), broken_gzip))
@example(b"d,f\n" + b'"' * 50)
@example(b"d,f\n0,0\n1,1e308\n2,-1e308\n4,1e308\n")
@example(b"d,f\n0,1e-320\n1,2e-320\n4,3e-320\n")
@example(b"d,f\n-1e308,1\n1e308,2\n1,3\n")
def test_any_bytes_as_measurements(tmp_path_factory, data):
    folder = tmp_path_factory.getbasetemp() / "fuzz"
    folder.mkdir(exist_ok=True)
    (folder / "a.csv").write_bytes(data)
    for spec in (
        Spec(),
        Spec(zero="fit", toe=0.1),
        Spec(decimal=",", sign="negative"),
        Spec(range=Range("mm", 0.5, 1.0), zero="first"),
    ):
        try:
            found = read_measurements(spec, folder)
        except InputError:
            continue
        force = found.curve().curve.force_N
        assert force.shape == (5,)
        assert all(math.isfinite(f) for f in force)


@given(st.text(max_size=12))
def test_the_grammar_of_numbers_is_a_part_of_pythons(text):
    if NUMBER.fullmatch(text):
        float(text)  # never raises
        assert text.isascii()
        assert "_" not in text


@given(st.lists(st.tuples(*[st.floats(-1e6, 1e6)] * 2), min_size=1, max_size=20))
def test_finite_numbers_come_back_exactly(rows):
    text = "d,f\n" + "".join(f"{a!r},{b!r}\n" for a, b in rows)
    found = parse_csv(text, required=("d", "f"))
    assert list(zip(found.numbers("d").tolist(), found.numbers("f").tolist(), strict=True)) == rows
