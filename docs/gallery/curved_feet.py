# %% [markdown]
# # Curved feet on the simplest walker
#
# M. Garcia, A. Chatterjee, A. Ruina and M. Coleman, *J. Biomech. Eng.* 120 (1998)
# 281–288: the simplest walker is stable up to a slope of 0.0151. P. Adamczyk, S.
# Collins and A. Kuo, *J. Exp. Biol.* 209 (2006) 3953–3963, equation 7: for short steps,
# the heelstrike loss with feet of radius ρ (in leg lengths) is (1 − ρ)² times that with
# point feet. Here the same walker, D, has round feet of vanishing mass.

# %%
import matplotlib.pyplot as plt
import numpy as np

from gaitsweep import gaits

radius = np.array([0.0, 0.1, 0.2, 0.3, 0.4, 0.5])

# %% [markdown]
# ## The collision
# The energy lost, divided by the squares of the hip's speed and of the angle between
# the legs, relative to point feet, in the limit of short steps.

# %%
short = gaits("D", 1e-6, R=radius).sel(gait="long")
coefficient = short.loss_normal / (short.stance_rate * short.stance_angle) ** 2
ratio = (coefficient / coefficient[0]).to_numpy()
for rho, computed in zip(radius, ratio, strict=True):
    print(
        f"loss at radius {rho:.1f} over that at 0: printed {(1 - rho) ** 2:.4f}, computed {computed:.4f}"
    )

# %% [markdown]
# ## How far the gaits are stable
# One call covers all radii and slopes.

# %%
slope = np.linspace(1e-4, 0.12, 4000)
gait = gaits(
    "D", slope, R=radius[:, None], variables=["multipliers", "stance_angle"]
).sel(gait="long")
stable = gait.spectral_radius.to_numpy() < 1
first = np.where(stable.all(axis=1), slope[-1], slope[stable.argmin(axis=1) - 1])
print(f"stable on point feet up to slope: printed 0.0151, computed {first[0]:.4f}")

figure, axes = plt.subplots(1, 2, figsize=(9, 3.5), layout="constrained")
axes[0].plot(radius, ratio, "o", label="computed")
axes[0].plot(radius, (1 - radius) ** 2, label="(1 − ρ)²")
axes[0].set(xlabel="foot radius ρ [leg]", ylabel="loss over that of point feet")
axes[0].legend()
axes[1].plot(radius, first, "o-")
axes[1].set(xlabel="foot radius ρ [leg]", ylabel="first loss of stability [rad]")
figure.savefig("curved-feet.png")
