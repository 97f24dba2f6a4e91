//! What is shown, as text, and unused names for files.

use crate::error::{Error, Result};
use crate::placing;
use crate::result::figures::field::Field;
use crate::viewer::spots::Spots;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// The values of a map, one cell a line, with the units in the header.
pub fn fields_csv(field: &Field) -> String {
    let [x, y, value] = [field.labels.x, field.labels.y, field.labels.value];
    let mut text = format!(
        "{} [{}],{} [{}],{} [{}],hits,standard error [{}]\n",
        x.0, x.1, y.0, y.1, value.0, value.1, value.1
    );
    for ((row, column), value) in field.values.indexed_iter() {
        let (x, y) = field.centre((row, column));
        let (hits, sigma) = (field.hits[(row, column)], field.sigma[(row, column)]);
        let _ = writeln!(text, "{x},{y},{value},{hits},{sigma}");
    }
    text
}

/// Rays as points, one a line, with the units in the header.
pub fn spots_csv(spots: &Spots) -> String {
    let [x, y, value] = [spots.labels.x, spots.labels.y, spots.labels.value];
    let mut text =
        format!("ray id,{} [{}],{} [{}],{} [{}],wavelength [µm]\n", x.0, x.1, y.0, y.1, value.0, value.1);
    for spot in &spots.spots {
        let _ =
            writeln!(text, "{},{},{},{},{}", spot.ray_id, spot.at.0, spot.at.1, spot.flux, spot.wavelength);
    }
    text
}

/// A path in `folder` that is not in use: an export never replaces a file.
pub fn free_path(folder: &Path, name: &str, extension: &str) -> PathBuf {
    let safe = |c: char| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '_' };
    let stem: String = name.chars().map(safe).collect();
    let numbered = (2..).map(|number| format!("{stem}_{number}{extension}"));
    let mut paths =
        std::iter::once(format!("{stem}{extension}")).chain(numbered).map(|name| folder.join(name));
    paths.find(|path| !placing::exists(path)).unwrap_or_else(|| folder.join(stem))
}

/// Writes a file of a name that [`free_path`] gave, and returns its path. What somebody has put there meanwhile stays.
///
/// # Errors
/// [`Error::File`] if the file cannot be written.
pub fn write_new(path: PathBuf, text: &str) -> Result<PathBuf> {
    match placing::new_file(&path, text.as_bytes()) {
        Ok(()) => Ok(path),
        Err(error) => Err(Error::file(path, error)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::result::IrradianceMap;
    use ndarray::{Array1, array};

    #[test]
    fn a_map_has_a_line_a_cell_and_units_above() {
        let field = Field::of_result(&IrradianceMap {
            irradiance: array![[0.5, 0.0]],
            x_coords: Array1::zeros(2),
            y_coords: Array1::zeros(1),
            hits: array![[4, 0]],
            width: 2.0,
            height: 1.0,
            standard_error: None,
        });
        let expected = "x [mm],y [mm],Irradiance [W/mm²],hits,standard error [W/mm²]\n\
                        -0.5,0,0.5,4,0.25\n0.5,0,0,0,NaN\n";
        assert_eq!(fields_csv(&field), expected);
    }

    #[test]
    fn an_export_replaces_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let first = free_path(folder.path(), "a/b", ".csv");
        assert_eq!(first, folder.path().join("a_b.csv"));
        std::fs::write(&first, "").unwrap();
        let second = free_path(folder.path(), "a/b", ".csv");
        assert_eq!(second, folder.path().join("a_b_2.csv"));
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink(folder.path().join("nowhere"), &second).unwrap();
            assert_eq!(free_path(folder.path(), "a/b", ".csv"), folder.path().join("a_b_3.csv"));
        }
        write_new(first, "mine").unwrap_err();
    }
}
