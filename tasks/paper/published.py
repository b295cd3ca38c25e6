"""Half units of the printed parameters (figure 3's caption and figure 9).

Half a unit of the last printed digit, but at most 0.005 for lengths printed as 0.2, 0.35, 0.46 and 0.17. B, D, E and F
are exact by definition, and so are the offsets of A and C, which follow from their other keys. The same numbers, with
their sources, are in data/reference/published.toml.
"""

_COMMON = {
    "l_t": 0.005,
    "m_t": 0.0005,
    "c_t": 0.0005,
    "l_s": 0.005,
    "m_s": 0.0005,
    "c_s": 0.005,
    "R": 0.005,
    "eps_T": 0.0005,
}
_PHYSICAL = {**_COMMON, "w_t": 0.0005, "w_s": 0.0005, "r_t": 0.0005, "r_s": 0.0005, "g": 0.005}
_TUNED = {**_COMMON, "r_t": 0.00005, "r_s": 0.00005}

#: Half unit of every rounded key, in the key's unit, by walker.
HALF_UNITS: dict[str, dict[str, float]] = {
    "physical": _PHYSICAL,
    "physical-straight": _PHYSICAL,
    "A": _TUNED,
    "C": _TUNED,
    "A-printed": {**_TUNED, "w_t": 0.0005, "w_s": 0.0005},
    "C-printed": {**_TUNED, "w_t": 0.0005, "w_s": 0.0005},
}
