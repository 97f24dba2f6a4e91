// What rounding hides of a sum of coordinates, as a share of the sum.
const SAG_ROUNDING: real = 1.0e-13;
