"""Reference of the paper that this project reproduces."""

#: "The paper" in archives and on pages.
PAPER = (
    "M. Garcia, A. Chatterjee, A. Ruina: Efficiency, speed, and scaling of two-dimensional passive-dynamic"
    " walking, Dynamics and Stability of Systems 15(2), 75-99, 2000, doi:10.1080/713603737"
)
