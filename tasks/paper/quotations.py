"""What the paper says, in its words: a quotation for each claim (its place is the claim's `source`).

The text is that of the authors' manuscript of September 6, 1999, with formulas set in Unicode; "…" stands for words
left out. The published paper is M. Garcia, A. Chatterjee, A. Ruina, Dynamics and Stability of Systems 15(2), 75-99,
2000, doi:10.1080/713603737.
"""

#: The paper's sentence by claim.
QUOTATIONS: dict[str, str] = {
    "D1": "The simplest walker has two period-one gaits for all positive ground-slopes (up to 0.2 rad ≈ 12° and "
    "possibly higher).",
    "D2": "the long-step gait is stable at sufficiently small ground-slopes (γ < 0.015)",
    "D3": "the short-step gait is always unstable",
    "D4": "As γ → 0, the long-step gait approaches a time-reversal-symmetric motion with normal heelstrike "
    "collisions (ẋ/ẏ → 0 as γ → 0 …). The short-step gait lacks this time-reversal symmetry, and the pre-"
    "heelstrike foot velocity has a significant tangential (ẋ) component.",
    "D5": "both gait cycles were found to have walking speed and stance angle θst … each proportional to γ¹ᐟ³ as γ "
    "→ 0, while the step periods approach nonzero constants",
    "D6": "walking power consumption is proportional to the fourth power of speed for both gaits",
    "D7": "For the simplest walker, the short-step gait is faster (has bigger average velocity v) than the long-"
    "step gait at all ground-slopes studied.",
    "D8": "For 0.015 ≲ γ ≲ 0.019 a period-doubling route to chaos was observed for this walker.",
    "D9": "Howell and Baillieul (1998) have discovered an unconnected stable period-three branch of gaits at γ ≈ "
    "0.0125 and subsequent period-doublings (period-six, period-twelve, etc.). … there is thus a range of γ "
    "values where a stable period-one gait cycle coexists with an unstable period one gait cycle and a stable"
    " period-three gait cycle. Further, there are two disconnected chaotic regimes.",
    "D10": "The long-step gait … is somewhat relaxed in nature, with the swing leg swinging forward and back a "
    "little before heelstrike. The short-step gait has a shorter period and a truncated shuffling aspect, "
    "since heelstrike occurs as the swing leg is still swinging forward.",
    "E1": "the location of the second point-mass exactly on the foot ensures that the return map is two-dimensional",
    "E2": "the long-step solution's stance angle is proportional to the cube-root of the ground-slope (like the "
    "simplest walker)",
    "E3": "the short-step solutions' stance angles are proportional to γ at very small ground-slopes, and "
    "approximately to γ¹ᐟ³ at ground-slopes above some threshold γ that depends on foot mass",
    "E4": "The ratio of the two intersection γ values is predicted, for constant C, to be (ρE/ρF)³ᐟ² as "
    "approximately observed in figure 5.",
    "E5": "Above the transition region, foot mass effects are unimportant, and the short-step gaits of both walkers"
    " follow similar γ¹ᐟ³ curves.",
    "E6": "the short-step gait … is slower at very small ground-slopes … At these higher ground-slopes, the short-"
    "step solution is the faster solution",
    "E7": "the long-step solution having essentially normal heelstrike collisions (ẋ/ẏ ≪ 1 …) and the short-step "
    "solution having heelstrike collisions with a significant tangential component (ẋ/ẏ ≫ 1 …)",
    "P1": "The walkers of figure 6 have no solutions below some minimum ground-slope, (γmin ≈ 0.016 for the "
    "straight-legged walker and γmin ≈ 0.020 for the kneed walker).",
    "P2": "the straight-legged gaits (dashed lines) are unstable and only a part of the kneed gait (solid line) is "
    "stable",
    "P3": "In general, we find at most one stable period-one solution for a given set of design parameters and "
    "ground-slope.",
    "P4": "kneestrike occurs later and later in the step, until heelstrike and kneestrike occur simultaneously at "
    "point 1. The locus of gaits ends here because we do not allow heelstrike to precede kneestrike.",
    "P5": "approaching point 2, the heelstrike collision becomes increasingly tangential in nature, until the "
    "solution disappears due to the swing foot never re-emerging from under the ground surface",
    "P6": "The straight-legged solutions approach zero step length. The kneed solutions approach a gait where "
    "kneestrike occurs immediately after heelstrike",
    "P7": "Points 3 and 4 are the slowest gaits for both walkers. For these walkers, the slowest walking is not at "
    "the smallest ground-slope.",
    "P8": "Going up the kneed curve from point 3, kneestrike occurs later and later in the step",
    "T1": "The mechanisms investigated by Goswami et al. (1996) and Goswami et al. (1997) satisfy these necessary "
    "conditions, and presumably walk at arbitrarily small ground-slopes.",
    "T2": "each walker has two gait cycles at all ground-slopes of γ < 0.04",
    "T3": "the long-step, long-period cycle is stable at small ground-slopes, while the short-step, short-period "
    "cycle is unstable",
    "T4": "the cusp at the origin breaks and the two solutions separate. The long-step solution remains stable for "
    "small ground-slopes but shifts to the right and no longer extends to zero ground-slope. Also, an "
    "unstable region appears on this branch at very low speeds.",
    "T5": "The short-step solution also shifts to the right; the point on this curve where the solution terminates "
    "(where heelstrike and kneestrike are simultaneous) shifts up the more or less same-shaped curve.",
    "T6": "the two solution branches get closer and eventually touch at some critical detuning value; the curves "
    "then split into two new solution branches",
    "T7": "The zero-slope capable mechanisms are non-generic, in that random small parameter adjustments, in "
    "particular, fore-aft movement of the thigh and shank centers-of-mass, cause loss of the zero-slope "
    "capability.",
    "T8": "The high-ground-slope solution branch presumably continues to exist at still higher ground-slopes than "
    "shown in figure 6(f).",
    "Z1": "All of these walkers can walk at arbitrarily small ground-slopes.",
    "Z2": "The simplest walking model (D) is the only one with both gaits having a step length ∝ γ¹ᐟ³.",
    "Z3": "At the smallest ground-slopes, the tuned straight-legged walkers with finite foot mass (A, B, and E) "
    "each have one gait solution with step length ∝ γ (the short-step gait) and one solution with step length"
    " ∝ γ¹ᐟ³ (the long-step gait). At steeper ground-slopes (γ > 0.01), all the gait solutions have step "
    "length ∝ γ¹ᐟ³",
    "Z4": "this solution slowly changes to a linear scaling at extremely small ground-slopes (γ ≈ 0.00015)",
    "Z5": "all of the tuned long-step gaits have a certain ground-slope below which the gait is stable (down to "
    "zero ground-slope)",
    "Z6": "Summary of the properties of various walkers capable of walking at arbitrarily small ground-slopes.",
    "M1": "the y direction is an eigenvector of M, the (x, y) coordinate system diagonalizes M, and M₁₁ = m_tot, "
    "the total mass of the walker. … M₂₂ is (asymptotically for small foot mass and as the stance angle goes "
    "to zero) equal to the foot mass.",
    "M2": "For gravity-powered walking, the energy dissipated is (weight) × (height drop over one step).",
    "M3": "it is seen that the only two possibilities for step lengths proportional to γᵖ are p = 1 and p = 1/3",
    "M4": "energy balance shows that for gaits with step length ∝ γ¹ᐟ³, gravitational power consumed is ∝ (speed)⁴,"
    " while for gaits with step length ∝ γ, power ∝ (speed)²",
    "M5": "both tangential heelstrike and kneestrike have energy dissipation proportional to v²",
    "M6": "for a given small speed, the long-step gaits are much more efficient than the short-step gaits",
    "M7": "the new swing leg is not constrained at the knee (this has a fairly small effect on M, if the hip mass "
    "is relatively large)",
    "K1": "The period-one motion becomes unstable at a ground-slope of about 0.084, but a stable period-two gait "
    "appears, followed by a stable period-four gait, and so on",
    "K2": "The walker continues to have stable persistent walking (that is, not falling down) solutions at ground-"
    "slopes of up to about 0.103. At higher ground-slopes we could not find persistent walking motions for "
    "this kneed walker.",
    "K3": "Only stable walking motions are shown, although unstable gait cycles continue for larger values of γ.",
    "W1": "the long period gait corresponds to support transfer when angles and rates are matched, much like a "
    "rolling wheel",
    "G1": "for all the models we studied at every ground-slope, we found no more than two anthropomorphic period-"
    "one gait cycles",
    "G2": "For the superficially 6th-order kneed walker … the map is also only three-dimensional … of the four "
    "numerically-evaluated eigenvalues of McGeer (1990b) …, the first is (exactly) mathematically zero.",
    "A1": "In simulations of straight-legged walkers, the swing leg inevitably passes through or scuffs the ground "
    "near mid-swing. … Kneed walkers may, but do not necessarily, avoid this scuffing",
    "A2": "The simulation shown in figure 3 has a slight stance-leg unlocking impulse at kneestrike … the "
    "naturally-arising torques just after kneestrike are enough to re-engage the knee stop",
    "A3": "There is no contact tension in our simulations … We assume that there is enough friction available to "
    "achieve the non-sliding heelstrike collisions assumed by the model.",
    "A4": "Some non-tuned kneed walkers would exhibit this behavior at very small step lengths if allowed to, but "
    "we exclude such solutions.",
    "A5": "Sometimes at release, the first motion of the swing foot penetrates the ground.",
    "A6": "we assume in our simulations that during the heelstrike collision, no impulse acts on the old stance "
    "foot from the ground. … it is self-consistent",
}
