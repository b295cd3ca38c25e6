"""A walker's keys as they are meant: decimals exact, derived keys by their formulas in
balls; or doubles, exactly.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from decimal import Context, Decimal, Inexact, localcontext
from fractions import Fraction
from typing import Any

from flint import arb, ctx, fmpq

from gaitsweep.tasks.proofs.body import Number
from gaitsweep.tasks.walkers.catalogue import CATALOGUE, PARTNERS
from gaitsweep.tasks.walkers.resolve import resolve, split, straight
from gaitsweep.tasks.walkers.statics import TUNED_TO
from gaitsweep.tasks.walkers.walker import NUMBERS, WalkerError

#: Bits of derived keys: more than any proof's.
KEY_BITS = 1024
Numbers = dict[str, Number]
#: Characters of a number that is read exactly, of a zero's exponent, and digits of a
#: decimal number that is quoted.
MAX_CHARACTERS, MAX_EXPONENT, MAX_DIGITS = 1000, 5, 10000
#: Keys that are no numbers.
_TEXTS = ("toward", "base", "name", "units", "trailing_knee")
#: Keys a table may leave out.
_DEFAULT: Numbers = {"m_h": fmpq(0), "g": fmpq(1)}


def check_written(numbers: Mapping[str, Any]) -> None:
    """Check that numbers can be read exactly: powers of ten are written out, and a
    double that is zero may hide one.

    Parameters
    ----------
    numbers : mapping
        Walker keys and what they are; only texts are checked.

    Raises
    ------
    WalkerError
        If one has too many digits, or lies below all doubles but is not zero.
    """
    for key, text in numbers.items():
        if isinstance(text, Mapping):  # the walker that another leads to
            check_written(text)
        if not isinstance(text, str) or key in _TEXTS:
            continue
        if len(text) > MAX_CHARACTERS:
            raise WalkerError(
                key, text, f"must have at most {MAX_CHARACTERS} characters"
            )

        mantissa, _, exponent = text.strip().lower().partition("e")
        if float(text) == 0 and (
            mantissa.strip("+-0._") or len(exponent) > MAX_EXPONENT
        ):
            raise WalkerError(key, text, "must be 0 or a number that doubles resolve")


def in_doubles(numbers: Mapping[str, Any]) -> dict[str, Any]:
    """Walker keys whose numbers may be written as strings, in doubles.

    Parameters
    ----------
    numbers : mapping

    Returns
    -------
    dict
    """
    values = dict(numbers)
    for key, value in numbers.items():
        if isinstance(value, Mapping):
            values[key] = in_doubles(value)
        elif isinstance(value, str) and key not in _TEXTS:
            values[key] = float(value)
    return values


def decimal(value: Any) -> fmpq:
    """The decimal number that is written: 0.1 is a tenth.

    Parameters
    ----------
    value : str, int, Fraction or float
        A float means the shortest decimal that is read as it.

    Returns
    -------
    fmpq
    """
    if not isinstance(value, str | int | Fraction):
        value = repr(float(value))
    return _rational(Fraction(value))


def double(value: Any) -> fmpq:
    """A double, exactly.

    Parameters
    ----------
    value : float

    Returns
    -------
    fmpq
    """
    return _rational(Fraction(float(value)))


def _rational(value: Fraction) -> fmpq:
    return fmpq(value.numerator, value.denominator)


def exact(
    walker: str | Mapping[str, Any], overrides: Mapping[str, Any] | None = None
) -> tuple[Numbers, bool]:
    """Numeric keys of a walker by what is written, and whether its knees bend.

    Parameters
    ----------
    walker : str or mapping
        A catalogue name, or a `[walker]` table, whose numbers may be strings.
    overrides : mapping, optional
        Keys to change, `foot_mass_ratio` and `detuning` among them.

    Returns
    -------
    dict of str to fmpq or arb, bool
    """
    overrides = dict(overrides or {})
    table = {"base": walker} if isinstance(walker, str) else dict(walker)
    if "tuned" in table:
        # The walker tuned in doubles; the offsets that tune it best stand for those
        # that do.
        tuned_walker = resolve(in_doubles(table), in_doubles(overrides))
        return doubles(tuned_walker.table())

    table, overrides = split(table, overrides)
    base = table.pop("base", None)
    toward = table.pop("toward", None)
    for key in ("detuning", "foot_mass_ratio"):
        if key in table:
            overrides.setdefault(key, table.pop(key))

    if base is not None:
        keys, kneed = _named(base)
    else:
        keys, kneed = _DEFAULT, False
        table = _with_both_links(table)

    keys, kneed = _changed(keys, kneed, table)

    moved: Numbers = {}
    if "detuning" in overrides:
        amount = decimal(overrides.pop("detuning"))
        moved |= _detuned(keys, base, toward, amount)

    if "foot_mass_ratio" in overrides:
        moved |= _foot_masses(keys, decimal(overrides.pop("foot_mass_ratio")))
    return _changed({**keys, **moved}, kneed, overrides)


def trailing_knee(
    walker: str | Mapping[str, Any], overrides: Mapping[str, Any] | None = None
) -> str:
    """Rule of a walker, as `exact` takes it, for the knee of the leg that leaves the
    ground.

    Parameters
    ----------
    walker : str or mapping
    overrides : mapping, optional

    Returns
    -------
    str
        "free" or "locked".
    """
    table = walker if isinstance(walker, str) else in_doubles(walker)
    return resolve(table, in_doubles(overrides or {})).trailing_knee


def _with_both_links(table: dict[str, Any]) -> dict[str, Any]:
    """A table whose leg of one link, if it has one, is two in line."""
    if table.get("knees") is not False:
        return table
    lengths: dict[str, Any] = {}
    for key in ("l", "R", "c"):
        if key in table:
            lengths[key] = Fraction(str(table[key]))
    return straight({"R": 0, **table, **lengths})


def _detuned(keys: Numbers, base: Any, toward: Any, amount: fmpq) -> Numbers:
    """Keys that detuning changes: from a walker's towards another's, or where that is
    not given from those of the catalogue's walker towards its partner's.
    """
    if toward:
        physical, _ = exact(toward)
        return _mixed(keys, physical, amount)
    tuned, _ = _named(str(base))
    physical, _ = _named(PARTNERS[str(base)])
    return _mixed(tuned, physical, amount)


def doubles(table: Mapping[str, Any]) -> tuple[Numbers, bool]:
    """Numeric keys of a whole table as the doubles they are, and whether its knees
    bend.

    Parameters
    ----------
    table : mapping
        Every walker key.

    Returns
    -------
    dict of str to fmpq or arb, bool

    Notes
    -----
    Offsets that tune the leg or the shank as exactly as doubles can are balls of the offsets that do: at small slopes
    the rounding of a tuned walker's offsets would be seen, and the tuned walker is the
    one meant and solved.
    """
    keys, kneed = _changed({}, False, table, double)
    with ctx.workprec(KEY_BITS):
        for key, offset, size in _tuning(keys, kneed):
            apart = abs(arb(keys[key]) - offset)
            if apart != 0 and apart <= TUNED_TO * size:
                keys[key] = offset
    return keys, kneed


def _tuning(keys: Numbers, kneed: bool) -> Iterator[tuple[str, arb, arb]]:
    """Offsets that put the centres of mass of shank (with knees) and leg exactly on
    their lines, one by one.

    Each with the change of it that would move its centre of mass across the line by the
    distance from the pivot; with knees the leg's is that of thigh and of the shank as a
    point at the knee.
    """
    k = {name: arb(value) for name, value in keys.items()}
    sine_T = k["eps_T"].sin()
    cosine_T = k["eps_T"].cos()
    sine = arb(0)
    # A straight leg may end at its foot's centre: then the shank has no length to lean
    # with.
    if keys["eps_T"] != 0:
        below_knee = k["l_s"] - k["R"]
        sine = k["l_t"] * sine_T / below_knee
    cosine = (1 - sine * sine).sqrt()

    along = k["c_s"] * cosine + k["w_s"] * sine
    if kneed:
        offset = k["c_s"] * sine / cosine
        yield "w_s", offset, abs(along) / cosine

    # Of the shank, forward of the hip-foot-centre line through the hip, and down along
    # it.
    forward = -k["l_t"] * sine_T
    down = k["l_t"] * cosine_T
    if not kneed:
        # `w_s` may have been replaced by the exact offset since.
        forward += k["c_s"] * sine - arb(keys["w_s"]) * cosine
        down += along

    if keys["m_t"] != 0:
        yield "w_t", *_tuning_of_thigh(k, sine_T, cosine_T, forward, down)


def _tuning_of_thigh(
    k: dict[str, arb], sine: arb, cosine: arb, forward: arb, down: arb
) -> tuple[arb, arb]:
    """The offset of the thigh that puts the leg's centre of mass on its line, and the
    change of it that moves that centre by its distance from the hip; the shank is a
    point `forward` of the line and `down` along it.
    """
    shank = k["m_s"] / k["m_t"]
    height = k["c_t"] * cosine - k["w_t"] * sine + shank * down
    offset = (shank * forward - k["c_t"] * sine) / cosine
    return offset, abs(height) / cosine


def _named(name: str) -> tuple[Numbers, bool]:
    is_tuned = name in PARTNERS  # exactly, not as printed
    keys, kneed = _changed(
        {}, False, CATALOGUE[f"{name}-printed" if is_tuned else name].table()
    )
    return (_tuned(keys) if is_tuned else keys), kneed


def _changed(
    keys: Numbers,
    kneed: bool,
    table: Mapping[str, Any],
    read: Callable[[Any], fmpq] = decimal,
) -> tuple[Numbers, bool]:
    keys = dict(keys)
    table = {k: v for k, v in table.items() if k in NUMBERS or k == "knees"}
    kneed = bool(table.pop("knees", kneed))
    for key, value in table.items():
        if key == "m_t" and math.isinf(float(value)):
            # The paper's spelling of D: an infinitely heavy hip.
            keys |= {"m_t": fmpq(1, 2), "m_s": fmpq(0)}
        elif key != "m_s" or not math.isinf(float(table.get("m_t", 0))):
            keys[key] = read(value)

    return keys, kneed


def _tuned(keys: Numbers) -> Numbers:
    """Keys with the offsets that meet both conditions of section 5.1; straight legs
    have those of the kneed walker.
    """
    with ctx.workprec(KEY_BITS):
        return {**keys, **{key: offset for key, offset, _ in _tuning(keys, True)}}


def _mixed(tuned: Numbers, physical: Numbers, amount: fmpq) -> Numbers:
    """Keys in which the tuned walker (0) and the physical one (1) differ, mixed
    linearly; all others may be changed.
    """
    with ctx.workprec(KEY_BITS):
        return {
            name: value + (physical[name] - value) * amount
            for name, value in tuned.items()
            if not bool(value == physical[name])
        }


def _foot_masses(keys: Numbers, ratio: fmpq) -> Numbers:
    """Masses of a point-foot walker whose feet each have a share of the whole; the hip
    carries the rest.
    """
    total = 2 * (keys["m_t"] + keys["m_s"]) + keys["m_h"]
    if keys["m_t"] == 0 and any(
        keys[name] != 0 for name in ("c_t", "w_t", "r_t")
    ):  # of a thigh without mass
        return {"m_s": ratio * total, "m_t": fmpq(0), "m_h": (1 - 2 * ratio) * total}
    return {"m_s": ratio * total, "m_t": (fmpq(1, 2) - ratio) * total, "m_h": fmpq(0)}


def written(value: Number) -> str:
    """A number as a certificate quotes it: all its digits, or a ball of forty.

    Parameters
    ----------
    value : fmpq or arb

    Returns
    -------
    str
    """
    if isinstance(value, arb):
        with ctx.workprec(KEY_BITS):
            return str(value.str(40, radius=True))

    with localcontext(Context(prec=MAX_DIGITS, traps=[Inexact])):
        try:
            return f"{Decimal(int(value.p)) / Decimal(int(value.q)):f}"
        except Inexact:
            return f"{value.p}/{value.q}"


def written_table(
    keys: Mapping[str, Number], kneed: bool, trailing_knee: str = "free"
) -> dict[str, str]:
    """A walker's table as a certificate quotes it.

    Parameters
    ----------
    keys : mapping of str to fmpq or arb
    kneed : bool
    trailing_knee : str
        Quoted where it is not the paper's rule.

    Returns
    -------
    dict of str to str
    """
    table = {key: written(value) for key, value in keys.items()}
    table["knees"] = str(kneed).lower()
    if trailing_knee != "free":
        table["trailing_knee"] = trailing_knee
    return table
