"""Archives that lead to other files, or take far more to read than they hold, are
refused before anything is read.
"""

import re
import shutil
import subprocess
import sys

import h5py
import netCDF4
import numpy as np
import pytest

from conftest import GAITSWEEP, Toy
from gaitsweep import figure, load, report
from gaitsweep.pipeline.archive import diff, objects, read, verify
from gaitsweep.pipeline.errors import ArchiveError

SECRET = "root:x:0:0:a word that nobody else may read"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    toy = Toy(tmp_path_factory.mktemp("archive"))
    toy.write()
    toy("run", "toy.toml")
    return toy.folder / "data" / "archive" / "toy.nc"


@pytest.fixture
def copy(made, tmp_path):
    """An archive, and beside it what it could lead to: a text, and another archive."""
    (tmp_path / "secret").write_text(SECRET)
    shutil.copy(made, tmp_path / "other.nc")
    shutil.copy(made, tmp_path / "copy.nc")
    return tmp_path / "copy.nc"


def replaced(file, name, shape, dtype, **options):
    """A variable created anew in another way, with the attributes that it had."""
    about = dict(file[name].attrs) if name in file else {}
    if name in file:
        del file[name]
    variable = file.create_dataset(name, shape, dtype, **options)
    for key, value in about.items():
        if key not in ("DIMENSION_LIST", "REFERENCE_LIST"):
            variable.attrs[key] = value
    return variable


def external(file, name, folder):
    kept = str(folder / "secret")
    replaced(file, name, (len(SECRET),), "S1", external=[(kept, 0, h5py.h5f.UNLIMITED)])


def external_and_absent(file, folder):
    replaced(file, "period", (10,), "f8", external=[("/nowhere/else", 0, 80)])


def linked_elsewhere(file, name):
    if name in file:
        del file[name]
    file[name] = h5py.ExternalLink("other.nc", name)


def virtual(file, source, folder):
    layout = h5py.VirtualLayout((200,), "f8")
    layout[:] = h5py.VirtualSource(source, "slope", (200,))
    del file["w_t"]
    file.create_virtual_dataset("w_t", layout)


def virtual_of_files_by_a_pattern(file, folder):
    made, space = (
        h5py.h5p.create(h5py.h5p.DATASET_CREATE),
        h5py.h5s.create_simple((100,), (h5py.h5s.UNLIMITED,)),
    )
    space.select_hyperslab((0,), (h5py.h5s.UNLIMITED,), (100,), (100,))
    made.set_virtual(
        space, str(folder / "%b.nc").encode(), b"slope", h5py.h5s.create_simple((100,))
    )
    h5py.h5d.create(file.id, b"more", h5py.h5t.NATIVE_DOUBLE, space, made)


def soft(file, name, target):
    file[name] = h5py.SoftLink(target)


def committed(file, folder):
    file["kind"] = np.dtype("f8")


def committed_of_an_attribute(file, folder):
    file["fits/kind"] = np.dtype("f8")
    kind = file["fits/kind"]
    file["slope"].attrs.create("range", 1.0, dtype=kind)
    del file["fits/kind"]


def committed_and_used(file, folder):
    file["fits/kind"] = np.dtype("f8")
    replaced(file, "period", (3,), file["fits/kind"])[...] = 1.0
    del file["fits/kind"]


def variable_of(kind):
    def attack(file, folder):
        replaced(file, "fits/scaling/more", (3,), kind)

    return attack


def attribute_of(kind):
    def attack(file, folder):
        file["status"].attrs.create("more", np.zeros(2, kind), dtype=kind)

    return attack


def packed(file, folder):
    file.create_dataset("more", (30,), "i4", scaleoffset=8)


def packed_by_a_library_to_be_loaded(file, folder):
    made = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    made.set_chunk((30,))
    made.set_filter(32015, h5py.h5z.FLAG_OPTIONAL, (3,))
    space = h5py.h5s.create_simple((30,))
    h5py.h5d.create(
        file["fits/scaling"].id, b"more", h5py.h5t.NATIVE_DOUBLE, space, made
    )


def its_own_parent(file, folder):
    file["fits/scaling/again"] = file["fits"]


def its_own_grandparent(file, folder):
    file["fits/scaling/again"] = file["/"]


def itself(file, folder):
    file["fits/again"] = file["fits"]


def two_names(file, folder):
    file["more"] = file["stance_angle"]


def groups_of_groups(file, folder):
    """Not a circle: 2^20 ways through 20 groups."""
    group = file.create_group("more")
    for _ in range(20):
        below = group.create_group("a")
        group["b"] = below
        group = below


def deep(file, folder):
    file.create_group("a/" * 500)


def many_groups(file, folder):
    for k in range(5000):
        file.create_group(f"more/{k}")


def many_attributes(file, folder):
    group = file.create_group("more", track_order=True)
    for k in range(1500):
        group.attrs[f"a{k}"] = k


def texts_repeated(file, folder):
    """Every text of an attribute, of hundreds, is the same in the file."""
    kind = h5py.h5t.C_S1.copy()
    kind.set_size(h5py.h5t.VARIABLE)
    made = h5py.h5a.create(file["fits"].id, b"zz", kind, h5py.h5s.create_simple((400,)))
    made.write(np.array([b"x"] * 400, h5py.string_dtype()))


def huge_chunk(file, folder):
    file.create_dataset("more", (2**24,), "f8", chunks=(2**24,), compression="gzip")


def dimensions_of_another_number(file, folder):
    kept = file["status"].attrs["DIMENSION_LIST"]
    kind = h5py.vlen_dtype(h5py.ref_dtype)
    more = np.empty(50, object)
    more[:] = [np.array(kept[0], h5py.ref_dtype)] * 50
    file["status"].attrs.create("DIMENSION_LIST", more, dtype=kind)


ATTACKS = {
    "external storage": (
        lambda file, folder: external(file, "reason_text", folder),
        "/reason_text",
        "another file",
    ),
    "external storage in a group": (
        lambda file, folder: external(file, "fits/scaling/quantity", folder),
        "/fits/scaling/quantity",
        "another file",
    ),
    "external storage that is absent": (external_and_absent, "/period", "another file"),
    "external link to a group": (
        lambda file, _: linked_elsewhere(file, "fits"),
        "/fits",
        "link to another file",
    ),
    "external link to a variable": (
        lambda file, _: linked_elsewhere(file, "slope"),
        "/slope",
        "link to another file",
    ),
    "external link in a group": (
        lambda file, _: linked_elsewhere(file, "fits/scaling/exponent"),
        "/fits/scaling/exponent",
        "link to another file",
    ),
    "virtual": (
        lambda file, folder: virtual(file, str(folder / "other.nc"), folder),
        "/w_t",
        "other variables",
    ),
    "virtual of itself": (
        lambda file, folder: virtual(file, ".", folder),
        "/w_t",
        "other variables",
    ),
    "virtual of files by a pattern": (
        virtual_of_files_by_a_pattern,
        "/more",
        "other variables",
    ),
    "soft link to itself": (
        lambda file, _: soft(file, "more", "/more"),
        "/more",
        "is a link",
    ),
    "soft link to nothing": (
        lambda file, _: soft(file, "fits/more", "/nothing"),
        "/fits/more",
        "is a link",
    ),
    "soft link to a group": (
        lambda file, _: soft(file, "fits/scaling/more", "/"),
        "/fits/scaling/more",
        "is a link",
    ),
    "committed type": (committed, "/kind", "type of its own"),
    "attribute of a committed type": (
        committed_of_an_attribute,
        "/slope",
        "has a type",
    ),
    "variable of a committed type": (committed_and_used, "/period", "has a type"),
    "compound": (
        variable_of(np.dtype([("a", "f8"), ("b", "i4")])),
        "/fits/scaling/more",
        "has a type",
    ),
    "opaque": (variable_of(np.dtype("V16")), "/fits/scaling/more", "has a type"),
    "enumeration": (
        variable_of(h5py.enum_dtype({"a": 1})),
        "/fits/scaling/more",
        "has a type",
    ),
    "references": (variable_of(h5py.ref_dtype), "/fits/scaling/more", "has a type"),
    "lists": (variable_of(h5py.vlen_dtype("f8")), "/fits/scaling/more", "has a type"),
    "text of varying length": (
        variable_of(h5py.string_dtype()),
        "/fits/scaling/more",
        "has a type",
    ),
    "attribute of an enumeration": (
        attribute_of(h5py.enum_dtype({"a": 0})),
        "/status",
        "has a type",
    ),
    "attribute of a compound": (
        attribute_of(np.dtype([("a", "f8")])),
        "/status",
        "has a type",
    ),
    "filter": (packed, "/more", "by a filter"),
    "filter of another library": (
        packed_by_a_library_to_be_loaded,
        "/fits/scaling/more",
        "by a filter",
    ),
    "hard link to the parent": (its_own_parent, "/fits/scaling/again", "second name"),
    "hard link to the root": (
        its_own_grandparent,
        "/fits/scaling/again",
        "second name",
    ),
    "hard link to itself": (itself, "/fits/again", "second name"),
    "variable of two names": (two_names, "/more", "second name"),
    "groups of two names": (groups_of_groups, "/more/a", "in more than|second name"),
    "deep groups": (deep, "/a/a/a", "in more than"),
    "many groups": (many_groups, "/more", "more objects"),
    "many attributes": (many_attributes, "/more", "more than 1,024 attributes"),
    "texts repeated": (texts_repeated, "/fits", "more than 16 texts"),
    "huge chunk": (huge_chunk, "/more", "chunks larger"),
    "dimensions of another number": (
        dimensions_of_another_number,
        "/status",
        "another number of dimensions",
    ),
}


@pytest.mark.parametrize("name", ATTACKS)
def test_what_no_archive_holds_is_refused_before_it_is_read(copy, name):
    attack, place, said = ATTACKS[name]
    with h5py.File(copy, "a") as file:
        attack(file, copy.parent)

    with pytest.raises(ArchiveError) as raised, read.open_archive(copy):
        pass

    sentence = str(raised.value)
    assert (
        sentence.startswith(f"{copy} ")
        and f"`{place}" in sentence
        and re.search(said, sentence)
    )
    assert "\n" not in sentence and len(sentence) < 400


def huge(file):
    file.createDimension("n", 2**40)
    file.createVariable("more", "f8", ("n",))


def huge_in_chunks(file):
    file.createDimension("n", 2**20)
    file["fits/scaling"].createVariable(
        "more", "i1", ("n", "n"), zlib=True, chunksizes=(128, 128)
    )


def huge_because_its_dimension_grew(file):
    """Of the second variable nothing is stored: the library fills it as far as the
    first goes.
    """
    file.createDimension("n", None)
    file.createVariable("more", "f8", ("n",), chunksizes=(1024,))[2**40] = 1.0
    file.createVariable("filled", "f8", ("n",), chunksizes=(1024,))


@pytest.mark.parametrize(
    "attack", [huge, huge_in_chunks, huge_because_its_dimension_grew]
)
def test_what_is_declared_larger_than_its_file_can_hold_is_refused(copy, attack):
    with netCDF4.Dataset(copy, "a") as file:
        attack(file)

    with pytest.raises(
        ArchiveError, match=rf"^{copy} .*`[a-z/]*more` is larger than"
    ) as raised:
        load(copy)

    assert "\n" not in str(raised.value)


def test_no_more_objects_are_met_than_an_archive_holds(made):
    assert objects.fault(made) == ""


def resumed(path, folder):
    """A run that publishes its archive from time to time first asks whether a whole one
    is there.
    """
    if read.not_attempted(path) is None:
        raise ArchiveError(
            f"{path} is not an archive of gaitsweep: `/fits` is a link to another file."
        )


ENTRIES = {
    "load": lambda path, folder: load(path),
    "table": lambda path, folder: load(path, "fits/scaling"),
    "figure": lambda path, folder: figure(path, "loglog"),
    "report": lambda path, folder: report(path, folder / "reports"),
    "verify": lambda path, folder: verify.verify(path),
    "diff": lambda path, folder: diff.diff(folder / "other.nc", path),
    "resumed": resumed,
}


@pytest.mark.parametrize("entry", ENTRIES)
def test_no_function_follows_a_link_to_another_file(copy, entry):
    with h5py.File(copy, "a") as file:
        linked_elsewhere(file, "fits")

    with pytest.raises(ArchiveError, match="`/fits` is a link to another file"):
        ENTRIES[entry](copy, copy.parent)

    assert not (copy.parent / "reports").exists()


@pytest.mark.parametrize(
    ("name", "words", "code"),
    [
        ("external storage", ["report", "copy.nc", "-o", "reports"], 2),
        ("external storage", ["diff", "other.nc", "copy.nc"], 2),
        ("hard link to the root", ["report", "copy.nc", "-o", "reports"], 2),
        ("hard link to the root", ["verify", "copy.nc"], 1),
        ("hard link to the root", ["prove", "copy.nc", "--sample", "1"], 2),
    ],
)
def test_commands_say_in_a_line_what_is_wrong_within_little_time_and_memory(
    copy, name, words, code
):
    attack, place, _ = ATTACKS[name]
    with h5py.File(copy, "a") as file:
        attack(file, copy.parent)
    program = (
        "import resource, subprocess, sys; ended = subprocess.run(sys.argv[1:], stdout=1, stderr=2);"
        "used = resource.getrusage(resource.RUSAGE_CHILDREN);"
        "print(ended.returncode, used.ru_utime + used.ru_stime, used.ru_maxrss)"
    )

    done = subprocess.run(
        [sys.executable, "-c", program, *GAITSWEEP, *words],
        cwd=copy.parent,
        capture_output=True,
        text=True,
        check=True,
    )

    *said, numbers = f"{done.stderr}{done.stdout}".splitlines()
    assert (
        len(said) == 1
        and f"copy.nc is not an archive of gaitsweep: `{place}" in said[0]
    )
    assert SECRET not in said[0] and not (copy.parent / "reports").exists()
    ended, seconds, kibibytes = map(float, numbers.split())
    assert ended == code and seconds < 6 and kibibytes < 300 << 10
