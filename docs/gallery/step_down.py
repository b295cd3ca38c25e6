# %% [markdown]
# # A step down
#
# M. Wisse and A. L. Schwab, *First steps in passive dynamic walking* (CLAWAR 2004),
# give the gait of a small walker with round feet on a slope of 0.01: stance angle
# 0.2015 rad, rates −1.4052 and −1.1205 rad/s. From this gait the walker meets ground
# that is suddenly lower or higher.

# %%
import matplotlib.pyplot as plt
import numpy as np

from gaitsweep import simulate, step_map

walker = {
    **{"units": "SI", "g": 9.81, "knees": False, "R": 0.1, "eps_T": 0.0},
    **{"l_t": 0.1, "w_t": 0.0, "m_t": 1.0, "r_t": 0.1, "c_t": 0.1},
    **{"l_s": 0.3, "w_s": 0.0, "m_s": 0.0, "r_s": 0.0, "c_s": 0.0},
}
printed = (0.2015, -1.4052, -1.1205)

# %% [markdown]
# ## It is a gait
# Starting from the printed state, the steps converge to the gait, which agrees with the
# printed digits.

# %%
walk = simulate(walker, 0.01, printed, 60)
gait = [float(walk[name][-1]) for name in ("stance_angle", "stance_rate", "thigh_rate")]
for name, there, here in zip(
    ("stance angle", "stance rate", "thigh rate"), printed, gait, strict=True
):
    print(f"{name}: printed {there}, computed {here:.6f}")
print("multipliers:", np.round(step_map(walker, 0.01, gait).eigenvalues, 4))

# %% [markdown]
# ## Lower ground, once
# At the end of step 3 the ground is 1 mm lower and stays so. The legs then stand at two
# different angles.

# %%
down = simulate(walker, 0.01, gait, 40, ground={3: -1e-3}, motion=True)
print(down.reason.item(), np.round(down.stance_angle[2:9].to_numpy(), 4))


def walks(height):
    """Whether the walker is still walking 60 steps after a change of height."""
    return simulate(walker, 0.01, gait, 60, ground={0: height}).outcome == "walks"


def largest(sign):
    """Largest change of height that it survives, by bisection [m]."""
    low, high = 0.0, 0.05
    while high - low > 1e-6:
        middle = (low + high) / 2
        low, high = (middle, high) if walks(sign * middle) else (low, middle)
    return low


for name, sign in (("down", -1), ("up", 1)):
    height = largest(sign)
    print(
        f"survives a step {name} of {1e3 * height:.2f} mm, {height / 0.4:.2%} of the leg"
    )

# %%
figure, axes = plt.subplots(layout="constrained")
start = 0.0
for step in range(10):
    time, stance, swing = (
        down[name][step, 0] for name in ("time", "theta_st", "theta_th")
    )
    axes.plot(start + time, stance, "tab:blue")
    axes.plot(start + time, swing, "tab:orange")
    start += float(time[-1])
axes.set(xlabel="time [s]", ylabel="angle of stance (blue) and swing leg [rad]")
figure.savefig("step-down.png")
