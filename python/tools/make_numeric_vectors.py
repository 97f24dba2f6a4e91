"""Write the reference values of the shaders' draws and elementary functions: tests/data/rng.csv and math.bin.

rng.csv holds keys and the draws that Optiland makes of them. math.bin holds, for each function in the order of
FUNCTIONS, rows of little-endian f64 (argument, second argument or 0, value): the value is computed to 50 digits and rounded once.

Usage: python make_numeric_vectors.py TEST_DATA_DIRECTORY   (needs optiland 0.6.3, numpy and mpmath)
"""

import math
import random
import struct
import sys
from pathlib import Path

import numpy as np
from mpmath import acos, atan2, cos, cospi, exp, log, mp, mpf, pi, sin, sinpi
from optiland.nonsequential.rng import EventSlot, pcg32_uint32

mp.dps = 50
ROWS = 2400
LARGE_SEEDS = [0, 1, 7, 2**32 - 1, 2**32, 2**63 + 12345, 2**64 - 1]


def rng_keys(source):
    for _ in range(ROWS):
        seed = source.choice(LARGE_SEEDS)
        ray_id = source.getrandbits(source.choice([4, 20, 32, 33, 48, 63, 64]))
        step = source.choice([0, 1, source.randrange(16), source.randrange(10001), 10000])
        yield seed, ray_id, step, int(source.choice(list(EventSlot)))


def rng_rows(source):
    yield "seed,ray_id,step,slot,draw\n"
    for seed, ray_id, step, slot in rng_keys(source):
        drawn = pcg32_uint32(seed, np.array([ray_id], dtype=np.uint64), np.array([step]), slot)[0]
        yield f"{seed},{ray_id},{step},{slot},{drawn}\n"


def spread(source, smallest, largest, negative=True):
    """A number whose logarithm is spread evenly, of either sign."""
    size = 10 ** source.uniform(math.log10(smallest), math.log10(largest))
    return -size if negative and source.random() < 0.5 else size


def draws(source):
    edges = [0, 1, 2, 3, 2**31, 2**32 - 1, 2**32 - 2, 0xB504F333, 0xB504F334]
    edges += [(k << 29) + d & 0xFFFFFFFF for k in range(8) for d in (-1, 0, 1)]
    small = [source.getrandbits(source.randrange(1, 33)) for _ in range(600)]
    near_one = [2**32 - 1 - source.getrandbits(source.randrange(1, 31)) for _ in range(400)]
    return edges + small + near_one + [source.getrandbits(32) for _ in range(ROWS - 1000 - len(edges))]


def exponents(source):
    edges = [0.0, -0.0, 1.0, -1.0, -708.39, -708.38, 708.9, 5e-324, 1e-300, -1e-17]
    small = [spread(source, 1e-18, 1.0) for _ in range(600)]
    return edges + small + [source.uniform(-708.39, 709.0) for _ in range(ROWS - len(small) - len(edges))]


def angles(source):
    multiples = [float(pi * k / 4) for k in range(-40, 41)] + [float(pi * k / 2) for k in range(6000, 6360, 7)]
    small = [spread(source, 1e-18, 4.0) for _ in range(600)]
    return multiples + small + [source.uniform(-1e4, 1e4) for _ in range(ROWS - len(small) - len(multiples))]


def cosines(source):
    edges = [0.0, 1.0, -1.0, 0.5, -0.5, float(np.nextafter(0.5, 1)), float(np.nextafter(-0.5, -1))]
    near_one = [(1.0 - spread(source, 1e-16, 0.5, False)) * source.choice([-1, 1]) for _ in range(800)]
    small = [spread(source, 1e-18, 0.5) for _ in range(400)]
    return edges + near_one + small + [source.uniform(-1, 1) for _ in range(ROWS - 1200 - len(edges))]


def directions(source):
    edges = [(y, x) for y in (0.0, 1.0, -1.0) for x in (0.0, 1.0, -1.0)]
    spreads = [(spread(source, 1e-12, 1e3), spread(source, 1e-12, 1e3)) for _ in range(1000)]
    # As large, small and unequal as doubles allow: the ratio stays a normal number.
    scales = [spread(source, 1e-290, 1e290, False) for _ in range(200)]
    extremes = [(spread(source, 1e-8, 1e8) * scale, spread(source, 1e-8, 1e8) * scale) for scale in scales]
    extremes += [(spread(source, 1e-150, 1e150), spread(source, 1e-150, 1e150)) for _ in range(200)]
    near = [(source.uniform(-1, 1), source.uniform(-1, 1)) for _ in range(ROWS - 1400 - len(edges))]
    return edges + spreads + extremes + near


def positives(source):
    edges = [1.0, 2.0, 0.5, float(np.sqrt(2)), float(np.sqrt(0.5)), 2.2250738585072014e-308, 1.7976931348623157e308]
    near_one = [1.0 + spread(source, 1e-16, 0.4) for _ in range(800)]
    anywhere = [spread(source, 1e-307, 1e308, False) for _ in range(800)]
    return edges + near_one + anywhere + [source.uniform(0.1, 10) for _ in range(ROWS - 1600 - len(edges))]


def turns(function):
    return lambda bits, _: function(mpf(bits) / 2**31)


# Name, its arguments, its value.
FUNCTIONS = [
    ("cos_turns", draws, turns(cospi)),
    ("sin_turns", draws, turns(sinpi)),
    ("log_uniform", draws, lambda bits, _: log(mpf(bits) / 2**32) if bits else log(mpf("1e-300"))),
    ("exp_real", exponents, lambda x, _: exp(mpf(x))),
    ("sin_real", angles, lambda x, _: sin(mpf(x))),
    ("cos_real", angles, lambda x, _: cos(mpf(x))),
    ("acos_real", cosines, lambda x, _: acos(mpf(x))),
    ("atan2_real", directions, lambda y, x: atan2(mpf(y), mpf(x))),
    ("log_real", positives, lambda x, _: log(mpf(x))),
]


def math_rows():
    for name, arguments, function in FUNCTIONS:
        for argument in arguments(random.Random(name)):
            first, second = argument if isinstance(argument, tuple) else (argument, 0.0)
            yield struct.pack("<3d", first, second, float(function(first, second)))


def main():
    directory = Path(sys.argv[1])
    (directory / "rng.csv").write_text("".join(rng_rows(random.Random(7))))
    (directory / "math.bin").write_bytes(b"".join(math_rows()))


if __name__ == "__main__":
    main()
