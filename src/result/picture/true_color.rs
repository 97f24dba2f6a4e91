//! True colours: what a map looks like to the eye, on a screen in sRGB.
//!
//! The values of a map set how bright its cells are, and X, Y and Z set their hue. Light of a single wavelength has hues
//! that no screen has, and is shown without what is negative in sRGB.

use crate::result::color::Color;
use crate::result::picture::Rgb;
use crate::result::picture::pyramid::Pyramid;
use crate::result::picture::raster::{Means, Raster, Runs};
use crate::result::picture::scale::{Palette, Scale, Shade};
use crate::result::picture::srgb::srgb;
use ndarray::{Array2, Ix2};

/// X, Y and Z of each cell of a map.
#[derive(Debug, Clone, PartialEq)]
pub struct TrueColors {
    xyz: [Array2<f64>; 3],
    /// The maps at coarser resolutions, where the window shows them.
    pyramids: [Pyramid; 3],
}

impl TrueColors {
    /// The colours of a detector's map.
    pub fn of(color: &Color) -> Option<Self> {
        let [x, y, z] = color.xyz.each_ref().map(|map| map.view().into_dimensionality::<Ix2>().ok());
        Some(TrueColors { xyz: [x?.to_owned(), y?.to_owned(), z?.to_owned()], pyramids: Default::default() })
    }

    /// The same after a change of each map, such as one of its cells.
    #[must_use]
    pub fn changed(&self, change: impl Fn(&Array2<f64>) -> Array2<f64>) -> Self {
        TrueColors { xyz: self.xyz.each_ref().map(change), pyramids: Default::default() }
    }

    /// The same with the maps at coarser resolutions.
    #[must_use]
    pub fn with_pyramids(self) -> Self {
        TrueColors { pyramids: self.xyz.each_ref().map(Pyramid::of), ..self }
    }

    /// The colour of each cell, as bright as the palette has it.
    pub fn of_cells(&self, scale: &Scale, palette: &Palette) -> Array2<Rgb> {
        let [x, y, z] = &self.xyz;
        Array2::from_shape_fn(y.dim(), |cell| color([x[cell], y[cell], z[cell]], scale, palette))
    }

    /// The pixels of a map: each in the colour of the mean of its cells. `block` is the side of a block of cells that may be
    /// taken together, and `rows` and `columns` count such blocks.
    pub fn pixels(
        &self,
        block: f64,
        (rows, columns): (&Runs, &Runs),
        (scale, palette): (&Scale, &Palette),
    ) -> Raster {
        let means = |i: usize| Means::new(&self.pyramids[i].level(&self.xyz[i], block), rows, columns);
        let [x, y, z] = [0, 1, 2].map(means);
        y.paint_cells(|cell| color([x.values[cell], y.values[cell], z.values[cell]], scale, palette))
    }
}

/// The colour of light whose Y stands at a place of a scale.
fn color([x, y, z]: [f64; 3], scale: &Scale, palette: &Palette) -> Rgb {
    match scale.shade(y) {
        Shade::Missing => palette.missing,
        Shade::Zero => palette.zero,
        Shade::Part(part) => {
            let part = palette.position(part);
            srgb([x / y * part, part, z / y * part])
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::result::picture::raster::runs;
    use crate::result::picture::scale::ScaleKind;
    use ndarray::array;

    /// A pixel over a red and a green cell is yellow: light adds up before it becomes a colour.
    #[test]
    fn a_pixel_mixes_the_light_of_its_cells() {
        let colors = TrueColors {
            xyz: [
                array![[0.412_456, 0.357_576]],
                array![[0.212_673, 0.715_152]],
                array![[0.019_334, 0.119_192]],
            ],
            pyramids: Default::default(),
        };
        let scale = Scale::fit(ScaleKind::Linear, 100.0, [&array![[0.463_912_5]]]);
        let palette = Palette::of_true_colors(&scale, [9; 3]);
        let one = (&runs((0.0, 1.0), 1, 1), &runs((0.0, 2.0), 2, 1));
        let raster = colors.pixels(1.0, one, (&scale, &palette));
        // As bright as white is red and green at once: Y of yellow is 0.93.
        assert!(raster.rgb[0] == 255 && raster.rgb[1] == 255 && raster.rgb[2] < 3, "{:?}", raster.rgb);
        let cells = colors.of_cells(&Scale { high: 1.0, ..scale }, &palette);
        assert_eq!(cells.into_iter().collect::<Vec<_>>(), [[255, 0, 0], [0, 255, 0]]);
    }
}
