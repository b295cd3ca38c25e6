"""Vectors of legs in the plane, whose parts are of any type of number: doubles, wider
ones, arrays or symbols.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Vector:
    """A vector (x, y), or complex number x + iy."""

    x: Any
    y: Any

    def __add__(self, other: Vector) -> Vector:
        return Vector(self.x + other.x, self.y + other.y)

    def __mul__(self, factor: Any) -> Vector:
        return Vector(self.x * factor, self.y * factor)

    def __truediv__(self, divisor: Any) -> Vector:
        return Vector(self.x / divisor, self.y / divisor)

    def dot(self, other: Vector) -> Any:
        """Scalar product."""
        return self.x * other.x + self.y * other.y

    def rotate(self, sine: Any, cosine: Any) -> Vector:
        """Rotate counter-clockwise by an angle of that sine and cosine."""
        return Vector(self.x * cosine - self.y * sine, self.x * sine + self.y * cosine)

    def normal(self) -> Vector:
        """Rotate by a right angle: the derivative by the angle."""
        return Vector(-self.y, self.x)
