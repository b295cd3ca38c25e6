# %% [markdown]
# # The compass gait's period doublings, in degrees
#
# Two legs with a point mass each, and one at the hip (a = b = 0.5 m, m = 5 kg, m_H = 10
# kg). The figure is that of A. Goswami, B. Thuilot and B. Espiau, *Compass-like biped
# robot, part I*, INRIA report 2996 (1996): step period against slope, with the first
# period doubling at 4.37° and the second at 4.9°.

# %%
import matplotlib.pyplot as plt
import numpy as np

from gaitsweep import gaits, load, run

compass = {
    **{"units": "SI", "g": 9.81, "knees": False, "m_h": 10.0, "R": 0.0, "eps_T": 0.0},
    **{"l_t": 0.5, "w_t": 0.0, "m_t": 5.0, "r_t": 0.0, "c_t": 0.5},
    **{"l_s": 0.5, "w_s": 0.0, "m_s": 0.0, "r_s": 0.0, "c_s": 0.0},
}

# %% [markdown]
# ## Gaits of one step
# Arrays in, gaits out. The long gait is stable up to the first doubling, where a
# multiplier passes −1.

# %%
degrees = np.linspace(0.5, 5.2, 400)
one = gaits(compass, np.radians(degrees)).sel(gait="long")
last = degrees[one.spectral_radius < 1].max()
print(f"the gait of one step is stable up to about {last:.2f} degrees")

# %% [markdown]
# ## Doublings, and orbits after a transient
# Studies of kind `cascade` locate the doublings, those of kind `orbit` iterate the step
# map; their archives are tables.

# %%
window = {"from": float(np.radians(3.0)), "to": float(np.radians(5.2)), "n": 120}
doubling = {"periods": 4, "steps": 0}
run(
    {
        "name": "doublings",
        "kind": "cascade",
        "walker": compass,
        "axes": {"slope": window},
        "options": doubling,
    }
)
cascade = load("data/archive/doublings.nc", "cascade")
flips = np.degrees(np.sort(cascade.slope[cascade.kind == "flip"].to_numpy()))

kept = {"starts": 1, "transient": 300, "steps": 48, "shown": 48}
run(
    {
        "name": "orbits",
        "kind": "orbit",
        "walker": compass,
        "axes": {"slope": window},
        "options": kept,
    }
)
orbits = load("data/archive/orbits.nc", "orbits")

# %%
figure, axes = plt.subplots(layout="constrained")
axes.plot(np.degrees(orbits.slope), orbits.period, ",", color="tab:blue")
axes.plot(degrees, one.period, color="tab:grey", linewidth=0.5)
axes.set(xlabel="slope [°]", ylabel="step period [s]", xlim=(3.0, 5.2), ylim=(0.5, 0.9))
figure.savefig("goswami-bifurcation.png")
for number, (printed, computed) in enumerate(
    zip((4.37, 4.9), flips, strict=False), start=1
):
    print(f"doubling {number} [degrees]: printed {printed}, computed {computed:.4f}")
