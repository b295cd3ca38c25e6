"""The mass that a point of a linkage shows to an impulse, without differences.

A direct elimination of the joints subtracts numbers of the size of the whole walker's
mass, of which a light leg is a small part: beside a foot of 1e-9 of it, seven digits of
sixteen remain. Here every term is a square. Vectors are complex numbers x + iy; all
arrays have one lane each.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy import ndarray

from gaitsweep.tasks.mechanics.contact import total


@dataclass(frozen=True)
class ApparentMass:
    """A symmetric matrix without negative eigenvalues, `isotropic` times 1 plus the sum
    of u u^T over `squares`.

    Attributes
    ----------
    isotropic : ndarray, shape (n,)
    squares : tuple of ndarray of complex, shape (n,)
    """

    isotropic: ndarray
    squares: tuple[ndarray, ...]

    def with_point(self, mass: ndarray | float) -> ApparentMass:
        """Return the mass with a point mass added to it."""
        return ApparentMass(self.isotropic + mass, self.squares)

    def times(self, v: ndarray) -> ndarray:
        """Product with vectors."""
        return self.isotropic * v + total(u * dot(u, v) for u in self.squares)

    def along(self, v: ndarray) -> ndarray:
        """Quadratic form v^T M v of vectors."""
        return self.isotropic * np.abs(v) ** 2 + total(
            dot(u, v) ** 2 for u in self.squares
        )

    @property
    def determinant(self) -> ndarray:
        """Determinant."""
        sizes = total(np.abs(u) ** 2 for u in self.squares)
        areas = [
            cross(u, v) ** 2
            for i, u in enumerate(self.squares)
            for v in self.squares[:i]
        ]
        return self.isotropic * (self.isotropic + sizes) + total(
            [np.zeros_like(sizes), *areas]
        )

    @property
    def matrix(self) -> ndarray:
        """Matrix along x and y, shape (n, 2, 2)."""
        x, y = self.isotropic, self.isotropic
        off = np.zeros_like(x)
        for u in self.squares:
            x, y, off = x + u.real**2, y + u.imag**2, off + u.real * u.imag
        return np.stack(
            [np.stack([x, off], axis=-1), np.stack([off, y], axis=-1)], axis=-2
        )

    @property
    def axis(self) -> ndarray:
        """Eigenvector nearer x, of size 1; the other one is a quarter of a turn from
        it.
        """
        # Sums of u^2 have twice the angle of the eigenvector with the larger
        # eigenvalue. Only a small angle has all its digits: that eigenvector's from the
        # axis nearer to it.
        doubled = total(u**2 for u in self.squares)
        return np.exp(0.5j * np.angle(np.where(doubled.real < 0, -doubled, doubled)))


def dot(u: ndarray, v: ndarray) -> ndarray:
    """Products of vectors."""
    return u.real * v.real + u.imag * v.imag


def cross(u: ndarray, v: ndarray) -> ndarray:
    """Area between vectors."""
    return u.real * v.imag - u.imag * v.real


def of_free_link(
    mass: ndarray | float, centre: ndarray, inertia: ndarray | float
) -> ApparentMass:
    """Mass of a free rigid link at one of its points.

    Parameters
    ----------
    mass : float or ndarray, shape (n,)
    centre : ndarray of complex, shape (n,)
        Centre of mass from that point.
    inertia : float or ndarray, shape (n,)
        About the centre of mass.
    """
    about_point = inertia + mass * np.abs(centre) ** 2
    return ApparentMass(
        mass * inertia / about_point, (mass / np.sqrt(about_point) * centre,)
    )


@np.errstate(divide="ignore", invalid="ignore")
def of_hinged_link(
    beyond: ApparentMass,
    point: ndarray,
    mass: ndarray | float,
    centre: ndarray,
    inertia: ndarray | float,
) -> ApparentMass:
    """Mass at a point of a rigid link that is hinged to others.

    Parameters
    ----------
    beyond : ApparentMass
        That of all others at the hinge.
    point, centre : ndarray of complex, shape (n,)
        The point and the link's centre of mass, from the hinge.
    mass, inertia : float or ndarray, shape (n,)
        Of the link; about its centre of mass.

    Notes
    -----
    With H the mass at the hinge, a = i `point` the velocity that a unit rate gives the point, h = H a, A = a^T H a,
    d = `point` - `centre` and D = A + I + m d^2, eliminating the rate from the kinetic
    energy at a given velocity of the point leaves

        M = H + m - (h + m i d)(h + m i d)^T/D
          = det(H)/A p p^T + I/D (1/A h h^T + m) + m^2/D d d^T + m/(D A) G^T G,
        G = A - i d h^T = i h (i a)^T + i c h^T,

    with p and c the point and the centre, by H = h h^T/A + det(H)/A p p^T and the
    identity a h^T + i h (i a)^T = A.
    """
    a = 1j * point
    h, A = beyond.times(a), beyond.along(a)
    # A hinge that yields freely: what lies beyond pushes only along the link.
    yields = A == 0
    easy = np.where(
        yields,
        point * np.sqrt(beyond.along(point)) / np.abs(point) ** 2,
        h / np.sqrt(A),
    )
    stiff = np.where(yields, 0.0, np.sqrt(beyond.determinant / A))

    about_point = inertia + mass * np.abs(point - centre) ** 2
    D = A + about_point
    share = np.sqrt(mass / D)
    turned, moved = 1j * easy, 1j * centre
    squares = (
        stiff * point,
        np.sqrt(inertia / D) * easy,
        share * np.sqrt(mass) * (point - centre),
        share * (moved.real * easy - turned.real * point),
        share * (moved.imag * easy - turned.imag * point),
    )
    return ApparentMass(mass * inertia / D, squares)
