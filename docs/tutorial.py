# %% [markdown]
# # From one gait to a sweep of your own walker
#
# Open this file as a notebook (VS Code, or Jupyter with jupytext), or run it: `python
# docs/tutorial.py`. It takes a few seconds and writes an archive and a picture into the
# current folder.

# %%
import matplotlib.pyplot as plt
import numpy as np

from gaitsweep import gaits, load, run, simulate, solve, step_map

# %% [markdown]
# ## One point
# The simplest walker on a slope of 0.009 rad. Both gaits are found without initial
# guesses; the long one is stable.

# %%
table = solve("D", 0.009)
print(table[["gait", "stance_angle", "period", "stable"]])

# %% [markdown]
# ## Your own walker
# A walker is a table. This one is E of the catalogue, whose point feet have a tenth of
# the mass each, but with round feet. The name of a walker file works as well.

# %%
round_feet = {"base": "E", "R": 0.3}
print(solve(round_feet, 0.009)[["gait", "stance_angle", "period", "stable"]])

# %% [markdown]
# ## Arrays in, gaits out
# Slopes and keys may be arrays; the result has their dimensions, then `gait`. Nothing
# is written, and lines already computed are fast.

# %%
curves = gaits(round_feet, np.geomspace(1e-3, 0.05, 200), m_h=[[0.0], [0.5]])
stable_to = curves.slope.where(curves.spectral_radius.sel(gait="long") < 1).max("slope")
print(
    "stable up to", stable_to.values.round(4), "rad without and with a mass at the hip"
)

# %% [markdown]
# ## Modes, and a push
# At a gait the step map's eigenvalues are the multipliers, the factors by which a
# disturbance along an eigenvector grows or decays in a step. A push changes the rates
# at the start of a step.

# %%
slope, hip = 0.009, {"m_h": 0.5}
gait = gaits(round_feet, slope, **hip).sel(gait="long")
state = [gait.stance_angle, gait.stance_rate, gait.thigh_rate]
print(step_map(round_feet, slope, state, **hip).eigenvalues.round(4))
for push in (0.005, 0.05):
    walk = simulate(round_feet, slope, state, 40, pushes={2: (push, 0.0)}, **hip)
    print(push, walk.reason.item())

# %% [markdown]
# ## A sweep
# A study states what is wanted; nothing else is computed. Its points are stored: if the
# cell is run again, nothing is computed; if values are added to an axis, only those are
# computed.

# %%
sweep = run(
    {
        "name": "round-feet",
        "walker": round_feet,
        "axes": {"R": [0.0, 0.3], "slope": np.geomspace(1e-6, 0.1, 80)},
        "want": {
            "variables": ["stance_angle", "period", "multipliers"],
            "fits": ["scaling"],
            "figures": ["loglog"],
        },
    }
)
print(sweep.stance_angle.sel(R=0.3, gait="long"))

# %% [markdown]
# `sweep` is an xarray Dataset with units; `status` is the outcome at each grid point,
# in words.

# %%
print(sweep.status.to_series().value_counts())

# %% [markdown]
# ## Power laws
# Fits and other tables are loaded by name; `sweep.attrs["tables"]` lists the names.

# %%
laws = load("data/archive/round-feet.nc", "fits/scaling")
angle = laws[(laws.quantity == "stance_angle") & (laws.n > 0)]
print(angle[["R", "gait", "regime", "exponent", "exponent_low", "exponent_high"]])

# %% [markdown]
# ## A picture
# Stance angle against slope; thick lines are stable.

# %%
figure, axes = plt.subplots(figsize=(5, 3.6), layout="constrained")
for gait, colour in {"long": "#1f6fb2", "short": "#c04a08"}.items():
    for radius, style in zip(sweep.R.values, ["-", "--"], strict=True):
        line = sweep.sel(gait=gait, R=radius)
        axes.loglog(
            line.slope,
            line.stance_angle,
            style,
            color=colour,
            lw=1,
            label=f"{gait}, R = {radius:g}",
        )
        axes.loglog(
            line.slope,
            line.stance_angle.where(line.spectral_radius < 1),
            style,
            color=colour,
            lw=3,
        )
axes.set(xlabel="slope (rad)", ylabel="stance angle (rad)")
axes.legend(fontsize=8)
figure.savefig("round-feet.png", dpi=150)

# %% [markdown]
# ## Pages
# `gaitsweep report data/archive/round-feet.nc` makes pages from the same archive. The
# study requests `loglog`, so the page shows the same figure, with the values and the
# command for every point.
