"""Writes shaders/random/sobol_matrices.wgsl: the direction numbers of the third to the fifth Sobol dimension.

The parameters are by Joe and Kuo (new-joe-kuo-6): degree s, coefficients a and initial numbers m.
"""

from pathlib import Path

PARAMETERS = {2: (2, 1, [1, 3]), 3: (3, 1, [1, 3, 1]), 4: (3, 2, [1, 1, 1])}
BITS = 32
PATH = Path(__file__).parents[2] / "shaders" / "random" / "sobol_matrices.wgsl"


def direction_numbers(degree: int, coefficients: int, initial: list[int]) -> list[int]:
    """Return the 32 direction numbers v_k = m_k / 2^k as integers of 32 bits."""
    numbers = [m << (BITS - k) for k, m in enumerate(initial, start=1)]
    for k in range(degree, BITS):
        value = numbers[k - degree] ^ (numbers[k - degree] >> degree)
        for i in range(1, degree):
            if coefficients >> (degree - 1 - i) & 1:
                value ^= numbers[k - i]
        numbers.append(value)
    return numbers


def main() -> None:
    """Write the file."""
    lines = ["// Direction numbers of Sobol's dimensions, one a bit of the index: written by python/tools/make_sobol.py."]
    for dimension, parameters in PARAMETERS.items():
        lines += ["", f"fn sobol_{dimension}(index: u32) -> u32 {{", "    let bits = bitcast<i32>(index);", "    var x = 0u;"]
        lines += [f"    x ^= bitcast<u32>(extractBits(bits, {k}u, 1u)) & 0x{number:08X}u;"
                  for k, number in enumerate(direction_numbers(*parameters))]
        lines += ["    return x;", "}"]
    PATH.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
