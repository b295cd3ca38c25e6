# %% [markdown]
# # McGeer's modes of a walker with knees
#
# T. McGeer, *Passive walking with knees*, IEEE Conference on Robotics and Automation
# (1990), prints the parameters of a kneed walker (figure 2) and the eigenvalues of its
# step-to-step modes (table 1): −0.001, 0.073 and a pair of magnitude 0.447 and phase
# ±0.947 rad. Lengths are in units of the leg, masses in units of the whole walker's
# mass, 68 % of which is at the hip.

# %%
import matplotlib.pyplot as plt
import numpy as np
from scipy.optimize import brentq

from gaitsweep import gaits, step_map


def bend(eps_t):
    """Angle between thigh and shank of the extended leg, McGeer's ε_K."""
    return eps_t + np.arcsin(0.46 * np.sin(eps_t) / (0.54 - 0.20))


def walker(eps_k):
    """The walker of figure 2; ε_K is printed as 0.2, to one digit."""
    return {
        **{
            "knees": True,
            "R": 0.20,
            "m_h": 0.676,
            "eps_T": brentq(lambda e: bend(e) - eps_k, 0.0, 0.3),
        },
        **{"l_t": 0.46, "m_t": 0.100, "c_t": 0.20, "w_t": 0.00, "r_t": 0.135},
        **{"l_s": 0.54, "m_s": 0.062, "c_s": 0.24, "w_s": 0.01, "r_s": 0.186},
    }


def modes(eps_k, slope=0.0456):
    """The step map at the long gait."""
    gait = gaits(walker(eps_k), slope).sel(gait="long")
    return step_map(
        walker(eps_k), slope, [gait.stance_angle, gait.stance_rate, gait.thigh_rate]
    )


# %% [markdown]
# ## Eigenvalues
# The smallest is exactly zero, because four rates just after a heelstrike follow from
# three numbers. The uncertainty due to the printed digits of ε_K is shown for the
# others.

# %%
here = modes(0.2)
low, high = modes(0.2 - 0.005), modes(0.2 + 0.005)
pair, single = here.eigenvalues[0], here.eigenvalues[2]
spread = abs(high.eigenvalues[0] - low.eigenvalues[0]) / 2
print(
    f"magnitude of the pair: printed 0.447, computed {abs(pair):.3f} (±{spread:.3f} for ±0.005 in ε_K)"
)
print(f"phase of the pair [rad]: printed 0.947, computed {abs(np.angle(pair)):.3f}")
print(f"third eigenvalue: printed 0.073, computed {single.real:.3f}")

# %% [markdown]
# ## Modes
# Columns of `eigenvectors` are changes of (stance angle, stance rate, thigh rate) that
# a step multiplies by the eigenvalue.

# %%
figure, axes = plt.subplots(1, 2, figsize=(8, 3), layout="constrained")
for panel, mode, name in ((axes[0], 0, "pair"), (axes[1], 2, "fast mode")):
    vector = here.eigenvectors[:, mode]
    panel.bar(np.arange(3) - 0.2, vector.real, 0.4, label="real")
    panel.bar(np.arange(3) + 0.2, vector.imag, 0.4, label="imaginary")
    panel.set(title=f"{name}: {here.eigenvalues[mode]:.3f}", xticks=range(3))
    panel.set_xticklabels(["stance angle", "stance rate", "thigh rate"])
axes[0].legend()
figure.savefig("mcgeer-modes.png")
