//! Rows of coefficients for the shaders.

/// Rows that a shader reads from the last to the first, as recurrences want them: how many rows there are; then for each the
/// number of its coefficients, and these, from the last to the first.
pub fn backwards(rows: &[Vec<f64>]) -> Vec<f64> {
    let mut numbers = vec![rows.len() as f64];
    for row in rows.iter().rev() {
        numbers.push(row.len() as f64);
        numbers.extend(row.iter().rev());
    }
    numbers
}
