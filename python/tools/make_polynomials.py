"""Write the polynomials of the shaders' mathematics: shaders/math/polynomials.f32.wgsl and polynomials.f64.wgsl.

Each is the Chebyshev interpolant of lowest degree whose error, in the result that it serves, stays well below half a
unit in the last place: within a factor of about 2 of the best polynomial of that degree (Trefethen, Approximation
Theory and Approximation Practice, 2nd ed., chapter 16), and it needs no iteration.

Usage: python make_polynomials.py SHADER_LIB_DIRECTORY   (needs mpmath)
"""

import struct
import sys
from pathlib import Path

from mpmath import asin, atan, atanh, cos, expm1, fabs, lu_solve, matrix, mp, mpf, pi, sin, sqrt

mp.dps = 60


def tail(numerator, power):
    """The function numerator(s) / s**power of z = s*s, continued to z = 0 by its neighbourhood."""

    def of_z(z):
        s = sqrt(z) if z > mpf(10) ** -30 else mpf(10) ** -15
        return numerator(s) / s**power

    return of_z


def exp_tail(r):
    r = r if fabs(r) > mpf(10) ** -20 else mpf(10) ** -20
    return (expm1(r) - r) / r**2


SQUARED_QUARTER_PI = (pi / 4) ** 2 * mpf("1.0001")
# Name, argument, what it is, the function, its interval, and how much of an error in it reaches the result, at most.
POLYNOMIALS = [
    ("poly_sin", "z", "(sin(x) - x) / x^3, z = x^2, |x| <= pi/4",
     tail(lambda x: sin(x) - x, 3), 0, SQUARED_QUARTER_PI, SQUARED_QUARTER_PI),
    ("poly_cos", "z", "(cos(x) - 1) / x^2, z = x^2, |x| <= pi/4",
     tail(lambda x: cos(x) - 1, 2), 0, SQUARED_QUARTER_PI, SQUARED_QUARTER_PI * sqrt(2)),
    ("poly_log", "z", "(2 atanh(s) - 2 s) / s^3, z = s^2, |s| <= (sqrt(2) - 1) / (sqrt(2) + 1)",
     tail(lambda s: 2 * atanh(s) - 2 * s, 3), 0, mpf("0.02945"), mpf("0.02945") / 2),
    ("poly_exp", "r", "(exp(r) - 1 - r) / r^2, |r| <= ln(2) / 2",
     exp_tail, mpf("-0.3467"), mpf("0.3467"), mpf("0.3467") ** 2 * sqrt(2)),
    ("poly_asin", "z", "(asin(s) - s) / s^3, z = s^2, |s| <= 1/2",
     tail(lambda s: asin(s) - s, 3), 0, mpf("0.25"), mpf("0.25")),
    ("poly_atan", "z", "(atan(t) - t) / t^3, z = t^2, |t| <= sqrt(2) - 1",
     tail(lambda t: atan(t) - t, 3), 0, mpf("0.1716"), mpf("0.1716")),
]


def interpolant(function, low, high, degree):
    """Coefficients, lowest power first, of the interpolant in the Chebyshev points of [low, high]."""
    middle, half = (mpf(low) + high) / 2, (mpf(high) - low) / 2
    points = [middle + half * cos(pi * (2 * i + 1) / (2 * degree + 2)) for i in range(degree + 1)]
    vandermonde = matrix([[x**power for power in range(degree + 1)] for x in points])
    return list(lu_solve(vandermonde, matrix([function(x) for x in points])))


def largest_error(function, coefficients, low, high):
    grid = [mpf(low) + (mpf(high) - low) * i / 400 for i in range(401)]
    return max(fabs(sum(c * x**power for power, c in enumerate(coefficients)) - function(x)) for x in grid)


def shortest(function, low, high, allowed):
    """The interpolant of lowest degree whose error is allowed."""
    for degree in range(1, 30):
        coefficients = interpolant(function, low, high, degree)
        if largest_error(function, coefficients, low, high) <= allowed:
            return coefficients
    raise ValueError("no degree below 30 is enough")


def rounded(coefficient, bits):
    return struct.unpack("<f", struct.pack("<f", float(coefficient)))[0] if bits == 24 else float(coefficient)


def horner(coefficients, argument, bits):
    *lower, last, highest = [repr(rounded(c, bits)) for c in coefficients]
    nested = f"{last} + {argument} * {highest}"
    for coefficient in reversed(lower):
        nested = f"{coefficient} + {argument} * ({nested})"
    return nested


def wgsl(bits):
    lines = ["// Written by python/tools/make_polynomials.py: change it there."]
    for name, argument, what, function, low, high, reach in POLYNOMIALS:
        coefficients = shortest(function, low, high, mpf(2) ** -(bits + 5) / reach)
        lines += ["", f"// {what}.", f"fn {name}({argument}: real) -> real {{",
                  f"    return {horner(coefficients, argument, bits)};", "}"]
    return "\n".join(lines) + "\n"


def main():
    directory = Path(sys.argv[1])
    for name, bits in [("polynomials.f32.wgsl", 24), ("polynomials.f64.wgsl", 53)]:
        (directory / name).write_text(wgsl(bits))


if __name__ == "__main__":
    main()
