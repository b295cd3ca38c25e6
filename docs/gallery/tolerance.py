# %% [markdown]
# # What a millimetre does: the tolerance of a walker of your own
#
# A walker is a table; this one is that of M. Garcia, A. Chatterjee and A. Ruina,
# *Dynamics and Stability of Systems* 15 (2000) 75–99, figure 3, with its knees locked.
# They report that it walks at slopes down to 0.016 (section 5.1). How does this slope
# depend on the lengths of the legs as built?

# %%
import matplotlib.pyplot as plt
import numpy as np

from gaitsweep import gaits

mine = {
    **{"units": "SI", "g": 9.81, "knees": False, "R": 0.2, "eps_T": 0.097},
    **{"l_t": 0.35, "w_t": 0.0, "m_t": 2.345, "r_t": 0.099, "c_t": 0.091},
    **{"l_s": 0.46, "w_s": 0.025, "m_s": 1.013, "r_s": 0.197, "c_s": 0.17},
}
slope = np.linspace(0.008, 0.03, 2201)


def smallest_slope(**keys):
    """Smallest slope with a gait, for each value of the keys."""
    answer = gaits(
        mine,
        slope,
        **{key: np.asarray(value)[:, None] for key, value in keys.items()},
        variables=["period"],
    )
    walks = (answer.status == 0).any("gait").to_numpy()
    return slope[walks.argmax(axis=-1)]


# %%
at_rest = float(smallest_slope(m_h=[0.0])[0])
print(f"smallest slope: printed 0.016, computed {at_rest:.4f}")

# %% [markdown]
# ## One millimetre more, one less
# Each length is varied in turn; a call takes its two values as an array.

# %%
millimetre = 1e-3
effect = {}
for key in ("w_t", "w_s", "c_t", "c_s", "r_t", "r_s", "R"):
    less, more = smallest_slope(**{key: mine[key] + millimetre * np.array([-1.0, 1.0])})
    effect[key] = (less - at_rest, more - at_rest)
    print(
        f"{key}: {effect[key][0]:+.4f} for a millimetre less, {effect[key][1]:+.4f} for one more"
    )

# %% [markdown]
# The printed lengths are rounded, `w_t` and `w_s` to half a millimetre: the printed
# slope lies within the resulting uncertainty.

# %%
figure, axes = plt.subplots(layout="constrained")
for side, (label, sign) in enumerate((("1 mm less", -1), ("1 mm more", 1))):
    axes.barh(
        np.arange(len(effect)) + 0.2 * sign,
        [pair[side] for pair in effect.values()],
        0.4,
        label=label,
    )
axes.set_yticks(range(len(effect)), effect)
axes.set_xlabel("change of the smallest slope [rad]")
axes.legend()
figure.savefig("tolerance.png")
