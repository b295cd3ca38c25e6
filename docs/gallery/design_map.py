# %% [markdown]
# # A design map: stability over foot radius and foot mass
#
# How steep may the slope be before the long gait of a straight-legged walker loses
# stability, for feet of any radius and mass? The corner of the map, massless point
# feet, is the simplest walker, for which M. Garcia, A. Chatterjee, A. Ruina and M.
# Coleman, *J. Biomech. Eng.* 120 (1998) 281–288, report 0.0151.

# %%
import matplotlib.pyplot as plt
import numpy as np
import xarray as xr

from gaitsweep import gaits

radius = xr.DataArray(np.linspace(0.0, 0.4, 5), dims="R")
mass = xr.DataArray(np.linspace(0.0, 0.02, 3), dims="foot_mass_ratio")
slope = xr.DataArray(np.geomspace(1e-3, 0.1, 1500), dims="slope")

# %% [markdown]
# ## One call
# DataArrays broadcast by dimension name. Each pair of keys is a line, whose branches
# are computed once; each slope then takes microseconds, and later calls are fast.

# %%
design = gaits(
    "E", slope, R=radius, foot_mass_ratio=mass, variables=["multipliers"]
).sel(gait="long")
is_stable = design.spectral_radius < 1
stable_to = design.slope.where(is_stable).max("slope")
print(
    stable_to.transpose("foot_mass_ratio", "R")
    .to_series()
    .unstack("R")
    .round(4)
    .to_string()
)
corner = float(stable_to.isel(R=0, foot_mass_ratio=0))
print(f"simplest walker stable up to slope: printed 0.0151, computed {corner:.4f}")

# %%
figure, axes = plt.subplots(layout="constrained")
drawn = axes.pcolormesh(
    radius, mass, stable_to.transpose("foot_mass_ratio", "R"), shading="nearest"
)
figure.colorbar(drawn, label="largest slope of a stable long gait [rad]")
axes.set(xlabel="foot radius [leg]", ylabel="mass of each foot over the total mass")
figure.savefig("design-map.png")
