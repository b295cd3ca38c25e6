"""The mechanics: `lumped` constants, the `equations` of motion and `impacts` as
symbols, compiled flows (`kernel`).

`contact` has the forces on the foot and the stance knee, and the mass matrix as arrays.
"""
