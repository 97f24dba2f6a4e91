//! Rows of coefficients for the shaders.

/// Rows for a shader that reads them from the last to the first, as recurrences do. The number of rows comes first.
/// Then each row has the number of its coefficients and the coefficients, from the last to the first.
pub fn backwards(rows: &[Vec<f64>]) -> Vec<f64> {
    let mut numbers = vec![rows.len() as f64];
    for row in rows.iter().rev() {
        numbers.push(row.len() as f64);
        numbers.extend(row.iter().rev());
    }
    numbers
}
